"""The pytest plugin as a user's tests meet it: in a run of its own, found by its entry point."""

from __future__ import annotations

import shutil
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import serial

from imufield.acquire.decoder import Decoder
from imufield.acquire.link.serial import Chunk
from imufield.acquire.protocol.protocol import load_protocol
from imufield.acquire.recording.reader import RecordedEvent, read_session
from imufield.acquire.recording.session import Session
from imufield.guide.positions import scheme
from imufield.simulate.emulator.emulate import Emulation, make_virtual_imu
from imufield.simulate.truth.operator import OperatorSettings
from imufield.simulate.wire.stim300 import Stim300Encoder, Stim300Format
from imufield.testing import Replayed, sentence
from tests.opened_can import open_can

pytest_plugins = ["pytester"]

RATE_HZ = 125.0
SETTINGS = {"rate_hz": "125", "accelerometer_range_g": "10"}


@pytest.fixture(scope="module")
def dump(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a file of the bytes that an instrument sent while somebody showed its six faces."""
    operator = OperatorSettings(hold_s=6.0, initial_still_s=6.0)
    directions = scheme("faces6").directions()
    source = make_virtual_imu(Emulation(rate_hz=RATE_HZ, seed=4, directions=directions, operator=operator))
    samples = source.next_block(int(source.operator.plan_all() * RATE_HZ))
    path = tmp_path_factory.mktemp("dump") / "imu.bin"
    path.write_bytes(Stim300Encoder(Stim300Format(rate_hz=RATE_HZ)).encode(samples).tobytes())
    return path


def run(pytester: pytest.Pytester, code: str, *options: str) -> pytest.RunResult:
    pytester.makepyfile(code)
    return pytester.runpytest_subprocess("-p", "no:cacheprovider", *options)


def run_here(pytester: pytest.Pytester, code: str, *options: str) -> pytest.RunResult:
    """Return the same of a run in this process, which forgets what it imports: the plugin is loaded and the rest is light."""
    pytester.makepyfile(code)
    return pytester.runpytest_inprocess("-p", "no:cacheprovider", *options)


def test_nothing_heavy_is_imported_before_a_fixture_is_used(pytester: pytest.Pytester) -> None:
    result = run(
        pytester,
        """
        import sys

        def test_light(request):
            assert request.config.pluginmanager.has_plugin("imufield.testing")
            assert not {"scipy", "serial", "typer", "imufield.commands", "imufield.simulate"} & set(sys.modules)
        """,
    )
    result.assert_outcomes(passed=1)


def test_golden_results(pytester: pytest.Pytester) -> None:
    code = """
        import numpy as np

        def test_scale(imufield_golden):
            imufield_golden("scale", {"scale": np.array([1.0, VALUE]), "missing": float("nan"), "name": "x"}, relative=1e-6)
        """
    first = run(pytester, code.replace("VALUE", "2.0"))
    first.assert_outcomes(failed=1)
    assert sentence("testing.no_golden", path=pytester.path / "golden" / "scale.json") in first.stdout.str()
    run_here(pytester, code.replace("VALUE", "2.0"), "--imufield-update").assert_outcomes(passed=1)
    assert (pytester.path / "golden" / "scale.json").is_file()
    run_here(pytester, code.replace("VALUE", "2.000001")).assert_outcomes(passed=1)
    changed = run_here(pytester, code.replace("VALUE", "2.1"))
    changed.assert_outcomes(failed=1)
    told = sentence("testing.golden", name="scale", key="scale", value=[1.0, 2.1], expected=[1.0, 2.0], differing=1)
    assert told in changed.stdout.str()


def test_replay_of_bytes(imufield_replay: Callable[..., Replayed], dump: Path) -> None:
    replay = imufield_replay(dump, protocol="stim300", settings=SETTINGS)
    assert len(replay.samples) > 5000
    assert replay.session.metadata["settings"]["rate_hz"] == {"value": 125, "origin": "given"}
    assert replay.events == []
    parameters = replay.solve(gravity_m_s2=9.8123)
    assert parameters.calibration.gravity.source == "typed"
    # The first position was shown twice: to measure the noise floor in, and in its turn.
    assert len(parameters.document["position"]) == 7
    again = imufield_replay(dump, protocol="stim300", settings=SETTINGS)
    assert np.array_equal(again.samples.accelerometer, replay.samples.accelerometer)
    assert again.session.folder != replay.session.folder


def test_replay_of_a_session_gives_its_events(imufield_replay: Callable[..., Replayed], dump: Path, tmp_path: Path) -> None:
    imported = imufield_replay(dump, protocol="stim300", settings=SETTINGS).session
    folder = tmp_path / "mine"
    shutil.copytree(imported.folder, folder)
    Session.open(folder).update(scheme="faces6", guide={"hold_s": 3.0})
    replay = imufield_replay(folder)
    kinds = [event["event"] for event in replay.events]
    assert kinds[:1] == ["noise_floor"]
    assert kinds.count("accepted") == 6
    assert kinds[-1] == "done"
    assert [position["name"] for position in replay.parameters.document["position"]] == [
        event["position"] for event in replay.events if event["event"] == "accepted"
    ]
    assert not [item for item in read_session(replay.session) if isinstance(item, RecordedEvent)]
    assert any(isinstance(item, Chunk) for item in read_session(replay.session))


def test_an_instrument_on_a_port(imufield_pty: Callable[..., Any]) -> None:
    instrument = imufield_pty("stim300", rate_hz=125.0, speed=16.0)
    decoder = Decoder(load_protocol("stim300", {"rate_hz": 125}))
    with serial.Serial(instrument.port, 921600, timeout=0.1) as port:
        end_s = time.monotonic() + 60
        while decoder.statistics.samples < 100 and time.monotonic() < end_s:
            decoder.feed(port.read(4096))
    assert decoder.statistics.samples >= 100
    assert decoder.statistics.frames_bad_checksum == 0


def test_an_instrument_with_faults(imufield_pty: Callable[..., Any]) -> None:
    instrument = imufield_pty("stim300", rate_hz=125.0, speed=16.0, faults={"wrong_checksum_probability": 0.5})
    decoder = Decoder(load_protocol("stim300", {"rate_hz": 125}))
    with serial.Serial(instrument.port, 921600, timeout=0.1) as port:
        end_s = time.monotonic() + 60
        while decoder.statistics.frames_bad_checksum < 10 and time.monotonic() < end_s:
            decoder.feed(port.read(4096))
    assert decoder.statistics.frames_bad_checksum >= 10


def test_instruments_are_stopped_after_the_test(pytester: pytest.Pytester) -> None:
    result = run(
        pytester,
        """
        import threading

        ports = []

        def test_one(imufield_pty):
            ports.append(imufield_pty("stim300", rate_hz=125.0))
            ports.append(imufield_pty("text"))

        def test_after():
            assert all(port.finished for port in ports)
            assert "emulator" not in {thread.name for thread in threading.enumerate()}
        """,
    )
    result.assert_outcomes(passed=2)


def test_an_instrument_on_a_bus(imufield_can_bus: Callable[..., Any]) -> None:
    instrument = imufield_can_bus("sbg_can", duration_s=1.0, faults={"lost_frame_probability": 0.01})
    opened = open_can(f"{instrument.bus}?sleep_after_open=0", driver="sbg_can")
    count, end_s = 0, time.monotonic() + 60
    while not instrument.finished and time.monotonic() < end_s:
        chunk = opened.link.read()
        count += 0 if chunk is None else len(opened.decoder.feed(chunk.data, chunk.monotonic_s))
    opened.link.close()
    assert count + len(opened.decoder.flush()) > 50
