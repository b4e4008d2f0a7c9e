"""What leads the operator of a ramp at the terminal: what to do first, the temperature as it goes, and what comes next."""

from __future__ import annotations

import json
import math
import sys

from imufield.acquire.recording.session import Session
from imufield.calibrate.temperature.ramp import FASTEST_DEGC_PER_MIN, LEAST_SPAN_DEGC
from imufield.calibrate.temperature.ramp_progress import EVEN_DEGC_PER_MIN, RampProgress, ramp_progress
from imufield.commands.terminal.output import echo, say
from imufield.deliver.parameters.printed_numbers import beside
from imufield.errors import Reason, UsageError
from imufield.pipeline.windows import WINDOW_S, WindowSums
from imufield.samples import FloatArray, Samples
from imufield.sentences import Sentences, shell_word

sentence = Sentences(__package__)

_WAIT_S = 3 * WINDOW_S  # Of samples: the slowest instruments send their temperature every second.
_TOLD_EVERY_DEGC = LEAST_SPAN_DEGC  # The first time it is told, there is a ramp.


class RampLead:
    """Leads a ramp while it is recorded.

    Parameters
    ----------
    raw_zero : ndarray, shape (3,)
        Raw accelerometer output at no input.
    as_json : bool
        Events instead of sentences.
    """

    def __init__(self, raw_zero: FloatArray, *, as_json: bool) -> None:
        self._raw_zero, self._as_json = raw_zero, as_json
        self._windows, self._speaker = WindowSums(), RampSpeaker()
        self._told = 0  # Windows.
        if not as_json:
            say(sentence("ramp.first", limit=FASTEST_DEGC_PER_MIN, least=LEAST_SPAN_DEGC))

    def feed(self, samples: Samples) -> None:
        """Take the next block."""
        self._windows.feed(samples)

    def _progress(self) -> RampProgress | None:
        # The last window is not full yet.
        means = self._windows.means()[:-1]
        return ramp_progress(means.time_s, means.temperature_degc, means.accelerometer - self._raw_zero)

    def tell(self) -> None:
        """Say what is new, and show the temperature.

        Raises
        ------
        UsageError
            If the instrument sends none.
        """
        progress, count = self._progress(), len(self._windows)
        if progress is None:
            if count * WINDOW_S > _WAIT_S:
                raise UsageError(sentence("ramp.no_temperature", wait_s=_WAIT_S), Reason.NOT_FINITE)
            return
        if count == self._told:
            return
        self._told = count
        news = self._speaker.news(progress)
        if self._as_json:
            shown = ("temperature_degc", "degc_per_min", "low_degc", "high_degc", "is_even", "is_too_fast")
            values = {name: getattr(progress, name) for name in shown}
            known = {name: None if math.isnan(value) else value for name, value in values.items()}
            echo(json.dumps({"event": "ramp", **known, "words": news}))
            return
        if news and sys.stdout.isatty():
            echo()
        for words in news:
            say(words)
        if sys.stdout.isatty():
            rate = "   -" if math.isnan(progress.degc_per_min) else f"{progress.degc_per_min:+.1f}"
            covered = f"{progress.span_degc:.0f} degC covered  (Ctrl-C ends)"
            echo(f"{progress.temperature_degc:7.1f} degC  {rate} degC/min  {covered}", begin="\r", end="")

    def tell_end(self, session: Session) -> None:
        """Say what was recorded, and what to do next."""
        progress = self._progress()
        if progress is None or self._as_json or not session.folder.exists():
            return
        if not progress.is_enough:
            say(sentence("ramp.short", span=progress.span_degc, limit=LEAST_SPAN_DEGC))
            return
        say(sentence("ramp.recorded", low=progress.low_degc, high=progress.high_degc))
        echo(beside("next: ", f"imufield solve SESSION --temperature {shell_word(session.folder)}"))
        say(sentence("ramp.pose"))


class RampSpeaker:
    """Tells the operator of a ramp what to do, each thing once."""

    def __init__(self) -> None:
        self._last: RampProgress | None = None
        self._covered_degc = 0.0  # Told of so far.
        self._was_fast = False  # Since it was within the limit last.

    def news(self, now: RampProgress) -> list[str]:
        """Return what is new, in sentences."""
        before, self._last = self._last, now
        said: list[str] = []
        if before is None:
            return [sentence("ramp.begins", temperature_degc=now.temperature_degc)]
        if math.isfinite(now.moved_s) and now.moved_s != before.moved_s:
            self._covered_degc = 0.0
            said.append(sentence("ramp.moved", time_s=now.moved_s))
        if now.is_too_fast and not self._was_fast:
            said.append(sentence("ramp.fast", rate=abs(now.degc_per_min), limit=FASTEST_DEGC_PER_MIN))
        self._was_fast = now.is_too_fast or (self._was_fast and abs(now.degc_per_min) > FASTEST_DEGC_PER_MIN)
        if now.span_degc >= self._covered_degc + _TOLD_EVERY_DEGC:
            self._covered_degc = _TOLD_EVERY_DEGC * math.floor(now.span_degc / _TOLD_EVERY_DEGC)
            said.append(sentence("ramp.covered", low=now.low_degc, high=now.high_degc, span=now.span_degc))
        if now.is_even and not before.is_even:
            key = "ramp.even_again" if now.is_enough else "ramp.even"
            said.append(sentence(key, temperature_degc=now.temperature_degc, limit=EVEN_DEGC_PER_MIN))
        return said
