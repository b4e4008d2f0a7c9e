"""No instrument is taken for another, and nothing else for an instrument."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import pytest
from streams import INSTRUMENTS, OTHERS, RECORDED, chunks, flipped, others, recording, stream

from imufield.acquire.driver import Driver
from imufield.acquire.instrument.baud_search import serial_candidates
from imufield.acquire.instrument.recognise import Candidate, Listener, best, checked_bits
from imufield.acquire.registry import driver_names, load_driver

CONDITIONS = ("clean", "flipped bits", "starting inside a frame", "everything late")


@cache
def candidates() -> list[Candidate]:
    """Return all that may be heard on a port: nothing that listens changes it, and to read all protocols takes long."""
    return serial_candidates()


def listeners_of(data: bytes, bytes_per_s: float, *, stop: bool = True) -> list[Listener]:
    listeners = [Listener(one) for one in candidates()]
    for chunk in chunks(data, bytes_per_s):
        for listener in listeners:
            listener.feed(chunk)
        if stop and any(listener.is_certain for listener in listeners):
            break
    for listener in listeners:
        listener.close()
    return listeners


def heard(name: str, data: bytes, bytes_per_s: float, given: dict[str, object] | None = None) -> Listener:
    driver = load_driver(name)
    protocol = driver.load_protocol(given)
    listener = Listener(
        Candidate(name=name, title=driver.title, protocol=protocol, bauds=driver.bauds, driver=driver), is_given=True
    )
    for chunk in chunks(data, bytes_per_s):
        listener.feed(chunk)
        if listener.is_certain:
            break
    listener.close()
    return listener


def under(condition: str, data: bytes) -> bytes:
    if condition == "flipped bits":
        return flipped(data)
    if condition == "starting inside a frame":
        return data[7:]
    return data


@pytest.mark.parametrize("condition", CONDITIONS)
@pytest.mark.parametrize("name", INSTRUMENTS)
def test_every_instrument_is_recognised_and_no_other(name: str, condition: str) -> None:
    data, bytes_per_s = stream(name)
    listeners = listeners_of(under(condition, data), bytes_per_s, stop=condition != "everything late")
    found = best(listeners)
    assert found is not None, [(each.candidate.name, each.finding().reason) for each in listeners if each.finding().frames]
    assert found.candidate.name == INSTRUMENTS[name][0]
    # Increments need the rate, and the stream itself has it.
    variants: dict[str, dict[str, object]] = {"witmotion bluetooth": {"form": "bluetooth"}, "novatel ascii": {"rate_hz": 100.0}}
    assert found.candidate.variant == variants.get(name, {})
    assert {listener.candidate.name for listener in listeners if listener.finding().found} == {INSTRUMENTS[name][0]}
    finding = found.finding()
    # Without a clock of its own and with samples missing, an estimate from a second of arrivals.
    assert finding.rate_hz == pytest.approx(INSTRUMENTS[name][1], rel=0.2)
    if condition == "clean":
        assert finding.frames_bad_checksum == 0
        assert finding.checksum_ratio == 1.0


@pytest.mark.parametrize("name", OTHERS)
def test_what_is_no_instrument_is_none(name: str) -> None:
    listeners = listeners_of(*others(name))
    assert best(listeners) is None
    assert all(listener.finding().reason for listener in listeners)


@pytest.mark.parametrize("name", RECORDED)
@pytest.mark.parametrize("condition", CONDITIONS[:3])
def test_recordings_of_real_instruments_are_recognised(name: str, condition: str, shared_folder: Path) -> None:
    listeners = listeners_of(under(condition, recording(shared_folder, name)), 8000)
    found = best(listeners)
    assert found is not None
    assert found.candidate.name == RECORDED[name]
    assert {listener.candidate.name for listener in listeners if listener.finding().found} == {RECORDED[name]}


def test_recordings_before_and_behind_noise(shared_folder: Path) -> None:
    data = recording(shared_folder, "aceinna z1")
    noise, _ = others("noise")
    found = best(listeners_of(noise[:3000] + data, 8000))
    assert found is not None
    assert found.candidate.name == "aceinna_serial"


def test_frames_without_samples_are_named_but_are_no_finding(shared_folder: Path) -> None:
    data = (shared_folder / "captures" / "novatel_oem7" / "oem7_ins1_inspvas_corrimus.bin").read_bytes()
    listeners = listeners_of(data, 8000)
    assert best(listeners) is None
    novatel = next(listener.finding() for listener in listeners if listener.candidate.name == "novatel_oem7")
    assert novatel.holds_no_sample
    assert getattr(novatel.reason, "key", "") == "statistics.without_samples"
    assert "243 INSPVAS, 29 INSSTDEV, 10 CORRIMUS, 2 INSCONFIG" in novatel.reason
    assert not [each for each in listeners if each.finding().holds_no_sample and each.candidate.name != "novatel_oem7"]


def test_lines_in_g_are_doubted_unless_the_user_says_so() -> None:
    data = b"".join(f"{n / 50:.3f},0.01,0.02,0.998,0.1,0.2,0.3\n".encode() for n in range(150))
    listeners = listeners_of(data, len(data) / 3)
    assert best(listeners) is None
    doubt = next(listener.finding().reason for listener in listeners if listener.candidate.name == "text")
    assert "gravity" in doubt
    text = next(one for one in candidates() if one.name == "text")
    given = Listener(text, is_given=True)
    for chunk in chunks(data, len(data) / 3):
        given.feed(chunk)
    assert given.finding().found


def test_lines_that_come_in_bursts_are_doubted() -> None:
    data, bytes_per_s = stream("lines")
    text = Listener(next(one for one in candidates() if one.name == "text"))
    for number, chunk in enumerate(chunks(data, bytes_per_s)):
        late = 0.0 if number < 50 else 20.0
        text.feed(type(chunk)(chunk.data, chunk.monotonic_s + late, 0))
    text.close()
    assert text.finding().reason == "its frames arrive irregularly"


@pytest.mark.parametrize(("arrival_hz", "is_other"), [(250.0, True), (900.0, False), (1100.0, False), (2000.0, True)])
@pytest.mark.parametrize("given", [{}, {"rate_hz": 1000}])
def test_the_rate_is_that_of_arrival_where_time_is_counted(
    arrival_hz: float, *, is_other: bool, given: dict[str, object]
) -> None:
    # Of this instrument a counter alone tells how many samples there were, and nothing at what rate.
    data, bytes_per_s = stream("kvh")
    listener = heard("kvh_17xx", data, bytes_per_s * arrival_hz / INSTRUMENTS["kvh"][1], given)
    assert listener.decoder.time_is_counted
    found, remark = listener.at_pace()
    is_taken = is_other and not given
    assert found.protocol.clock.rate_hz == (arrival_hz if is_taken else 1000)
    assert bool(found.taken()) is is_taken
    assert (remark is not None) is (is_other and bool(given))
    assert remark is None or float(remark.values["rate_hz"]) == arrival_hz


def test_what_was_lost_on_the_way_makes_no_other_rate() -> None:
    data, bytes_per_s = stream("kvh")
    size = len(data) // round(INSTRUMENTS["kvh"][1] * len(data) / bytes_per_s)
    # Three of ten frames are lost, as the counter tells.
    kept = b"".join(data[at : at + size] for number, at in enumerate(range(0, len(data), size)) if number % 10 not in (2, 5, 6))
    found, remark = heard("kvh_17xx", kept, 0.7 * bytes_per_s).at_pace()
    assert (found.protocol.clock.rate_hz, remark) == (1000.0, None)


def test_a_rate_that_cannot_be_set_is_said() -> None:
    data, bytes_per_s = stream("kvh")
    # Read eight times as fast as it counts: the setting goes up to 5000.
    found, remark = heard("kvh_17xx", 8 * data, 8 * bytes_per_s).at_pace()
    assert found.protocol.clock.rate_hz == 1000.0
    assert remark is not None


def test_how_much_a_frame_proves() -> None:
    def bits(name: str) -> int:
        driver: type[Driver] = load_driver(name)
        return checked_bits(driver.load_protocol())

    # Header and checksum by the makers' documents.
    assert bits("stim300") == 32
    assert bits("witmotion") == 8 + 8
    assert bits("kvh_17xx") == 8 + 32
    assert bits("text") == 0
    strong = {name for name in driver_names() if load_driver(name).wire == "serial" and bits(name) >= 24}
    serial = {name for name in driver_names() if load_driver(name).wire == "serial"}
    assert serial - strong == {"text", "witmotion"}
