"""What ``demo --temperature`` shows: its comparison with the truth, on sessions of the same instrument made without a port."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from imufield.acquire.recording.session import Session
from imufield.cli.run import run
from imufield.commands import demo
from imufield.commands.emulate import make_emulation
from imufield.commands.options.acquire_commands import DemoOptions, EmulateOptions
from imufield.deliver.parameters.file import load
from imufield.earth import MILLI_G_M_S2
from imufield.errors import UsageError, VerificationError
from imufield.pipeline.calibration import SolveSettings
from imufield.pipeline.solving import solve_session
from imufield.pipeline.temperature import MarkedSession, over_temperature
from imufield.simulate.emulator.emulate import make_virtual_imu, truth_document
from tests.refused import refused

RATE_HZ = 50.0


def emulated(temperature: str, day: int = 0) -> EmulateOptions:
    return EmulateOptions(
        driver="stim300",
        rate_hz=RATE_HZ,
        grade=demo.GRADE,
        seed=2,
        day=day,
        hold_s=6.0,
        rounds=1,
        temperature=temperature,
        settings={},
    )


def test_one_session_costs_milli_g_where_three_do_not(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    sessions, truth = [], dict[str, Any]()
    for day, degc in enumerate(demo.TEMPERATURES_DEGC):
        emulation = make_emulation(emulated(str(degc), day))
        source = make_virtual_imu(emulation)
        samples = source.next_block(int(source.operator.plan_all() / source.interval_s))
        table = np.column_stack([samples.time_s, samples.accelerometer, samples.gyroscope, samples.temperature_degc])
        path = tmp_path / f"{day}.csv"
        head = "time_s,ax,ay,az,gx,gy,gz,temperature_degc"
        np.savetxt(path, table, delimiter=",", header=head, comments="", fmt="%.9g")
        assert (
            run(["import", str(path), "-o", str(tmp_path / str(day)), "--gravity", f"{emulation.site.gravity_m_s2:.8f}"]) == 0
        )
        sessions.append(Session.open(tmp_path / str(day)))
        truth.update(truth_document(emulation, source))
    settings = SolveSettings(grade=demo.GRADE)
    base = solve_session(sessions[0], settings)
    joint = over_temperature(MarkedSession(base), sessions[1:], settings)
    for degc in (-10.0, 50.0):
        left, sigma = demo._left_mg(joint, truth, degc), demo._stated_mg(joint, degc)
        assert left < demo._left_mg(base, truth, degc) / 10
        assert sigma / 10 < left < demo.LIMIT_SIGMA * sigma
    assert demo._print_cost(base, joint, truth)
    capsys.readouterr()
    demo._print_slopes(joint)
    rows = [line.replace(",", " ").split() for line in capsys.readouterr().out.splitlines() if "/degC" in line]
    found = {row[0]: np.array(row[2:], dtype=float) for row in rows}
    drawn = truth["accelerometer"]
    np.testing.assert_allclose(found["bias"], np.array(drawn["bias_m_s2_per_degc"]) / MILLI_G_M_S2, atol=0.01)
    np.testing.assert_allclose(found["scale"], 1e6 * np.array(drawn["scale_per_degc"]), atol=10.0)
    # What is printed as commands is what the program takes, and finds the same.
    demo._print_commands([session.folder for session in sessions])
    commands = capsys.readouterr().out.partition(":\n")[2].replace("\\\n", " ").splitlines()
    assert [run(shlex.split(command)[1:]) for command in commands] == [0, 0]
    again = load(sessions[0].folder / "parameters.toml").calibration.accelerometer_temperature
    known = joint.calibration.accelerometer_temperature
    assert again is not None
    assert known is not None
    np.testing.assert_allclose(again.bias.coefficients, known.bias.coefficients, rtol=1e-6, atol=1e-12)
    capsys.readouterr()
    # The same numbers with the temperature drift of another instrument do not pass.
    other = {**truth["accelerometer"], "bias_m_s2_per_degc": [0.0, 0.0, 0.0]}
    assert not demo._print_cost(base, joint, {**truth, "accelerometer": other})


@pytest.mark.parametrize(
    ("options", "work"), [(DemoOptions(), "_demonstrate"), (DemoOptions(temperature=True), "_demonstrate_temperature")]
)
def test_a_demonstration_that_fails_has_an_exit_code(options: DemoOptions, work: str, monkeypatch: pytest.MonkeyPatch) -> None:
    # The whole of it takes minutes; what it returns is tried above.
    for passed, code in ((True, 0), (False, VerificationError.exit_code)):
        monkeypatch.setattr(demo, work, lambda *_, passed=passed: passed)
        assert demo.run_demo(options) == code


def test_a_ramp_goes_from_one_temperature_to_the_other_and_stays() -> None:
    source = make_virtual_imu(make_emulation(emulated("40:-20:120")))
    at_degc = source.next_block(round(60 * RATE_HZ)).temperature_degc
    assert at_degc[0] == 40.0
    assert at_degc[round(10 * RATE_HZ)] == pytest.approx(20.0)
    np.testing.assert_array_equal(at_degc[round(30 * RATE_HZ) :], -20.0)


@pytest.mark.parametrize(
    "text", ["", "warm", "10:", "10:20:0", "10:20:-1", "10:20:30:40", "-101", "20:301", "nan", "10:20:inf"]
)
def test_a_temperature_that_is_none_is_refused(text: str) -> None:
    with refused(UsageError, None, repr(text), key="emulate.temperature"):
        make_emulation(emulated(text))
