"""Drivers that control: exchanges over real pseudo-terminals with emulated instruments, made from the facts of their wire."""

from __future__ import annotations

import copy
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache

import numpy as np
import pytest
from never_sent import FORBIDDEN

from imufield.acquire.decoder import Decoder
from imufield.acquire.driver import Command, Driver
from imufield.acquire.instrument.exchange import TRIES
from imufield.acquire.instrument.instrument import Instrument
from imufield.acquire.link.host_clock import SystemClock
from imufield.acquire.link.serial import SerialLink, open_link
from imufield.acquire.registry import driver_names, load_driver
from imufield.errors import LinkError, LinkTimeoutError, Reason, UsageError
from imufield.simulate.emulator.emulate import SCRIPTS, Emulation, choose_wire, make_emulator
from imufield.simulate.emulator.serial import Emulator
from imufield.simulate.instruments.device import Answer
from tests.refused import refused


@dataclass(frozen=True, eq=False)
class Case:
    """One kind of instrument, and what it is."""

    driver: str
    form: str | None
    from_hz: float
    identity: dict[str, str]
    rate_hz: float | None = None
    """Another rate than the one it has; None where it cannot be set."""
    impossible_hz: float = 333.0

    def make(self) -> Emulator:
        """Return the instrument, not yet switched on."""
        emulator = make_emulator(Emulation(device=self.driver, rate_hz=self.from_hz, seed=1, form=self.form))
        assert isinstance(emulator, Emulator)
        return emulator


LIMIT_S = 60.0
VECTORNAV = {"model": "VN-100T-CR", "serial_number": "0100012345", "firmware": "2.1.0.0"}
GX5 = {"model": "3DM-GX5-25 6251-4220", "serial_number": "6251.123456", "firmware": "1.1.34"}
CV7 = {**GX5, "model": "3DM-CV7-AHRS 6251-4220"}
OPENIMU = {"model": "OpenIMU300ZI 5020-3885-01 1.1.1", "serial_number": "1975000088", "firmware": "OpenIMU300ZI IMU 1.1.1"}
DMU = {"model": "IMU381ZA-200 8350-3811-01", "serial_number": "1812345678", "firmware": "1.0.9.2.7"}
STIM300 = {"model": "STIM300 84167-4400003-321 K", "serial_number": "N25581846020020", "firmware": "31, hardware E"}
MTI = {"model": "MTi-30-2A8G4", "serial_number": "0368248C", "firmware": "1.8.2"}
CASES = {
    "stim300": Case("stim300", None, 250, STIM300, 500),
    "xsens": Case("xsens_mtdata2", None, 100, MTI),
    "vectornav binary": Case("vectornav_binary", None, 100, VECTORNAV, 200),
    "vectornav ascii": Case("vectornav_ascii", None, 100, VECTORNAV, 50),
    "microstrain GX5": Case("microstrain_mip", "gps_time", 100, GX5, 250),
    "microstrain CV7": Case("microstrain_mip", "reference_time", 100, CV7, 250),
    "microstrain increments": Case("microstrain_mip", "increments", 100, CV7, 250),
    "aceinna OpenIMU": Case("aceinna_serial", "z1", 100, OPENIMU, 200),
    "aceinna DMU": Case("aceinna_serial", "S1", 100, DMU, 50),
    "witmotion": Case("witmotion", "uart", 50, {"serial_number": "WT5500001234", "firmware": "2526"}, 100),
}


@pytest.fixture(params=CASES)
def case(request: pytest.FixtureRequest) -> Case:
    return CASES[request.param]


@dataclass
class Bench:
    """An instrument on a port, and the driver's side of it."""

    there: Emulator
    link: SerialLink
    here: Instrument
    settings: dict[str, object]

    @property
    def streaming(self) -> bool:
        """Whether samples are sent."""
        return self.there.device.streaming

    @property
    def rate_hz(self) -> float | None:
        """Output rate."""
        return self.there.device.rate_hz

    @property
    def memory_writes(self) -> list[bytes]:
        """What would have outlived the power."""
        return writes_of(self.there)

    def listen(self, duration_s: float, samples: int = 0) -> Decoder:
        """Read for a while, and on until there are so many samples."""
        # Increments need the rate said.
        rate = {"rate_hz": self.rate_hz} if "rate_hz" in self.settings else {}
        decoder = Decoder(self.here.driver.load_protocol({**self.settings, **rate}))
        clock = SystemClock()
        end_s = clock.monotonic_s() + duration_s
        while clock.monotonic_s() < end_s or (decoder.statistics.samples < samples and clock.monotonic_s() < end_s + LIMIT_S):
            chunk = self.link.read()
            if chunk is not None:
                decoder.feed(chunk.data, chunk.monotonic_s)
        decoder.flush()
        return decoder

    def has_rate(self, rate_hz: float) -> bool:
        """Whether so many samples come in half a second; on a busy machine that may take a few to be seen."""
        return any(0.3 * rate_hz < self.listen(0.5).statistics.samples < 0.7 * rate_hz for _ in range(40))

    def until(self, condition: Callable[[], bool]) -> None:
        """Read until something is so: an order may still be on its way; and what was sent before."""
        end_s, quiet = time.monotonic() + LIMIT_S, 0
        while not condition():
            assert time.monotonic() < end_s
            self.link.read()
        while not self.streaming and quiet < 3:
            quiet = quiet + 1 if self.link.read() is None else 0


def writes_of(emulator: Emulator) -> list[bytes]:
    found = getattr(emulator.device, "memory_writes")  # noqa: B009  not part of every device
    assert isinstance(found, list)
    return found


@contextmanager
def bench(case: Case, *, deaf: bool = False) -> Iterator[Bench]:
    there = case.make()
    with pytest.MonkeyPatch.context() as patch, there:
        if deaf:
            there.device.receive = lambda data: Answer()  # type: ignore[method-assign]
            # However long one waits, nothing comes.
            patch.setattr("imufield.acquire.instrument.exchange.ANSWER_S", 0.1)
        driver = load_driver(case.driver)
        link = open_link(there.port, baud=driver.default_baud)
        try:
            settings = choose_wire(Emulation(device=case.driver, rate_hz=case.from_hz, form=case.form)).settings
            found = Bench(there, link, Instrument(driver, SystemClock()), settings)
            found.here.heard = set(found.listen(0.1, samples=5).statistics.by_kind)
            yield found
        finally:
            link.close()


def settings_of(emulator: Emulator) -> dict[str, object]:
    script = getattr(emulator.device, "script", emulator.device)
    names = ("rate_hz", "streaming", "registers", "format", "setting")
    return {name: copy.deepcopy(getattr(script, name)) for name in names if hasattr(script, name)}


def test_identity(case: Case) -> None:
    with bench(case) as found:
        before = settings_of(found.there)
        messages = found.here.identify(found.link)
        assert found.here.driver.identity(messages) == case.identity
        assert settings_of(found.there) == before
        assert found.memory_writes == []
        assert found.here.chunks, "what arrived meanwhile is not lost"
        assert found.listen(0.1, samples=6).statistics.samples > 5, "it goes on sending"


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
            with refused(UsageError, Reason.USAGE, "--rate-hz"):
                found.here.set_rate(found.link, 50)
            assert settings_of(found.there) == before
            return
        assert found.here.set_rate(found.link, case.rate_hz) == before["rate_hz"]
        assert found.rate_hz == case.rate_hz
        # By the count of samples, not by what the instrument says of itself.
        assert found.has_rate(case.rate_hz)
        found.here.restore(found.link)
        assert settings_of(found.there) == before
        assert not found.here.is_changed
        assert found.memory_writes == []
        assert found.listen(0.1, samples=6).statistics.samples > 5


def test_impossible_rates_are_refused_before_anything_is_changed(case: Case) -> None:
    if case.rate_hz is None:
        return
    with bench(case) as found:
        before = settings_of(found.there)
        with refused(UsageError, Reason.USAGE, "333"):
            found.here.set_rate(found.link, case.impossible_hz)
        assert settings_of(found.there) == before
        assert not found.here.is_changed


def test_stop_and_start(case: Case) -> None:
    with bench(case) as found:
        before = settings_of(found.there)
        found.here.stop(found.link)
        # A WitMotion answers no order, so it may still be on its way.
        found.until(lambda: not found.streaming)
        assert found.listen(0.3).statistics.samples == 0
        found.here.restore(found.link)
        found.until(lambda: settings_of(found.there) == before)
        assert found.listen(0.1, samples=6).statistics.samples > 5
        assert found.memory_writes == []


def test_found_silent_left_silent(case: Case) -> None:
    with bench(case) as found:
        for order in found.here.driver.stop_orders(found.here._read_state(found.link)):
            found.there.device.receive(order.data)
        # Of a silent instrument no frames were heard that tell the family.
        found.here.heard = set()
        found.until(lambda: not found.streaming)
        before = settings_of(found.there)
        assert not before["streaming"]
        found.here.start(found.link)
        assert found.listen(0.1, samples=6).statistics.samples > 5
        found.here.restore(found.link)
        found.until(lambda: {**settings_of(found.there), "rate_hz": 0} == {**before, "rate_hz": 0})
        assert found.memory_writes == []


@pytest.mark.parametrize("name", ["witmotion", "aceinna OpenIMU"])
def test_what_does_not_answer_is_not_started(name: str) -> None:
    with bench(CASES[name], deaf=True) as found:
        with refused(LinkTimeoutError, Reason.SILENCE, found.here.driver.title):
            found.here.stop(found.link)
        assert not found.here.is_changed


def test_a_refusal_is_said_and_the_stream_goes_on() -> None:
    with bench(CASES["microstrain GX5"]) as found:
        driver = found.here.driver
        state: list[dict[str, object]] = [{"answered_command": 0x06, "error": 0, "imu_base_rate_hz": 1000}]
        state.append({"answered_command": 0x08, "error": 0, "imu_fields": "040000"})
        found.here._undo.append(driver.restore_orders(state))
        with refused(LinkError, Reason.REFUSED, "set format") as error:
            found.here.restore(found.link)
        assert error.value.reason is Reason.REFUSED
        assert found.streaming, "the last command is sent although one before it failed"


def test_no_answer_to_an_order_is_an_error_with_its_name() -> None:
    with bench(CASES["vectornav ascii"], deaf=True) as found, refused(LinkTimeoutError, Reason.SILENCE, "pause"):
        found.here.stop(found.link)


@cache
def commands_of(case: Case) -> list[Command]:
    """Return whatever the driver can send, with the states that the instrument can be in."""
    driver: type[Driver] = load_driver(case.driver)
    commands: list[Command] = []
    for heard in ((), ("0x5331",)):
        commands += [*driver.identity_questions(heard), *driver.state_questions(heard)]
    with bench(case) as found:
        state = found.here._read_state(found.link)
    commands += [*driver.stop_orders(state), *driver.start_orders(state)]
    if case.rate_hz is not None:
        commands += [*driver.rate_orders(case.rate_hz, state), *driver.restore_orders(state)]
    return commands


def test_nothing_is_ever_written_to_memory_that_outlives_the_power(case: Case) -> None:
    sent = {command.data for command in commands_of(case)}
    assert len(sent) >= 3
    assert not [data for data in sent if FORBIDDEN[case.driver](data)]
    there = case.make()
    for data in sorted(sent):
        there.device.receive(data)
    there.stop()
    assert writes_of(there) == []


def test_every_driver_with_an_ability_is_here() -> None:
    able = {name for name in driver_names() if load_driver(name).abilities}
    assert able == {case.driver for case in CASES.values()} == set(FORBIDDEN)


def test_every_script_is_tried() -> None:
    assert {*SCRIPTS, "stim300"} == {case.driver for case in CASES.values()}


def test_whatever_is_sent_to_an_instrument_it_goes_on(case: Case) -> None:
    rng = np.random.default_rng(11)
    there = case.make()
    good = [command.data for command in commands_of(case)]
    for _ in range(400):
        data = bytearray(good[rng.integers(len(good))])
        for _ in range(rng.integers(0, 4)):
            data[rng.integers(len(data))] = rng.integers(256)
        there.device.receive(bytes(data[: rng.integers(1, len(data) + 1)]))
        there.device.receive(rng.bytes(int(rng.integers(0, 40))))
    there.stop()
    assert there.device.rate_hz


def test_a_format_keeps_the_fields_that_have_their_own_rate() -> None:
    driver = load_driver("microstrain_mip")
    state: list[dict[str, object]] = [{"answered_command": 0x06, "error": 0, "imu_base_rate_hz": 1000}]
    state.append({"answered_command": 0x08, "error": 0, "imu_fields": "04000a05000a060032"})
    _, order, _ = driver.rate_orders(250, state)
    assert order.data[6:-2].hex() == "0103040004050004060032"


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
