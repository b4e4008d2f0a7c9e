"""Which packages there are: those of ``imufield/``, and the two folders that stand beside it in a checkout; the man page."""

from pathlib import Path

from setuptools import find_packages, setup

setup(
    packages=[*find_packages(include=["imufield", "imufield.*"]), "imufield.drivers", "imufield.protocols"],
    package_dir={"imufield": "imufield", "imufield.drivers": "drivers", "imufield.protocols": "protocols"},
    # Made by "make wheel": it comes from the program itself, which is not installed while a package is built.
    data_files=[("share/man/man1", ["imufield.1"])] if Path("imufield.1").exists() else [],
)
