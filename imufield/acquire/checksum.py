"""Checksums: the import address for other packages; the code is in ``protocol.checksum``."""

from imufield.acquire.protocol.checksum import *  # noqa: F403  the names are listed below

__all__ = ["Bytes", "Checksum", "Crc", "Fletcher", "Positions", "Sum", "Values", "Xor"]  # noqa: F405
__all__ += ["checksum_names", "make_checksum"]  # noqa: F405
