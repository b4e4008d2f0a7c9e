"""``imufield demo``: the whole chain with no hardware, held against the simulator's truth.

The instrument is another process on a pseudo-terminal that runs ``speed`` times faster than real; it is read with a clock
that does the same. Nothing else differs from a real session.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import typer

from imufield.acquire.instrument.connect import ConnectOptions, connect
from imufield.acquire.link.host_clock import ScaledClock
from imufield.calibrate.model.gauge import intrinsic
from imufield.calibrate.model.models import to_vector
from imufield.calibrate.model.result import AccelerometerParameters, Calibration
from imufield.commands.options.commands import CaptureOptions, DemoOptions
from imufield.commands.terminal.connection import say_assumed
from imufield.commands.terminal.guided import Captured, guided_session, new_session
from imufield.commands.terminal.output import before_recording
from imufield.deliver.parameters.file import PARAMETER_FILE, write_document
from imufield.deliver.report.summary import Outcome, print_summary
from imufield.errors import LinkError, Reason
from imufield.pipeline.calibration import SolveSettings
from imufield.pipeline.site import SiteOptions
from imufield.pipeline.solving import solve_session
from imufield.samples import FloatArray
from imufield.sentences import Sentences
from imufield.simulate.truth.motion import Site

sentence = Sentences(__package__)

RATE_HZ = 500.0  # Below the 2000 Hz the instrument can, so that a small machine keeps up with eight times real time.
HOLD_S = 5.0  # Shorter than a real session needs, so that the whole takes minutes.
OPERATOR_HOLD_S = 8.5
"""The guide trims both ends of a still stretch and needs some cells to be sure of it."""
LIMIT_SIGMA = 4.0  # Of 12 parameters, one beyond it comes up in a thousand demonstrations.
LONGEST_S = 1800.0
"""Of sample time; the emulator ends then even if the demonstration was killed and cannot end it."""

INTRINSIC_NAMES = (
    *(f"scale {axis}" for axis in "xyz"),
    *(f"bias {axis}" for axis in "xyz"),
    *(f"angle {pair}" for pair in ("x-y", "x-z", "y-z")),
    *(f"quadratic {axis}" for axis in "xyz"),
)


@dataclass(frozen=True, slots=True)
class DemoResult:
    """How the demonstration went."""

    captured: Captured
    calibration: Calibration
    errors_in_sigma: FloatArray
    """Gauge-free errors in units of their stated sigma, shape (12,); NaN where nothing was fitted."""

    @property
    def largest_sigma(self) -> float:
        """Largest of the errors, either sign."""
        return float(np.nanmax(np.abs(self.errors_in_sigma)))

    @property
    def passed(self) -> bool:
        """Whether every position was measured and every fitted parameter is within 4 sigma of the truth."""
        whole = self.captured.finished and self.captured.accepted == self.captured.planned
        return whole and self.largest_sigma <= LIMIT_SIGMA


def run_demo(options: DemoOptions) -> DemoResult:
    """Capture and solve a simulated session, and compare it with the truth.

    Raises
    ------
    LinkError
        If the emulator does not start.
    """
    with tempfile.TemporaryDirectory(prefix="imufield-demo-") as folder:
        truth_file = Path(folder) / "truth.json"
        with _emulator(options.seed, options.speed, truth_file) as port:
            captured = _capture(port, options)
        # After the emulator has ended, and before its folder goes.
        truth: dict[str, Any] = json.loads(truth_file.read_text())
    solved = solve_session(captured.session, SolveSettings())
    path = captured.session.folder / PARAMETER_FILE
    kept = write_document(path, solved.parameters.document)
    print_summary(solved.parameters, Outcome(path, kept, captured.session.folder))
    result = DemoResult(captured, solved.parameters.calibration, compare(solved.parameters.calibration, truth))
    _print_comparison(result, truth)
    return result


def _capture(port: str, options: DemoOptions) -> Captured:
    """Capture as ``imufield capture`` does, at the place and with the clock of the simulation."""
    site, clock = Site(), ScaledClock(options.speed)
    capture = CaptureOptions(
        connect=ConnectOptions(port=port, driver="stim300"),
        hold_s=HOLD_S,
        site=SiteOptions(gravity_m_s2=site.gravity_m_s2, latitude_deg=site.latitude_deg),
        view="plain" if options.plain else "auto",
        root=options.root,
    )
    with before_recording():
        connected = connect(capture.connect, clock, say_assumed)
    with ExitStack() as stack:
        stack.callback(connected.close)
        session = new_session(capture, connected, capture.site)
        stack.enter_context(session.lock())
        return guided_session(session, connected, clock, capture)


@contextmanager
def _emulator(seed: int, speed: float, truth: Path) -> Iterator[str]:
    """Run ``imufield emulate`` in a process of its own; yield the port."""
    command = [sys.executable, "-P", "-m", "imufield", "emulate", "stim300", "--json", "--wait", "--truth", str(truth)]
    numbers = {"seed": seed, "speed": speed, "rate-hz": RATE_HZ, "hold-s": OPERATOR_HOLD_S, "duration-s": LONGEST_S}
    command += [f"--{name}={value}" for name, value in numbers.items()]
    # What it says when it is ended is nobody's concern here; that it did not start is said below.
    quiet = subprocess.DEVNULL
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=quiet, text=True) as process:  # noqa: S603  (our own program)
        try:
            line = process.stdout.readline() if process.stdout is not None else ""
            if not line:
                raise LinkError(sentence("demo.no_emulator"), Reason.PORT_NOT_FOUND)
            yield str(json.loads(line)["port"])
        finally:
            process.terminate()


def compare(calibration: Calibration, truth: dict[str, Any]) -> FloatArray:
    """Return the gauge-free errors in units of their sigma, shape (12,)."""
    table = truth["accelerometer"]
    given = {name: np.array(table[name]) for name in ("scale", "bias_m_s2", "misalignment_rad", "quadratic", "raw_zero")}
    # The bias with what the slow drift added on average.
    given["bias_m_s2"] = given["bias_m_s2"] + np.array(table["mean_drift_m_s2"])
    true, _ = intrinsic(to_vector(AccelerometerParameters(**given, quadratic_axes=table["quadratic_axes"])))
    found = calibration.intrinsic
    values = np.concatenate([found.scale, found.bias_raw, found.angle_rad, found.quadratic])
    sigma = np.concatenate([found.scale_sigma, found.bias_raw_sigma, found.angle_sigma_rad, found.quadratic_sigma])
    # A parameter that was not fitted has no sigma, and no error to speak of.
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(sigma > 0, (values - true) / sigma, np.nan)


def _print_comparison(result: DemoResult, truth: dict[str, Any]) -> None:
    typer.echo()
    typer.echo("Against the simulator's truth, in units of the stated sigma:")
    for rank in range(0, len(INTRINSIC_NAMES), 3):
        row = [
            f"{name:<12}{error:+6.2f}" if np.isfinite(error) else f"{name:<12}     -"
            for name, error in zip(INTRINSIC_NAMES[rank : rank + 3], result.errors_in_sigma[rank : rank + 3], strict=True)
        ]
        typer.echo("   " + "     ".join(row))
    word = "as it should be" if result.passed else "NOT as it should be"
    within = "within" if result.largest_sigma <= LIMIT_SIGMA else "NOT within"
    typer.echo(f"{result.captured.accepted} of {result.captured.planned} positions, seed {truth['seed']}: {word},")
    typer.echo(f"{within} {LIMIT_SIGMA:g} sigma of the simulator's truth: largest {result.largest_sigma:.1f}")
