"""Which packages there are: those of ``imufield/``, and the two folders that stand beside it in a checkout."""

from setuptools import find_packages, setup

setup(
    packages=[*find_packages(include=["imufield", "imufield.*"]), "imufield.drivers", "imufield.protocols"],
    package_dir={"imufield": "imufield", "imufield.drivers": "drivers", "imufield.protocols": "protocols"},
)
