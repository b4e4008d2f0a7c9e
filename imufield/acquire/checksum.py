"""Checksums: the address that drivers of other packages import."""

from imufield.acquire.protocol.checksum import *  # noqa: F403  the names are listed below

__all__ = ["Bytes", "Checksum", "Crc", "Fletcher", "Positions", "Sum", "Values", "Xor"]  # noqa: F405
__all__ += ["checksum_names", "make_checksum"]  # noqa: F405
