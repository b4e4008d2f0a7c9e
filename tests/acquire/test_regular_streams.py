"""What is nearly always so has short ways through framer and clocks: they give what the long ones do, bit for bit."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

import pytest

from imufield.acquire.clock.sample_clock import SampleClock
from imufield.acquire.clock.stamp_clock import StampClock
from imufield.acquire.decode.framing import Bytes, Framer
from imufield.acquire.protocol.protocol import load_protocol
from imufield.samples import Samples, concatenate
from tests.acquire.streams import INSTRUMENTS
from tests.acquire.test_golden_samples import OPTIONS, Run, arriving, cut, damaged, play, values_of

SECONDS = 2.5
SHORT_WAYS = ((Framer, "_as_before"), (SampleClock, "_time_evenly"), (StampClock, "_time_forward"))
MARKED = sorted(name for name, (driver, _, _) in INSTRUMENTS.items() if load_protocol(driver, OPTIONS.get(name, {})).frame)


@cache
def stream(name: str) -> bytes:
    _, rate_hz, sample = INSTRUMENTS[name]
    return b"".join(sample(number, number / rate_hz) for number in range(round(SECONDS * min(rate_hz, 500))))


def everything(run: Run) -> tuple[bytes, bytes, object, object]:
    samples: Samples = concatenate(run.blocks)
    own = samples.sensor_temperature_degc
    times = samples.time_s.tobytes() + (b"" if own is None else own.tobytes())
    return values_of(samples), times, run.decoder.statistics, run.decoder.messages()


@pytest.mark.parametrize("name", sorted(INSTRUMENTS))
@pytest.mark.parametrize("spoil", [bytes, lambda data: damaged(data, 3)], ids=["clean", "damaged"])
def test_short_ways_give_what_the_long_ones_do(
    name: str, spoil: Callable[[bytes], bytes], monkeypatch: pytest.MonkeyPatch
) -> None:
    data = spoil(stream(name))
    protocol = load_protocol(INSTRUMENTS[name][0], OPTIONS.get(name, {}))
    reads = [cut(data, 1), arriving(data, len(data) / SECONDS, 2)]
    short = [everything(play(protocol, each)) for each in reads]
    for owner, method in SHORT_WAYS:
        monkeypatch.setattr(owner, method, lambda *_: None)
    long = [everything(play(protocol, each)) for each in reads]
    assert short == long


@pytest.mark.parametrize("name", MARKED)
def test_a_clean_stream_goes_the_short_way_however_it_is_cut(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    data = stream(name)
    taken: list[bool] = []
    as_before = Framer._as_before

    def watched(framer: Framer, buffer: Bytes) -> object:
        found = as_before(framer, buffer)
        taken.append(isinstance(found, tuple))
        return found

    monkeypatch.setattr(Framer, "_as_before", watched)
    play(load_protocol(INSTRUMENTS[name][0], OPTIONS.get(name, {})), cut(data, 4, reads=30))
    # A read goes the long way that is shorter than a turn of frames, or ends between a frame and its trailer.
    assert sum(taken) >= 15
