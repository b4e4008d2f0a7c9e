"""Tell whether a file is a log of a CAN bus, without the packages that read one."""

from __future__ import annotations

import re
import zlib
from pathlib import Path

from imufield.acquire.formats.foreign_file_reader import SoundGzip
from imufield.files import open_to_read

CANDUMP = ".log"
TABLE = ".csv"
# What each kind begins with.
HEADS = {
    CANDUMP: rb"\s*\(\d+\.\d+\)\s",
    ".asc": rb"(?i)\s*(date|base)\s",
    ".blf": rb"LOGG",
    ".trc": rb"\s*;",
    ".mf4": rb"MDF",
    TABLE: rb"timestamp,arbitration_id,",
}
SUFFIXES = tuple(suffix for suffix in HEADS if suffix != TABLE)
"""Logs this module reads, packed with gzip too; besides, tables of python-can."""
_HEAD_BYTES = 256


def is_can_log(path: str | Path) -> bool:
    """Tell by the name whether a file is a log of a CAN bus."""
    return any(suffix in SUFFIXES for suffix in Path(path).suffixes[-2:])


def begins_as_can_log(path: str | Path) -> bool:
    """Tell by name and first lines whether a file is a log of a CAN bus: others' logs and grids have the same suffixes."""
    suffixes = Path(path).suffixes[-2:]
    heads = [head for suffix, head in HEADS.items() if suffix in suffixes]
    if not heads:
        return False
    try:
        with open_to_read(path) as file:
            begin = (SoundGzip(fileobj=file) if suffixes[-1] == ".gz" else file).read(_HEAD_BYTES)
    except (OSError, EOFError, zlib.error):
        return False
    return any(re.match(head, begin) for head in heads)
