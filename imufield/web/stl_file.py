"""The user's own drawing of the instrument, for the page to show in place of the box."""

from __future__ import annotations

import base64
from functools import cache
from pathlib import Path

import numpy as np

from imufield.errors import UsageError
from imufield.files import Origin, read_small_file
from imufield.sentences import Sentences

sentence = Sentences(__package__)

MOST_TRIANGLES = 2000
"""Drawn without the help of a graphics card, sixty times a second; a housing needs some hundred."""
_HEAD_BYTES = 80  # Of a binary STL file: text of no meaning, then the number of triangles.
_TRIANGLE = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
_HALF = 32767  # Half of the longest side: a file of any size and unit fills the picture.


@cache
def read_stl(path: Path) -> str:
    """Return the triangles of a binary STL file: base64 of 16-bit integers, nine for each, about the middle.

    Its axes are those of the instrument; its unit does not matter.

    Raises
    ------
    UsageError
        If it cannot be read, is no such file, or has too many triangles.
    """
    try:
        content = read_small_file(path, Origin.FOUND)
    except OSError as error:
        raise UsageError(sentence("stl_file.unreadable", path=str(path), cause=error.strerror)) from error
    body = content[_HEAD_BYTES + 4 :]
    count = int.from_bytes(content[_HEAD_BYTES : _HEAD_BYTES + 4], "little")
    if count == 0 or len(body) != count * _TRIANGLE.itemsize:
        raise UsageError(sentence("stl_file.no_stl", path=str(path)))
    if count > MOST_TRIANGLES:
        raise UsageError(sentence("stl_file.too_many", path=str(path), found=count, limit=MOST_TRIANGLES))
    # A signalling NaN warns when it is copied.
    with np.errstate(invalid="ignore"):
        corners = np.frombuffer(body, _TRIANGLE)["corners"].astype(np.float64).reshape(-1, 3)
    if not np.isfinite(corners).all():
        raise UsageError(sentence("stl_file.no_stl", path=str(path)))
    low, high = corners.min(axis=0), corners.max(axis=0)
    half = float((high - low).max()) / 2
    if not half > 0:
        raise UsageError(sentence("stl_file.no_stl", path=str(path)))
    return base64.b64encode(np.round((corners - (low + high) / 2) / half * _HALF).astype("<i2").tobytes()).decode()
