"""``imufield demo``: the whole chain with no hardware, held against the simulator's truth."""

from __future__ import annotations

import json
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from imufield.calibrate.model.gauge import intrinsic
from imufield.calibrate.model.models import predict, to_vector
from imufield.calibrate.model.result import AccelerometerParameters, Calibration, names_of
from imufield.calibrate.model.rotation import unit_vectors
from imufield.commands.options.acquire_commands import DemoOptions
from imufield.commands.terminal.emulated import capture, emulator
from imufield.commands.terminal.guided import Captured
from imufield.commands.terminal.output import echo, say
from imufield.dataclass import replace
from imufield.deliver.parameters.file import PARAMETER_FILE, Parameters, write_document
from imufield.deliver.parameters.printed_numbers import hanging
from imufield.deliver.report.summary import Outcome, print_summary
from imufield.earth import MILLI_G_M_S2
from imufield.errors import VerificationError
from imufield.pipeline.calibration import SolveSettings
from imufield.pipeline.solving import solve_session
from imufield.pipeline.temperature import MarkedSession, over_temperature
from imufield.samples import AXES, FloatArray
from imufield.sentences import Sentences, shell_word
from imufield.simulate.truth.motion import Site

sentence = Sentences(__package__)

LIMIT_SIGMA = 4.0  # Of 12 parameters, one beyond it comes up in a thousand demonstrations.
TEMPERATURES_DEGC = (20.0, -10.0, 50.0)
"""Of the sessions of a demonstration over temperature: room, freezer, box; the first is the reference."""
GRADE = "industrial"
"""Of its instrument: better ones change too little over 60 degC to be seen in short holds."""
POSES = 200

INTRINSIC_NAMES = names_of("{} {}", scale=AXES, bias=AXES, angle=("x-y", "x-z", "y-z"), quadratic=AXES)


def run_demo(options: DemoOptions) -> int:
    """Capture and solve a simulated session, or one at each of three temperatures, and compare with the truth.

    Returns
    -------
    int
        Exit code: that of a verification that failed where the truth is missed.

    Raises
    ------
    LinkError
        If the emulator does not start, or ends too soon.
    UsageError
        If it does not keep the speed.
    """
    with tempfile.TemporaryDirectory(prefix="imufield-demo-") as folder:
        demonstrate = _demonstrate_temperature if options.temperature else _demonstrate
        return 0 if demonstrate(options, Path(folder)) else VerificationError.exit_code


def _demonstrate(options: DemoOptions, folder: Path) -> bool:
    captured, truth = _captured(options, folder)
    solved = _write(solve_session(captured.session, SolveSettings()), captured)
    return _print_comparison(captured, _errors_in_sigma(solved.calibration, truth), truth["seed"])


def _captured(options: DemoOptions, folder: Path, *more: str) -> tuple[Captured, dict[str, Any]]:
    """Capture a session of an emulated instrument; return it with the truth."""
    truth_file = folder / "truth.json"
    with emulator(options, truth_file, *more) as (port, check):
        captured = capture(port, options, check)
    # After the emulator has ended, and before its folder goes.
    truth: dict[str, Any] = json.loads(truth_file.read_text())
    return captured, truth


def _write(solved: Parameters, captured: Captured) -> Parameters:
    """Write the parameter file into the session's folder, and print the summary."""
    path = captured.session.folder / PARAMETER_FILE
    kept = write_document(path, solved.document)
    site = Site()
    say(sentence("demo.site", latitude_deg=site.latitude_deg, gravity_m_s2=site.gravity_m_s2))
    print_summary(solved, Outcome(path, kept, captured.session))
    return solved


def _demonstrate_temperature(options: DemoOptions, folder: Path) -> bool:
    """Capture a session at each temperature, join them, and show what one of them alone would cost."""
    captures, truth = [], dict[str, Any]()
    for day, degc in enumerate(TEMPERATURES_DEGC):
        say(sentence("demo.session", number=day + 1, sessions=len(TEMPERATURES_DEGC), temperature_degc=degc))
        own = folder / str(day)
        own.mkdir()
        captured, truth = _captured(options, own, f"--temperature={degc}", f"--day={day}", f"--grade={GRADE}")
        captures.append(captured)
    settings = SolveSettings(grade=GRADE)
    base = solve_session(captures[0].session, settings)
    joint = _write(
        over_temperature(MarkedSession(base), [captured.session for captured in captures[1:]], settings),
        captures[0],
    )
    passed = _print_cost(base, joint, truth)
    _print_slopes(joint)
    _print_commands([captured.session.folder for captured in captures])
    return passed


def _print_cost(base: Parameters, joint: Parameters, truth: dict[str, Any]) -> bool:
    """Print what is left of gravity in poses never measured; return whether it is as it should be."""
    echo()
    echo(f"Residual of gravity in {POSES} poses never measured, against the simulator's truth, mg RMS:")
    echo("temperature    one session    over temperature    stated sigma")
    passed = True
    for degc in sorted(TEMPERATURES_DEGC):
        alone, left, sigma = _left_mg(base, truth, degc), _left_mg(joint, truth, degc), _stated_mg(joint, degc)
        passed &= left <= LIMIT_SIGMA * sigma and (degc == TEMPERATURES_DEGC[0] or left < alone)
        echo(f"{degc:6.0f} degC {alone:14.3f} {left:19.3f} {sigma:15.3f}")
    echo(hanging("", sentence("demo.better" if passed else "demo.not_better", limit=LIMIT_SIGMA, seed=truth["seed"])))
    return passed


def _print_slopes(joint: Parameters) -> None:
    """Print what a degree changes, on average over the range measured."""
    found = joint.calibration.accelerometer_temperature
    if found is None:
        return
    ends_degc = np.array(found.range_degc)
    d_degc = found.degrees_above(ends_degc)
    bias, scale = (np.diff(each.at(d_degc), axis=0)[0] / np.ptp(d_degc) for each in (found.bias, found.scale))
    echo()
    echo(f"Accelerometer from {ends_degc[0]:.0f} to {ends_degc[1]:.0f} degC, on average:")
    echo(f"{'':<14}" + "".join(f"{axis:>10}" for axis in AXES))
    echo("bias, mg/degC " + "".join(f"{value / MILLI_G_M_S2:>+10.4f}" for value in bias))
    echo("scale, ppm/degC" + "".join(f"{1e6 * value:>+10.2f}" for value in scale).removeprefix(" "))


def _print_commands(folders: Sequence[Path]) -> None:
    """Print what does the same, from the first folder, at the reference, and the others."""
    room, *others = (shell_word(folder) for folder in folders)
    echo()
    echo("The same as commands:")
    echo(f"  imufield solve {room} --grade {GRADE} \\")
    echo(" \\\n".join(f"    --temperature {other}" for other in others))
    echo(f"  imufield report {room}")


def _directions() -> FloatArray:
    return unit_vectors(np.random.default_rng(0).standard_normal((POSES, 3)))


def _left_mg(parameters: Parameters, truth: dict[str, Any], temperature_degc: float) -> float:
    """Return the RMS of the corrected norm less gravity, for what the true instrument sends at a temperature."""
    given, table, gravity_m_s2 = _true_accelerometer(truth), truth["accelerometer"], Site().gravity_m_s2
    d_degc = temperature_degc - truth["reference_temperature_degc"]
    raw = predict(given, gravity_m_s2 * _directions()) - given.raw_zero
    raw = raw * (1 + d_degc * np.array(table["scale_per_degc"])) + given.raw_zero
    raw += d_degc * given.scale * np.array(table["bias_m_s2_per_degc"])
    force = parameters.apply_accelerometer(raw, temperature_degc=temperature_degc)
    return float(np.sqrt(np.mean((np.linalg.norm(force, axis=1) - gravity_m_s2) ** 2))) / MILLI_G_M_S2


def _stated_mg(parameters: Parameters, temperature_degc: float) -> float:
    """Return what bias and scale as stated make of that, 1 sigma, RMS over the poses."""
    there, squares = parameters.at(temperature_degc).calibration, _directions() ** 2
    bias, scale = there.accelerometer_sigma.bias_m_s2, there.accelerometer_sigma.scale / there.accelerometer.scale
    variance = squares @ bias**2 + squares**2 @ (Site().gravity_m_s2 * scale) ** 2
    return float(np.sqrt(np.mean(variance))) / MILLI_G_M_S2


def _true_accelerometer(truth: dict[str, Any]) -> AccelerometerParameters:
    """Return the true parameters, of an instrument at the reference temperature of the simulator."""
    table = truth["accelerometer"]
    arrays: dict[str, Any] = {
        key: np.array(table[key]) for key in ("scale", "bias_m_s2", "misalignment_rad", "quadratic", "raw_zero")
    }
    return AccelerometerParameters(**arrays, quadratic_axes=table["quadratic_axes"])


def _errors_in_sigma(calibration: Calibration, truth: dict[str, Any]) -> FloatArray:
    """Return the gauge-free errors in units of their stated sigma, shape (12,); NaN where nothing was fitted."""
    given = _true_accelerometer(truth)
    # With what the slow drift added on average.
    given = replace(given, bias_m_s2=given.bias_m_s2 + np.array(truth["accelerometer"]["mean_drift_m_s2"]))
    true, _ = intrinsic(to_vector(given))
    found, sigma = calibration.intrinsic.values, calibration.intrinsic.sigmas
    # A parameter that was not fitted has no sigma, and no error to speak of.
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(sigma > 0, (found - true) / sigma, np.nan)


def _print_comparison(captured: Captured, errors_in_sigma: FloatArray, seed: int) -> bool:
    """Print the errors; return whether they are as they should be."""
    echo()
    echo("Against the simulator's truth, in units of the stated sigma:")
    cells = [
        f"{name:<12}{error:+6.2f}" if np.isfinite(error) else f"{name:<12}     -"
        for name, error in zip(INTRINSIC_NAMES, errors_in_sigma, strict=True)
    ]
    for first in range(0, len(cells), 3):
        echo("   " + "     ".join(cells[first : first + 3]))
    largest = float(np.nanmax(np.abs(errors_in_sigma)))
    passed = captured.finished and captured.accepted == captured.planned and largest <= LIMIT_SIGMA
    key = "demo.passed" if passed else "demo.missed" if largest > LIMIT_SIGMA else "demo.incomplete"
    counts = {"accepted": captured.accepted, "planned": captured.planned, "seed": seed}
    echo(hanging("", sentence(key, limit=LIMIT_SIGMA, largest=largest, **counts)))
    return passed
