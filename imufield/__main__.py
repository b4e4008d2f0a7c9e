"""Run the command line as ``python -m imufield``."""

from imufield.cli import main

main()
