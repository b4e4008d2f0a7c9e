"""The first picture of a long recording: some seconds of it, at the times that a full reading gives them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from imufield.acquire.recording.reader import Damage
from imufield.acquire.recording.session import Session
from imufield.pipeline import chain
from imufield.pipeline.chain import session_outline, session_samples
from imufield.samples import concatenate
from tests.commands.conftest import simulated_session
from tests.told import key_of

EVERY = 5
CHUNK_S = 0.1  # More than a read of the simulated session: a time by arrival is that uncertain.


def test_some_seconds_of_all_parts_are_read_at_their_times(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    session = simulated_session(tmp_path / "here", "faces6")
    size = sum(path.stat().st_size for path in session.parts)
    monkeypatch.setattr(chain, "OUTLINE_BYTES", -(-size // EVERY))
    full = concatenate(list(session_samples(session, [])))
    some = concatenate(list(session_outline(session, [])))
    assert len(some) == pytest.approx(len(full) / EVERY, rel=0.15)
    # Noise makes each sample another one: the same in both is found by its values.
    at_s = {values.tobytes(): time_s for values, time_s in zip(full.accelerometer, full.time_s, strict=True)}
    expected_s = np.array([at_s[values.tobytes()] for values in some.accelerometer])
    assert np.abs(some.time_s - expected_s).max() < CHUNK_S
    # No second of the recording is farther than that from one that is shown.
    assert np.diff(some.time_s).max() < EVERY + 1
    assert full.time_s[-1] - some.time_s[-1] < EVERY + 1


@pytest.mark.parametrize("limit", [1 << 40, 1])
def test_a_recording_under_way_is_said_to_be_that(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, limit: int) -> None:
    """Whatever reads it, whole or in part: the end that its last part still lacks is no damage."""
    session = simulated_session(tmp_path / "here", "faces6")
    part = session.parts[-1]
    part.write_bytes(part.read_bytes()[:-8])
    monkeypatch.setattr(chain, "OUTLINE_BYTES", limit)
    for read in (session_samples, session_outline):
        cut: list[Damage] = []
        count = len(concatenate(list(read(session, cut))))
        with session.lock():
            found: list[Damage] = []
            assert len(concatenate(list(read(session, found)))) == count
        assert [key_of(entry.what) for entry in found] == ["damage.goes_on"]
        assert [(entry.path, entry.offset, entry.torn_end) for entry in found] == [(part, cut[0].offset, True)]
        assert key_of(cut[0].what).startswith("part_file.")


@pytest.mark.parametrize(("limit", "kind"), [(1 << 40, "capture"), (1, "import")])
def test_a_short_recording_and_an_import_are_read_whole(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, limit: int, kind: str
) -> None:
    session = simulated_session(tmp_path / "here", "faces6")
    settings = session.folder / "session.toml"
    settings.write_text(settings.read_text().replace('kind = "capture"', f'kind = "{kind}"'))
    session = Session.open(session.folder)
    monkeypatch.setattr(chain, "OUTLINE_BYTES", limit)
    full, some = (concatenate(list(read(session, []))) for read in (session_samples, session_outline))
    np.testing.assert_array_equal(some.time_s, full.time_s)
