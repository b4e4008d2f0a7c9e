"""Commands of Aceinna's J1939 units."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING

from imufield.acquire.protocol.can_frames import unpack_frames

if TYPE_CHECKING:
    from drivers import aceinna_can
else:
    from imufield.drivers import aceinna_can


def text(packed: bytes) -> str:
    (frame,) = unpack_frames(packed)
    return frame.text


def test_the_request_of_the_recording(shared_folder: Path) -> None:
    vectors = json.loads((shared_folder / "wire" / "aceinna_mtlt_can.vectors.json").read_text())
    (recorded,) = [vector["hex"] for vector in vectors if vector["decoded"]["pgn"] == 59904]
    assert text(aceinna_can.request(0xFF53, source=0x80)) == recorded.upper()


def test_identity_asks_for_the_version_and_nothing_else() -> None:
    assert [text(command) for command in aceinna_can.AceinnaCan.identity_commands] == ["18EAFFF9#DAFE00"]
