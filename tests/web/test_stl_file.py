"""The user's own drawing of the instrument: read, refused, and named in imufield.toml."""

from __future__ import annotations

import base64
import struct
from contextlib import ExitStack
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("websockets", reason="the page needs websockets")

from imufield.commands.options.configuration import default_map, instrument_stl
from imufield.commands.terminal.page import bind_page
from imufield.errors import Reason, UsageError
from imufield.web.stl_file import MOST_TRIANGLES, read_stl
from tests.refused import refused

# Of a house of 40 x 20 x 10 mm: two triangles of its base are enough.
CORNERS: list[list[tuple[float, float, float]]] = [[(0, 0, 0), (40, 0, 0), (40, 20, 10)], [(0, 0, 0), (40, 20, 10), (0, 20, 0)]]


def stl(triangles: list[list[tuple[float, float, float]]], count: int | None = None) -> bytes:
    """Return a binary STL file; its normals are left to the reader, as many programs do."""
    body = b"".join(struct.pack("<12fH", 0, 0, 0, *np.ravel(triangle), 0) for triangle in triangles)
    return bytes(80) + struct.pack("<I", len(triangles) if count is None else count) + body


def test_a_drawing_fills_the_picture_about_its_middle(tmp_path: Path) -> None:
    path = tmp_path / "housing.stl"
    path.write_bytes(stl(CORNERS))
    values = np.frombuffer(base64.b64decode(read_stl(path)), "<i2").reshape(2, 3, 3) / 32767
    expected = (np.array(CORNERS) - [20, 10, 5]) / 20
    assert np.abs(values - expected).max() < 1e-4


@pytest.mark.parametrize(
    ("content", "key"),
    [
        (b"", "stl_file.no_stl"),
        (b"solid housing\nfacet normal 0 0 1\n", "stl_file.no_stl"),
        (stl([]), "stl_file.no_stl"),
        (stl(CORNERS)[:-1], "stl_file.no_stl"),
        (stl(CORNERS, 3), "stl_file.no_stl"),
        (stl(CORNERS, 2**32 - 1), "stl_file.no_stl"),
        (stl([[(1, 1, 1)] * 3]), "stl_file.no_stl"),
        (stl([[(0, 0, 0), (1, 0, 0), (float("nan"), 1, 0)]]), "stl_file.no_stl"),
        (stl([[(0, 0, 0), (1, 0, 0), (float("inf"), 1, 0)]]), "stl_file.no_stl"),
        (stl(CORNERS[:1] * (MOST_TRIANGLES + 1)), "stl_file.too_many"),
    ],
)
def test_what_is_no_drawing_is_refused(tmp_path: Path, content: bytes, key: str) -> None:
    path = tmp_path / "housing.stl"
    path.write_bytes(content)
    with refused(UsageError, key=key):
        read_stl(path)


def test_the_file_names_it_beside_itself(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert instrument_stl() is None
    Path("imufield.toml").write_text('driver = "stim300"\n[instrument]\nstl = "housing.stl"\n')
    assert instrument_stl() == Path("housing.stl")
    assert default_map() == {name: {"driver": "stim300"} for name in ("capture", "record", "plan")}
    # Refused before an instrument is asked anything.
    with ExitStack() as stack, refused(UsageError, key="stl_file.unreadable"):
        bind_page(stack)
    Path("imufield.toml").write_text('[instrument]\nphoto = "housing.jpg"\n')
    # Whichever command reads the file.
    for read in (instrument_stl, default_map):
        with refused(UsageError, Reason.UNKNOWN_KEY, key="configuration.unknown_key"):
            read()
