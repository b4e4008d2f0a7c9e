"""Whether what comes behind a reconnection is of the instrument that was there before."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from imufield.acquire.instrument.connected import Connected
from imufield.acquire.instrument.instrument import Instrument
from imufield.acquire.instrument.same_stream import SameStream
from imufield.acquire.link.background import BackgroundLink
from imufield.acquire.link.host_clock import SystemClock
from imufield.acquire.link.reconnect import ReconnectingLink
from imufield.acquire.link.serial import Chunk
from imufield.acquire.protocol.protocol import load_protocol
from imufield.acquire.registry import load_driver
from imufield.errors import LinkError, Reason, UsageError
from imufield.samples import Samples, SampleUnits, Status, make_samples
from tests.acquire.link.test_background import Scripted
from tests.refused import refused


def samples(rate_hz: float, begin_s: float, duration_s: float) -> Samples:
    time_s = begin_s + np.arange(round(rate_hz * duration_s)) / rate_hz
    return make_samples(time_s, np.tile([0.0, 0.0, 9.8], (len(time_s), 1)), None, units=SampleUnits())


def run(stream: SameStream, rate_hz: float, begin_s: float, duration_s: float) -> None:
    """Open the link and hear what comes in reads of 0.1 s; nothing but bytes at a rate of 0."""
    stream.begin()
    for now_s in np.arange(begin_s, begin_s + duration_s, 0.1).tolist():
        stream.check(Chunk(b"?", now_s, 0))
        if rate_hz:
            stream.hear(samples(rate_hz, now_s, 0.1))


@pytest.mark.parametrize("rate_hz", [50.0, 125.0, 200.0])
def test_another_rate_is_another_instrument(rate_hz: float) -> None:
    stream = SameStream("port")
    run(stream, 100.0, 0.0, 5.0)
    with refused(LinkError, Reason.FOREIGN, "port", key="same_stream.rate"):
        run(stream, rate_hz, 20.0, 5.0)


def test_times_that_stand_or_jump_tell_no_rate() -> None:
    stream = SameStream("port")
    stream.begin()
    for number in range(60):
        stream.check(Chunk(b"?", 0.1 * number, 0))
        time_s = np.repeat(float(number), 10)
        stream.hear(make_samples(time_s, np.tile([0.0, 0.0, 9.8], (10, 1)), None, units=SampleUnits()))
    run(stream, 200.0, 20.0, 5.0)


def test_a_slow_crystal_is_the_same_instrument() -> None:
    stream = SameStream("port")
    for number, rate_hz in enumerate((100.0, 96.0, 104.0, 100.0)):
        run(stream, rate_hz, 20.0 * number, 5.0)


def test_bytes_without_samples_are_borne_for_a_while() -> None:
    stream = SameStream("port")
    run(stream, 100.0, 0.0, 5.0)
    run(stream, 0.0, 20.0, 9.0)
    run(stream, 100.0, 40.0, 5.0)
    with refused(LinkError, Reason.FOREIGN, "port", key="same_stream.kind"):
        run(stream, 0.0, 60.0, 12.0)


def paced(pace: float, *, burst_s: float = 0.0, status: int = 0, window_s: float = 1.0, share: float = 2 / 3) -> None:
    """Hear 15 windows of a stream whose clock runs ``pace`` times as fast, a share of it, behind what had waited."""
    stream = SameStream("port", window_s)
    stream.begin()
    begin_s = 0.0
    for number in range(round(150 * window_s)):
        stream.check(Chunk(b"?", 0.1 * number, 0))
        heard = samples(100.0, begin_s, 0.1 * pace + (burst_s if number == 3 else 0.0))
        heard = heard[: round(share * len(heard))]
        stream.hear(replace(heard, status=np.full(len(heard), status, dtype=np.uint32)))
        begin_s += 0.1 * pace + (burst_s if number == 3 else 0.0)


def test_a_stream_that_is_faster_than_its_own_clock_and_lossy_is_told() -> None:
    with refused(UsageError, Reason.USAGE, "port", "--clock-speed", key="same_stream.fast") as caught:
        paced(6.0)
    assert caught.value.message.values["pace"] == pytest.approx(4.0, rel=0.05)  # type: ignore[attr-defined]
    with refused(UsageError, Reason.USAGE, "port", key="same_stream.fast"):
        paced(6.0, window_s=4.0)


def test_what_had_waited_is_no_fast_stream_and_the_clock_of_the_host_tells_nothing() -> None:
    paced(1.0)
    paced(1.0, burst_s=60.0)
    paced(6.0, status=int(Status.TIME_ESTIMATED))


def test_a_fast_stream_that_is_whole_is_read_by_its_own_clock() -> None:
    paced(6.0, share=1.0)


class AskedInstrument:
    """Answers with a serial number."""

    interrupted = False

    def __init__(self, found: dict[str, str]) -> None:
        self.driver = SimpleNamespace(identity=lambda _: found)
        self.chunks = [Chunk(b"while asked", 1.1, 0)]
        self.is_changed = True

    def identify(self, _: Any) -> list[Any]:
        return []

    def forget_changes(self) -> None:
        self.is_changed = False


def connected(found: dict[str, str]) -> Connected:
    return Connected(
        link=SimpleNamespace(name="port"),  # type: ignore[arg-type]
        protocol=load_protocol("stim300"),
        driver="stim300",
        model="m",
        baud=None,
        chunks=[],
        identity={"serial_number": "N1"},
        instrument=AskedInstrument(found),  # type: ignore[arg-type]
    )


@pytest.mark.parametrize("found", [{"serial_number": "N1"}, {}])
def test_who_answers_the_same_or_nothing_goes_on(found: dict[str, str]) -> None:
    chunks = [Chunk(b"first", 1.0, 0)]
    connected(found).ask_again(chunks)
    assert [chunk.data for chunk in chunks] == [b"first", b"while asked"]


def test_another_serial_number_ends_the_session_and_nothing_is_put_back_there() -> None:
    one = connected({"serial_number": "N2"})
    with refused(LinkError, Reason.FOREIGN, "port", "N1", "N2", key="connected.other_instrument"):
        one.ask_again([Chunk(b"first", 1.0, 0)])
    assert one.instrument is not None
    assert not one.instrument.is_changed


@pytest.mark.parametrize("driver", ["stim300", "vectornav_binary"])
def test_what_was_read_counts_where_the_link_goes_while_the_instrument_is_asked(driver: str) -> None:
    wire, clock = Scripted(b"before", LinkError("gone")), SystemClock()
    one = replace(connected({}), link=BackgroundLink(wire), instrument=Instrument(load_driver(driver), clock))
    link = ReconnectingLink(one.link, clock, one.ask_again)
    heard: list[bytes] = []

    def read_until_lost() -> None:
        while link.lost is None:
            chunk = link.read()
            heard.extend([] if chunk is None else [chunk.data])

    read_until_lost()
    wire.there, wire.items = True, [b"first", b"while asked", LinkError("gone again")]
    while link.lost is not None:
        assert link.read() is None
    read_until_lost()
    one.link.close()
    assert wire.written
    assert heard == [b"before", b"first", b"while asked"]


def test_what_was_read_is_there_where_a_person_ends_it_while_the_instrument_is_asked() -> None:
    class Interrupted(Scripted):
        def write(self, data: bytes) -> None:
            raise KeyboardInterrupt

    wire, clock = Interrupted(LinkError("gone")), SystemClock()
    one = replace(connected({}), link=BackgroundLink(wire), instrument=Instrument(load_driver("stim300"), clock))
    link = ReconnectingLink(one.link, clock, one.ask_again)
    while link.lost is None:
        link.read()

    wire.there, wire.items = True, [b"first"]
    with pytest.raises(KeyboardInterrupt):  # noqa: PT012  whichever read it is
        while True:
            link.read()
    assert [chunk.data for chunk in one.link.drain()] == [b"first"]
    one.link.close()
