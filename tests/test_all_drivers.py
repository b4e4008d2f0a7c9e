"""Every driver that ships: names, documentation, limits, protocol, vectors, and its emulated instrument read back."""

from __future__ import annotations

import inspect
import json
import os
import re
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from imufield.acquire.decoder import Decoder
from imufield.acquire.driver import Driver
from imufield.acquire.link.serial import Link, open_link
from imufield.acquire.protocol.can_frame import EXTENDED, pack_frame
from imufield.acquire.protocol.protocol import Protocol, load_protocol, protocol_names
from imufield.acquire.registry import load_driver, shipped_names
from imufield.samples import Samples, concatenate
from imufield.simulate.emulator.core import EmulatorCore, EmulatorSettings
from imufield.simulate.emulator.emulate import Emulation, choose_wire, make_emulator
from tests.opened_can import open_can

NAMES = shipped_names()
PROTOCOLS_WITHOUT_DRIVER = {"rows_f64": "written by imufield itself, no instrument sends it"}
LONGEST_DRIVER_LINES = 150
VECTORS = {
    "aceinna_serial": "aceinna_openimu_serial",
    "bosch_mm510": "can_imus",
    "j1939_imu": "aceinna_mtlt_can",
    "kvh_17xx": "kvh_1750",
    "microstrain_mip": "microstrain_mip",
    "novatel_oem7": "novatel_rawimu",
    "novatel_oem7_ascii": "novatel_rawimu",
    "racelogic_can": "can_imus",
    "sbg_can": "can_imus",
    "sbg_sbgecom": "sbg_sbgecom",
    "stim300": "stim300",
    "vectornav_ascii": "vectornav",
    "vectornav_binary": "vectornav",
    "witmotion": "witmotion",
    "xsens_can": "can_imus",
    "xsens_mtdata2": "xsens_mtdata2",
}
"""Files of test vectors by protocol; those of each format are compared value by value in tests/acquire."""
NUMBER_OF_VECTORS = 229
WITHOUT_VECTORS = {"text": "numbers as one writes them", "motioncal": "tests/drivers/test_motioncal.py"}
DURATION_S = 2.0


@pytest.fixture(params=NAMES)
def driver(request: pytest.FixtureRequest) -> type[Driver]:
    return load_driver(request.param)


def test_a_serial_driver_names_its_interface(driver: type[Driver]) -> None:
    """Whoever buys the adapter has to know it."""
    assert (driver.wiring != Driver.wiring) == (driver.wire == "serial")
    assert driver.wire == "can" or re.search("RS-422|RS-232|UART|USB", driver.wiring)


def test_name_is_the_file(driver: type[Driver]) -> None:
    file = Path(inspect.getfile(driver))
    assert (file.parent.name, file.name) == ("drivers", f"{driver.name}.py")
    assert re.fullmatch(r"[a-z][a-z0-9_]*", driver.name)
    assert len(file.read_text(encoding="utf-8").splitlines()) <= LONGEST_DRIVER_LINES


def test_documentation_and_manual(driver: type[Driver]) -> None:
    assert driver.__doc__
    assert len(driver.__doc__.splitlines()) > 3, "the class docstring states the frame"
    assert driver.title
    assert driver.manual
    assert driver.status in ("verified on real bytes", "document only")


def test_bauds(driver: type[Driver]) -> None:
    assert driver.default_baud == driver.bauds[0]
    assert len(set(driver.bauds)) == len(driver.bauds)
    assert all(1200 <= baud <= 12_000_000 for baud in driver.bauds)


def test_protocol_loads_and_noise_gives_no_crash(driver: type[Driver]) -> None:
    protocol = driver.load_protocol()
    assert protocol.name == driver.protocol
    assert set(driver.settings) <= set(protocol.settings)
    decoder = Decoder(protocol)
    assert len(decoder.feed(bytes(range(256)) * 4, 0.0)) == 0


def test_nothing_said_means_nothing_known(driver: type[Driver]) -> None:
    assert driver.identity([]) == {}
    assert driver.read_settings([]) == {}


def test_every_protocol_has_a_driver() -> None:
    spoken = {load_driver(name).protocol for name in NAMES}
    assert spoken | set(PROTOCOLS_WITHOUT_DRIVER) == set(protocol_names())
    assert not spoken & set(PROTOCOLS_WITHOUT_DRIVER)


def test_every_protocol_has_vectors(driver: type[Driver], shared_folder: Path) -> None:
    assert (driver.protocol in VECTORS) != (driver.protocol in WITHOUT_VECTORS)
    if driver.protocol in VECTORS:
        path = shared_folder / "wire" / f"{VECTORS[driver.protocol]}.vectors.json"
        assert json.loads(path.read_text(encoding="utf-8"))


def vectors_of(path: Path) -> list[dict[str, Any]]:
    found: list[dict[str, Any]] = json.loads(path.read_text(encoding="utf-8"))
    return found


def test_every_file_of_vectors_belongs_to_a_protocol(shared_folder: Path) -> None:
    paths = list((shared_folder / "wire").glob("*.vectors.json"))
    assert {path.name.partition(".")[0] for path in paths} == set(VECTORS.values())
    assert sum(len(vectors_of(path)) for path in paths) == NUMBER_OF_VECTORS


def bytes_of(protocol: Protocol, vector: dict[str, Any]) -> bytes:
    if protocol.can is None:
        return bytes.fromhex(vector["hex"])
    identifier, _, data = vector["hex"].partition("#")
    number = int(identifier, 16)
    return pack_frame(number | EXTENDED if len(identifier) > 3 else number, bytes.fromhex(data), 1.0)


def outcome(protocol: Protocol, data: bytes, edges: list[int]) -> tuple[Any, ...]:
    """Return all that a decoder makes of bytes that come in pieces: frames, what was wrong, messages, samples."""
    decoder = Decoder(protocol)
    blocks = [decoder.feed(data[begin:end], 0.0) for begin, end in pairwise([0, *edges, len(data)])]
    samples, counts = concatenate([*blocks, decoder.flush()]), decoder.statistics
    parts = (samples.accelerometer, samples.gyroscope, samples.temperature_degc, samples.counter, samples.status)
    numbers = (counts.frames, counts.frames_bad_checksum, counts.bytes_skipped, dict(counts.by_kind), len(samples))
    return (*numbers, repr(decoder.messages()), *(part.tobytes() for part in parts))


def test_vectors_mean_the_same_however_they_are_cut(driver: type[Driver], shared_folder: Path) -> None:
    """All vectors of the driver's file, good and bad: whole, byte by byte, cut at random, and one behind another."""
    if driver.protocol not in VECTORS:
        return
    protocol, rng = driver.load_protocol(), np.random.default_rng(5)
    vectors = vectors_of(shared_folder / "wire" / f"{VECTORS[driver.protocol]}.vectors.json")
    every = [bytes_of(protocol, vector) for vector in vectors]
    for data in (*every, b"".join(every), b"".join(reversed(every))):
        whole = outcome(protocol, data, [])
        assert outcome(protocol, data, list(range(1, len(data)))) == whole
        for _ in range(3):
            assert outcome(protocol, data, sorted(rng.integers(0, len(data), 4).tolist())) == whole


def test_a_vector_that_is_said_to_be_wrong_is_no_frame(driver: type[Driver], shared_folder: Path) -> None:
    if driver.protocol in VECTORS:
        for vector in vectors_of(shared_folder / "wire" / f"{VECTORS[driver.protocol]}.vectors.json"):
            if not vector.get("valid", True):
                protocol = driver.load_protocol()
                frames = outcome(protocol, bytes_of(protocol, vector), [])[0]
                assert frames == 0, vector


def test_status_is_that_of_the_protocol(driver: type[Driver]) -> None:
    protocol = load_protocol(driver.protocol)
    # A protocol may have been tried on another maker's instrument than this one, never the other way round.
    assert driver.status == "document only" or protocol.status == driver.status


def read(link: Link, decoder: Decoder, emulator: EmulatorCore) -> Samples:
    blocks, quiet = [], 0
    while quiet < 3:
        chunk = link.read()
        quiet = quiet + 1 if chunk is None and emulator.finished else 0
        if chunk is not None:
            blocks.append(decoder.feed(chunk.data, chunk.monotonic_s))
    return concatenate([*blocks, decoder.flush()])


@pytest.mark.skipif(not hasattr(os, "openpty"), reason="needs pseudo-terminals: Linux or macOS")
def test_emulated_instrument_is_read_back(driver: type[Driver]) -> None:
    """The instrument lies on a table; every sample comes through port or bus, link and decoder, in SI."""
    run = EmulatorSettings(duration_s=DURATION_S, wait_for_reader=driver.wire == "serial")
    bus = f"virtual:{driver.name}-{os.getpid()}" if driver.wire == "can" else None
    options = Emulation(device=driver.name, run=run, bus=bus)
    wire = choose_wire(options)
    opened = open_can(bus, driver=driver.name) if bus else None
    decoder = Decoder(wire.protocol) if opened is None else opened.decoder
    with make_emulator(options) as emulator:
        link = open_link(emulator.address, baud=driver.default_baud) if opened is None else opened.link
        samples = read(link, decoder, emulator)
        link.close()
    assert emulator.failure is None
    assert emulator.samples_sent == round(DURATION_S * wire.rate_hz)
    # Who sends stamps the frames of a virtual bus: where that stands still between two of a sample, they pass for others'.
    tolerance = 2 if driver.wire == "can" else 0
    assert len(samples) == pytest.approx(emulator.samples_sent, rel=0, abs=tolerance)
    assert decoder.statistics.samples_lost <= tolerance
    # A busy machine may stamp the frames of one CAN sample so late that they pass for two.
    usable = samples[samples.usable]
    assert len(usable) >= 0.8 * len(samples)
    assert np.linalg.norm(usable.accelerometer_rate().mean(axis=0)) == pytest.approx(9.8, abs=0.1)
    rate = usable.gyroscope_rate().mean(axis=0)
    assert np.abs(rate).max() < 0.02 or (np.isnan(rate).all() and driver.name == "bosch_mm510")
