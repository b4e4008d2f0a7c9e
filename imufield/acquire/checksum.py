"""Checksums: the address that drivers of other packages import."""

from imufield.acquire.protocol.checksum import Checksum, Crc, Fletcher, Sum, Xor, checksum_names, make_checksum

__all__ = ["Checksum", "Crc", "Fletcher", "Sum", "Xor", "checksum_names", "make_checksum"]
