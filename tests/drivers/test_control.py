"""Drivers that control: exchanges with instruments that answer by the facts of their wire, over real pseudo-terminals."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import pytest
from never_sent import FORBIDDEN

from imufield.acquire.decoder import Decoder
from imufield.acquire.driver import Driver
from imufield.acquire.exchange import TRIES, Command
from imufield.acquire.host_clock import SystemClock
from imufield.acquire.instrument import Instrument
from imufield.acquire.link import SerialLink, open_link
from imufield.acquire.registry import driver_names, load_driver
from imufield.errors import LinkError, LinkTimeoutError, Reason, UsageError
from imufield.simulate.instrument_aceinna import AceinnaInstrument
from imufield.simulate.instrument_microstrain import MicroStrainInstrument
from imufield.simulate.instrument_stim300 import Stim300Instrument
from imufield.simulate.instrument_vectornav import VectorNavInstrument
from imufield.simulate.instrument_witmotion import WitMotionInstrument
from imufield.simulate.instrument_xsens import XsensInstrument
from imufield.simulate.instruments import InstrumentOnPort, ScriptedInstrument


@dataclass(frozen=True)
class Case:
    """One kind of instrument, and what it is."""

    driver: str
    make: Callable[[], ScriptedInstrument]
    identity: dict[str, str]
    rate_hz: float | None = None
    """Another rate than the one it has; None where it cannot be set."""
    impossible_hz: float = 333.0
    starts: bool = True


CASES = {
    "stim300": Case(
        "stim300",
        Stim300Instrument,
        {"model": "STIM300 84167-4400003-321 K", "serial_number": "N25581846020020", "firmware": "31, hardware E"},
        500,
    ),
    "xsens": Case(
        "xsens_mtdata2",
        XsensInstrument,
        {"model": "MTi-30-2A8G4", "serial_number": "0368248C", "firmware": "1.8.2"},
    ),
    "vectornav binary": Case(
        "vectornav_binary",
        VectorNavInstrument,
        {"model": "VN-100T-CR", "serial_number": "0100012345", "firmware": "2.1.0.0"},
        200,
    ),
    "vectornav ascii": Case(
        "vectornav_ascii",
        lambda: VectorNavInstrument(binary=False),
        {"model": "VN-100T-CR", "serial_number": "0100012345", "firmware": "2.1.0.0"},
        50,
    ),
    "microstrain GX5": Case(
        "microstrain_mip",
        MicroStrainInstrument,
        {"model": "3DM-GX5-25 6251-4220", "serial_number": "6251.123456", "firmware": "1.1.34"},
        250,
    ),
    "microstrain CV7": Case(
        "microstrain_mip",
        lambda: MicroStrainInstrument(legacy=False),
        {"model": "3DM-CV7-AHRS 6251-4220", "serial_number": "6251.123456", "firmware": "1.1.34"},
        250,
    ),
    "aceinna OpenIMU": Case(
        "aceinna_serial",
        AceinnaInstrument,
        {"model": "OpenIMU300ZI 5020-3885-01 1.1.1", "serial_number": "1975000088", "firmware": "OpenIMU300ZI IMU 1.1.1"},
        200,
        starts=False,
    ),
    "aceinna DMU": Case(
        "aceinna_serial",
        lambda: AceinnaInstrument(dmu=True),
        {"model": "IMU381ZA-200 8350-3811-01", "serial_number": "1812345678", "firmware": "1.0.9.2.7"},
        50,
        starts=False,
    ),
    "witmotion": Case(
        "witmotion", WitMotionInstrument, {"serial_number": "WT5500001234", "firmware": "68062"}, 100, starts=False
    ),
}


@pytest.fixture(params=CASES)
def case(request: pytest.FixtureRequest) -> Case:
    return CASES[request.param]


@dataclass
class Bench:
    """An instrument on a port, and the driver's side of it."""

    there: ScriptedInstrument
    link: SerialLink
    here: Instrument

    def listen(self, duration_s: float) -> Decoder:
        """Read for a while."""
        decoder = Decoder(self.here.driver.load_protocol())
        clock = SystemClock()
        end_s = clock.monotonic_s() + duration_s
        while clock.monotonic_s() < end_s:
            chunk = self.link.read()
            if chunk is not None:
                decoder.feed(chunk.data, chunk.monotonic_s)
        decoder.flush()
        return decoder


@contextmanager
def bench(case: Case, *, deaf: bool = False) -> Iterator[Bench]:
    there = case.make()
    with InstrumentOnPort(there, deaf=deaf) as port:
        driver = load_driver(case.driver)
        link = open_link(port.port, baud=driver.default_baud)
        try:
            found = Bench(there, link, Instrument(driver, SystemClock()))
            found.here.heard = set(found.listen(0.3).statistics.by_kind)
            yield found
        finally:
            link.close()


def settings_of(instrument: ScriptedInstrument) -> dict[str, object]:
    return {
        name: value
        for name, value in vars(instrument).items()
        if name in ("rate_hz", "streaming", "registers", "format", "_setting")
    }


def test_identity(case: Case) -> None:
    with bench(case) as found:
        before = settings_of(found.there)
        messages = found.here.identify(found.link)
        assert found.here.driver.identity(messages) == case.identity
        assert settings_of(found.there) == before
        assert found.there.memory_writes == []
        assert found.here.chunks, "what arrived meanwhile is not lost"
        assert found.listen(0.5).statistics.samples > 5, "it goes on sending"


def test_a_wire_that_is_not_connected_costs_little_and_changes_nothing(case: Case) -> None:
    with bench(case, deaf=True) as found:
        assert found.here.driver.identity(found.here.identify(found.link)) == {}
        if case.rate_hz is not None:
            with pytest.raises(LinkError) as error:
                found.here.set_rate(found.link, case.rate_hz)
            assert error.value.reason is Reason.SILENCE
            assert not found.here.is_changed


class Counting:
    """A link that counts what is sent over it."""

    def __init__(self, link: SerialLink) -> None:
        self.name = link.name
        self.read, self.close = link.read, link.close
        self._link = link
        self.sent: list[bytes] = []

    def write(self, data: bytes) -> None:
        self.sent.append(data)
        self._link.write(data)


def test_after_one_question_without_answer_only_the_way_back_is_sent() -> None:
    with bench(CASES["xsens"], deaf=True) as found:
        counting = Counting(found.link)
        found.here.identify(counting)
        there, back = bytes.fromhex("FAFF3000D1"), bytes.fromhex("FAFF1000F1")
        assert counting.sent == [there] * TRIES + [back]


def test_rate_is_set_and_put_back(case: Case) -> None:
    with bench(case) as found:
        before = settings_of(found.there)
        if case.rate_hz is None:
            with pytest.raises(UsageError, match="never writes"):
                found.here.set_rate(found.link, 50)
            assert settings_of(found.there) == before
            return
        assert found.here.set_rate(found.link, case.rate_hz) == before["rate_hz"]
        assert found.there.rate_hz == case.rate_hz
        # By the count of samples, not by what the instrument says of itself: half a second at least must show it.
        samples = found.listen(1.0).statistics.samples
        assert 0.6 * case.rate_hz < samples < 1.4 * case.rate_hz
        found.here.restore(found.link)
        assert settings_of(found.there) == before
        assert not found.here.is_changed
        assert found.there.memory_writes == []
        assert found.listen(0.5).statistics.samples > 5


def test_impossible_rates_are_refused_before_anything_is_changed(case: Case) -> None:
    if case.rate_hz is None:
        return
    with bench(case) as found:
        before = settings_of(found.there)
        with pytest.raises(UsageError) as error:
            found.here.set_rate(found.link, case.impossible_hz)
        assert "333" in error.value.message
        assert settings_of(found.there) == before
        assert not found.here.is_changed


def test_stop_and_start(case: Case) -> None:
    with bench(case) as found:
        if not case.starts:
            assert "start and stop" not in found.here.driver.abilities
            with pytest.raises(UsageError):
                found.here.stop(found.link)
            return
        found.here.stop(found.link)
        assert not found.there.streaming
        found.here.restore(found.link)
        assert found.there.streaming
        found.there.hear(found.here.driver.stop_orders()[0].data)
        assert not found.there.streaming
        found.here.start(found.link)
        assert found.there.streaming
        assert found.listen(0.5).statistics.samples > 5
        found.here.restore(found.link)
        assert not found.there.streaming, "found silent, left silent"


def test_a_refusal_is_said_and_the_stream_goes_on() -> None:
    with bench(CASES["microstrain GX5"]) as found:
        driver = found.here.driver
        state: list[dict[str, object]] = [{"answered_command": 0x06, "error": 0, "imu_base_rate_hz": 1000}]
        state.append({"answered_command": 0x08, "error": 0, "imu_fields": "040000"})
        found.here._undo.append(driver.restore_orders(state))
        with pytest.raises(LinkError, match="refuses: set format") as error:
            found.here.restore(found.link)
        assert error.value.reason is Reason.REFUSED
        assert found.there.streaming, "the last command is sent although one before it failed"


def test_no_answer_to_an_order_is_an_error_with_its_name() -> None:
    with bench(CASES["vectornav ascii"], deaf=True) as found, pytest.raises(LinkTimeoutError, match="pause"):
        found.here.stop(found.link)


def commands_of(case: Case) -> Iterator[Command]:
    """Yield whatever the driver can send, with the states that the instrument can be in."""
    driver: type[Driver] = load_driver(case.driver)
    for heard in ((), ("0x5331",)):
        yield from driver.identity_questions(heard)
        yield from driver.state_questions(heard)
    yield from driver.stop_orders()
    yield from driver.start_orders(())
    if case.rate_hz is not None:
        with bench(case) as found:
            state = found.here._state(found.link)
        yield from driver.rate_orders(case.rate_hz, state)
        yield from driver.restore_orders(state)


def test_nothing_is_ever_written_to_memory_that_outlives_the_power(case: Case) -> None:
    sent = {command.data for command in commands_of(case)}
    assert len(sent) >= 3
    assert not [data for data in sent if FORBIDDEN[case.driver](data)]
    there = case.make()
    for data in sorted(sent):
        there.hear(data)
    assert there.memory_writes == []


def test_every_driver_with_an_ability_is_here() -> None:
    able = {name for name in driver_names() if load_driver(name).abilities}
    assert able == {case.driver for case in CASES.values()} == set(FORBIDDEN)


@pytest.mark.parametrize("text", ["VNRRG", "VNRRG,", "VNRRG,x,1", "VNRRG,75,1", "VNRRG,75,1,x", "VNRRG,07,fast", "VNRRG,01"])
@pytest.mark.parametrize("name", ["vectornav_ascii", "vectornav_binary"])
def test_answers_of_no_sense_are_no_answers(name: str, text: str) -> None:
    driver = load_driver(name)
    message = {"kind": "VNRRG", "text": text}
    assert driver.identity([message]) in ({}, {"model": ""})
    assert driver.rate_hz([message]) is None
    for command in (*driver.identity_questions(()), *driver.state_questions(())):
        assert command.answer is not None
        assert command.answer(message) in (False, text.split(",")[1:2] == [f"{int(command.name.split()[1]):02d}"])
