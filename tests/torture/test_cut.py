"""A recording cut at any byte, as a power cut leaves it: all that was written before is read, and the session is solved."""

from __future__ import annotations

import json
import random
import shutil
from itertools import pairwise
from pathlib import Path

import pytest

from imufield.acquire.link.serial import Chunk
from imufield.acquire.recording.part_file import Damage, PartFile
from imufield.acquire.recording.reader import read_part
from imufield.acquire.recording.session import Session
from imufield.cli.run import run
from tests.commands.conftest import simulated_session
from tests.torture.conftest import Campaign

SOLVED = 8


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A session of six faces: short, so that much of the time goes in cuts."""
    return simulated_session(tmp_path_factory.mktemp("cut") / "session", "faces6").folder


def chunks_of(part: Path, damage: list[Damage]) -> list[Chunk]:
    return [item for item in read_part(part, damage) if isinstance(item, Chunk)]


def block_starts(part: Path) -> list[int]:
    """Where each block starts that the recorder wrote and synced at once."""
    with PartFile(part) as file:
        return [position for position, _ in file.contents()]


@pytest.mark.timeout(3600)
def test_cut_at_any_byte(session: Path, tmp_path: Path, campaign: Campaign, capsys: pytest.CaptureFixture[str]) -> None:
    rng = random.Random(3)
    part = session / "part-001.mcap"
    content, whole = part.read_bytes(), chunks_of(part, [])
    copy = tmp_path / "session"
    shutil.copytree(session, copy)
    times = campaign.times(60, 3000)
    starts = block_starts(part)
    reads: dict[int, list[int]] = {}
    for number in range(times):
        # A third of the cuts in the last 4 KiB, where the end of a file is written.
        at = rng.randrange(len(content) // 10, len(content)) if number % 3 else len(content) - 1 - rng.randrange(4096)
        (copy / part.name).write_bytes(content[:at])
        damage: list[Damage] = []
        read = chunks_of(copy / part.name, damage)
        assert read == whole[: len(read)], f"cut at byte {at}: what is read is not what was written"
        assert damage or len(read) == len(whole), f"cut at byte {at}: nothing was said"
        reads.setdefault(sum(start < at for start in starts), []).append(len(read))
        if number % (times // SOLVED + 1) == 0:
            assert run(["solve", str(copy), "--latitude", "48", "--json"]) in (0, 4, 6, 7), f"cut at byte {at}"
            said = capsys.readouterr()
            assert json.loads(said.out or "{}").get("format", "imufield-parameters") == "imufield-parameters"
        assert Session.open(copy).parts
    # A block that starts before the cut is whole where the next one starts before it too.
    counts = [reads[blocks] for blocks in sorted(reads)]
    assert all(max(fewer) <= min(more) for fewer, more in pairwise(counts)), "a whole block is missing"
    campaign.tell(
        "recording cut at any byte, opened, some of them solved",
        times,
        "cuts",
        "at most the block that was being written (0.3 s live); all else byte for byte",
    )
