"""Checksums: the address that drivers of other packages import."""

from imufield.acquire.protocol.checksum import (
    Bytes,
    Checksum,
    Crc,
    Fletcher,
    Positions,
    Sum,
    Values,
    Xor,
    checksum_names,
    make_checksum,
)

__all__ = [
    "Bytes",
    "Checksum",
    "Crc",
    "Fletcher",
    "Positions",
    "Sum",
    "Values",
    "Xor",
    "checksum_names",
    "make_checksum",
]
