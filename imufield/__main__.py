"""Run the command line as ``python -m imufield``."""

from imufield.cli import program

program()
