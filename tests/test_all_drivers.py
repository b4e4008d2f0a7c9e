"""Every driver that ships: names, documentation, limits, protocol."""

from __future__ import annotations

import inspect
import re
from pathlib import Path

import pytest

from imufield.acquire.decoder import Decoder
from imufield.acquire.driver import Driver
from imufield.acquire.protocol import protocol_names
from imufield.acquire.registry import shipped_names, load_driver

NAMES = shipped_names()
PROTOCOLS_WITHOUT_DRIVER = {"rows_f64": "written by imufield itself, no instrument sends it"}
LONGEST_DRIVER_LINES = 150


@pytest.fixture(params=NAMES)
def driver(request: pytest.FixtureRequest) -> type[Driver]:
    return load_driver(request.param)


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
