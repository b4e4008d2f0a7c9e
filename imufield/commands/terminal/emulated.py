"""Virtual instruments for demonstrations: a process of its own on a pseudo-terminal, and its guided session.

The instrument runs ``speed`` times faster than real and is read with a clock that does the same. Nothing else differs from a
real session.
"""

from __future__ import annotations

import json
import queue
import subprocess
import sys
import threading
from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

from imufield.acquire.instrument.connect import connect
from imufield.acquire.instrument.connected import ConnectOptions
from imufield.acquire.link.host_clock import ScaledClock
from imufield.commands.options.acquire_commands import CaptureOptions, DemoOptions
from imufield.commands.terminal.guided import Captured, guided_session, new_session
from imufield.commands.terminal.output import before_recording, say_assumed
from imufield.errors import LinkError, Reason, UsageError
from imufield.pipeline.site import SiteOptions
from imufield.sentences import Sentences
from imufield.simulate.truth.motion import Site

sentence = Sentences(__package__)

RATE_HZ = 500.0  # Below the 2000 Hz the instrument can, so that a small machine keeps up with eight times real time.
HOLD_S = 5.0  # Shorter than a real session needs, so that the whole takes minutes.
OPERATOR_HOLD_S = 8.5
"""The guide trims both ends of a still stretch and needs some cells to be sure of it."""
LONGEST_S = 1800.0
"""Of sample time; the emulator ends then even if the demonstration was killed and cannot end it."""


def capture(port: str, options: DemoOptions, check: Callable[[], None]) -> Captured:
    """Capture as ``imufield capture`` does, at the place and with the clock of the simulation."""
    site, clock = Site(), ScaledClock(options.speed)
    how = CaptureOptions(
        connect=ConnectOptions(port=port, driver="stim300"),
        hold_s=HOLD_S,
        site=SiteOptions(gravity_m_s2=site.gravity_m_s2, latitude_deg=site.latitude_deg),
        plain=options.plain,
        root=options.root,
    )
    with before_recording():
        connected = connect(how.connect, clock, say_assumed)
    with ExitStack() as stack:
        stack.callback(connected.close)
        session = new_session(how, connected, how.site)
        stack.enter_context(session.lock())
        return guided_session(session, connected, clock, how, check=check, again="imufield demo")


@contextmanager
def emulator(options: DemoOptions, truth: Path, *more: str) -> Iterator[tuple[str, Callable[[], None]]]:
    """Run ``imufield emulate`` in a process of its own; yield the port, and what raises where it is slow or has ended.

    ``more`` are further words of its command.

    Raises
    ------
    LinkError
        If it does not start.
    """
    command = [sys.executable, "-P", "-m", "imufield", "emulate", "stim300", "--json", "--wait", "--truth", str(truth), *more]
    numbers = {
        "seed": options.seed,
        "speed": options.speed,
        "rate-hz": RATE_HZ,
        "hold-s": OPERATOR_HOLD_S,
        "duration-s": LONGEST_S,
    }
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
                raise LinkError(sentence("emulated.ended"))
            raise UsageError(sentence("emulated.slow", **json.loads(line)))

    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=quiet, text=True) as process:  # noqa: S603  (our own program)
        # In a thread: a line may never come, and the guide must not wait for it.
        listener = threading.Thread(target=listen, args=(process.stdout,), name="words of the emulator", daemon=True)
        listener.start()
        try:
            line = words.get()
            if not line:
                raise LinkError(sentence("emulated.no_emulator"), Reason.PORT_NOT_FOUND)
            yield str(json.loads(line)["port"]), check
        finally:
            process.terminate()
            listener.join()
