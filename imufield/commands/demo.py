"""``imufield demo``: the whole chain with no hardware, held against the simulator's truth.

The instrument is another process on a pseudo-terminal that runs ``speed`` times faster than real; it is read with a clock
that does the same. Nothing else differs from a real session.
"""

from __future__ import annotations

import json
import queue
import subprocess
import sys
import tempfile
import threading
from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import Any

import numpy as np

from imufield.acquire.instrument.connect import connect
from imufield.acquire.instrument.connected import ConnectOptions
from imufield.acquire.link.host_clock import ScaledClock
from imufield.calibrate.model.gauge import intrinsic
from imufield.calibrate.model.models import to_vector
from imufield.calibrate.model.result import AccelerometerParameters, Calibration
from imufield.commands.options.samples import CaptureOptions, DemoOptions
from imufield.commands.terminal.guided import Captured, guided_session, new_session
from imufield.commands.terminal.output import before_recording, echo, say, say_assumed
from imufield.deliver.parameters.file import PARAMETER_FILE, write_document
from imufield.deliver.report.summary import Outcome, print_summary
from imufield.errors import LinkError, Reason, UsageError
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


def run_demo(options: DemoOptions) -> None:
    """Capture and solve a simulated session, and compare it with the truth.

    Raises
    ------
    LinkError
        If the emulator does not start, or ends too soon.
    UsageError
        If it does not keep the speed.
    """
    with tempfile.TemporaryDirectory(prefix="imufield-demo-") as folder:
        truth_file = Path(folder) / "truth.json"
        with _emulator(options.seed, options.speed, truth_file) as (port, check):
            captured = _capture(port, options, check)
        # After the emulator has ended, and before its folder goes.
        truth: dict[str, Any] = json.loads(truth_file.read_text())
    solved = solve_session(captured.session, SolveSettings())
    path = captured.session.folder / PARAMETER_FILE
    kept = write_document(path, solved.document)
    site = Site()
    say(sentence("demo.site", latitude_deg=site.latitude_deg, gravity_m_s2=site.gravity_m_s2))
    print_summary(solved, Outcome(path, kept, captured.session.folder))
    _print_comparison(captured, _errors_in_sigma(solved.calibration, truth), truth["seed"])


def _capture(port: str, options: DemoOptions, check: Callable[[], None]) -> Captured:
    """Capture as ``imufield capture`` does, at the place and with the clock of the simulation."""
    site, clock = Site(), ScaledClock(options.speed)
    capture = CaptureOptions(
        connect=ConnectOptions(port=port, driver="stim300"),
        hold_s=HOLD_S,
        site=SiteOptions(gravity_m_s2=site.gravity_m_s2, latitude_deg=site.latitude_deg),
        plain=options.plain,
        root=options.root,
    )
    with before_recording():
        connected = connect(capture.connect, clock, say_assumed)
    with ExitStack() as stack:
        stack.callback(connected.close)
        session = new_session(capture, connected, capture.site)
        stack.enter_context(session.lock())
        return guided_session(session, connected, clock, capture, check=check)


@contextmanager
def _emulator(seed: int, speed: float, truth: Path) -> Iterator[tuple[str, Callable[[], None]]]:
    """Run ``imufield emulate`` in a process of its own; yield the port, and what raises where it is slow or has ended."""
    command = [sys.executable, "-P", "-m", "imufield", "emulate", "stim300", "--json", "--wait", "--truth", str(truth)]
    numbers = {"seed": seed, "speed": speed, "rate-hz": RATE_HZ, "hold-s": OPERATOR_HOLD_S, "duration-s": LONGEST_S}
    command += [f"--{name}={value}" for name, value in numbers.items()]
    # By a name of its own: the number of its terminal may be another's as soon as it has ended, and would be opened again.
    command += ["--link", str(truth.with_name("instrument"))]
    # What it says when it is ended is nobody's concern here; that it did not start is said below.
    quiet = subprocess.DEVNULL
    words: queue.SimpleQueue[str] = queue.SimpleQueue()

    def listen(output: Iterable[str]) -> None:
        for line in output:
            words.put(line)
        words.put("")

    def check() -> None:
        with suppress(queue.Empty):
            line = words.get_nowait()
            # Behind the start it has one thing to say, or it ends.
            if not line:
                raise LinkError(sentence("demo.ended"))
            raise UsageError(sentence("demo.slow", **json.loads(line)))

    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=quiet, text=True) as process:  # noqa: S603  (our own program)
        # In a thread: a line may never come, and the guide must not wait for it.
        listener = threading.Thread(target=listen, args=(process.stdout,), name="words of the emulator", daemon=True)
        listener.start()
        try:
            line = words.get()
            if not line:
                raise LinkError(sentence("demo.no_emulator"), Reason.PORT_NOT_FOUND)
            yield str(json.loads(line)["port"]), check
        finally:
            process.terminate()
            listener.join()


def _errors_in_sigma(calibration: Calibration, truth: dict[str, Any]) -> FloatArray:
    """Return the gauge-free errors in units of their stated sigma, shape (12,); NaN where nothing was fitted."""
    table = truth["accelerometer"]
    given = AccelerometerParameters(
        scale=np.array(table["scale"]),
        # With what the slow drift added on average.
        bias_m_s2=np.array(table["bias_m_s2"]) + np.array(table["mean_drift_m_s2"]),
        misalignment_rad=np.array(table["misalignment_rad"]),
        quadratic=np.array(table["quadratic"]),
        raw_zero=np.array(table["raw_zero"]),
        quadratic_axes=table["quadratic_axes"],
    )
    true, _ = intrinsic(to_vector(given))
    found = calibration.intrinsic
    values = np.concatenate([found.scale, found.bias_raw, found.angle_rad, found.quadratic])
    sigma = np.concatenate([found.scale_sigma, found.bias_raw_sigma, found.angle_sigma_rad, found.quadratic_sigma])
    # A parameter that was not fitted has no sigma, and no error to speak of.
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(sigma > 0, (values - true) / sigma, np.nan)


def _print_comparison(captured: Captured, errors_in_sigma: FloatArray, seed: int) -> None:
    echo()
    echo("Against the simulator's truth, in units of the stated sigma:")
    cells = [
        f"{name:<12}{error:+6.2f}" if np.isfinite(error) else f"{name:<12}     -"
        for name, error in zip(INTRINSIC_NAMES, errors_in_sigma, strict=True)
    ]
    for first in range(0, len(cells), 3):
        echo("   " + "     ".join(cells[first : first + 3]))
    largest = float(np.nanmax(np.abs(errors_in_sigma)))
    within = "within" if largest <= LIMIT_SIGMA else "NOT within"
    passed = captured.finished and captured.accepted == captured.planned and largest <= LIMIT_SIGMA
    word = "as it should be" if passed else "NOT as it should be"
    echo(f"{captured.accepted} of {captured.planned} positions, seed {seed}: {word},")
    echo(f"{within} {LIMIT_SIGMA:g} sigma of the simulator's truth: largest {largest:.1f}")
