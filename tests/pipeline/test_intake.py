"""The way of reads to disk and guide: on disk at once, decoded together, all heard where somebody asks, events in one order."""

from __future__ import annotations

from collections import Counter
from itertools import islice, pairwise
from pathlib import Path

import numpy as np
import pytest

from imufield.acquire.decoded_session import UNPLUGGED, recorded_protocol
from imufield.acquire.instrument.same_stream import SameStream
from imufield.acquire.link.chunk import Chunk
from imufield.acquire.recording.reader import RecordedEvent, read_part
from imufield.acquire.recording.recorder import Recorder, part_metadata
from imufield.acquire.recording.session import Session
from imufield.pipeline.chain import MARK, Chain, ReadingPlan
from imufield.pipeline.intake import Intake
from imufield.samples import Samples
from tests.commands.conftest import CHUNK_SAMPLES, RATE_HZ, simulated_session

CHUNKS = 200
LONGEST_WAIT_S = 0.1 + CHUNK_SAMPLES / RATE_HZ  # Of a read until it is decoded, where others follow.


@pytest.fixture
def recorded(tmp_path: Path) -> tuple[Session, list[Chunk]]:
    session = simulated_session(tmp_path / "here", "faces6", visits=1)
    return session, list(islice((item for item in read_part(session.parts[0]) if isinstance(item, Chunk)), CHUNKS))


def test_reads_are_on_disk_at_once_and_decoded_together(recorded: tuple[Session, list[Chunk]], tmp_path: Path) -> None:
    session, chunks = recorded
    protocol = recorded_protocol({}, session)
    blocks: list[Samples] = []
    chain = Chain(ReadingPlan.of(session), listeners=(blocks.append,))
    chain.start_part(protocol)
    path = tmp_path / "again.mcap"
    with Recorder(path, part_metadata(protocol, {})) as recorder:
        intake = Intake(recorder=recorder, chain=chain, stream=SameStream("port"))
        for number, chunk in enumerate(chunks, 1):
            intake.take(chunk)
            late = number * CHUNK_SAMPLES - sum(map(len, blocks))
            assert late <= LONGEST_WAIT_S * RATE_HZ + CHUNK_SAMPLES
        assert len(blocks) < CHUNKS / 2
        intake.catch_up()
        assert sum(map(len, blocks)) == CHUNKS * CHUNK_SAMPLES
        intake.take(chunks[0])
    assert [item for item in read_part(path) if isinstance(item, Chunk)] == [*chunks, chunks[0]]


def test_events_stand_in_one_order_whenever_the_link_was_silent(tmp_path: Path) -> None:
    session = simulated_session(tmp_path / "here", "faces6", visits=4)
    chunks = [item for item in read_part(session.parts[0]) if isinstance(item, Chunk)]
    draw = np.random.default_rng(1)
    lost, marked, now_and_then = (set(draw.choice(len(chunks), count, replace=False)) for count in (6, 6, len(chunks) // 3))

    def record(name: str, silent: set[int]) -> list[dict[str, object]]:
        protocol, path = recorded_protocol({}, session), tmp_path / f"{name}.mcap"
        with Recorder(path, part_metadata(protocol, {})) as recorder:
            stream = SameStream("port")
            chain = Chain(ReadingPlan.of(session), listeners=(stream.hear,))
            intake = Intake(recorder=recorder, chain=chain, stream=stream)
            intake.start_part(protocol)
            for number, chunk in enumerate(chunks):
                intake.take(chunk)
                if number in silent:
                    intake.catch_up()
                if number in marked:
                    intake.mark("pause")
                if number in lost:
                    intake.link_lost()
            intake.finish()
        return [item.event for item in read_part(path) if isinstance(item, RecordedEvent)]

    never = record("never", set())
    kinds = Counter(event["event"] for event in never)
    assert kinds[UNPLUGGED] == len(lost)
    assert kinds[MARK] == len(marked)
    assert kinds["link_lost"] == len(lost)
    # Without holds there is little that could change places.
    assert kinds["holding"] > 0
    assert all(behind["event"] == UNPLUGGED for event, behind in pairwise(never) if event["event"] == "link_lost")
    assert never == record("always", set(range(len(chunks))))
    assert never == record("now and then", now_and_then)
