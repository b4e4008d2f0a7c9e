"""Error of the sample clock, as uncertainty of the gyroscope's scale, and its words in the parameter file.

A move between two stills is an angle that gravity shows. The gyroscope's output N over n samples of the period T gives the same
angle as ``n T N / K``: only K / T is found. So K belongs to the period that the clock of the samples states. A program that
integrates with that clock integrates right, whatever its error; in true seconds K is wrong by as much as the clock.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from imufield.acquire.decode.statistics import DecoderStatistics
from imufield.deliver.parameters.context import ClockFacts
from imufield.sentences import Sentence, Sentences

sentence = Sentences(__package__)

HOST_SIGMA = 5e-5
"""1 sigma of the clock of a computer, relative: its quartz is within 100 ppm, and better where a network disciplines it."""
UNCHECKED_SIGMA = 0.03
"""1 sigma of a rate that was typed or is in a file: uniform within the 5 % of the worst MEMS oscillators (data sheets)."""


def best_rate(parts: Sequence[DecoderStatistics]) -> DecoderStatistics | None:
    """Return the part whose rate is known best; None without samples. A short one behind a pause knows little."""
    timed = (part for part in parts if part.samples and part.nominal_rate_hz)
    return min(timed, key=lambda part: (math.inf if part.rate_sigma is None else part.rate_sigma, -part.samples), default=None)


def clock_facts(part: DecoderStatistics, *, is_import: bool = False, stated_sigma: float | None = None) -> ClockFacts:
    """Return the clock of the samples of a part, and its sigma: the one that the user states, else by what it is.

    The samples of an import arrived when its file says, which is no second clock; frames of a bus were stamped by a host.
    """
    nominal_hz = part.nominal_rate_hz or math.nan
    host_sigma = min(math.hypot(HOST_SIGMA, part.rate_sigma or 0.0), UNCHECKED_SIGMA)
    if part.rate_hz is not None and part.follows_host:
        source, period_s, sigma = "host", 1 / part.rate_hz, host_sigma
    elif part.rate_hz is None or is_import:
        source, period_s, sigma = "unchecked", 1 / nominal_hz, UNCHECKED_SIGMA
    else:
        # Nothing is corrected by what the host shows, so that is an error of the scale in true seconds.
        source, period_s, sigma = "compared", 1 / nominal_hz, math.hypot(host_sigma, nominal_hz / part.rate_hz - 1)
    return ClockFacts(source=source, sample_period_s=period_s, sigma=sigma if stated_sigma is None else stated_sigma)


def clock_words(clock: ClockFacts) -> Sentence:
    """Return to which period the scale belongs, and how well that is known."""
    values = {"period_ms": 1e3 * clock.sample_period_s, "sigma_ppm": 1e6 * clock.sigma}
    keys = {"host": "clock.host", "compared": "clock.compared", "unchecked": "clock.unchecked"}
    return sentence(keys[clock.source], **values)
