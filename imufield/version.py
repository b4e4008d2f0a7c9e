"""The version of imufield."""

__version__ = "0.1.0"
