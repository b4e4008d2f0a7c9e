"""Counts of frames, samples and losses of a decoder, and the sentences that tell a person what they mean."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, field

from imufield.samples import Status

LEFT_OUT = "without a sample"
"""Kind under which frames of a bus are counted that belong to no sample."""
_FEW_LEFT_OUT = 10  # A stream begins and ends within a sample, and a bus sends a frame again now and then.
_MANY_PERCENT = 25.0  # Of the samples incomplete: more than a bus loses that works.


@dataclass(slots=True, kw_only=True)
class DecoderStatistics:
    """What went through a decoder since it was made."""

    frames: int = 0
    """Frames (or lines) with a good checksum, of any kind."""
    frames_bad_checksum: int = 0
    """Frames of a known kind, where one was expected, whose checksum does not fit."""
    bytes_skipped: int = 0
    """Bytes that belong to no good frame."""
    bytes_total: int = 0
    samples: int = 0
    samples_incomplete: int = 0
    """Of these, without acceleration or without rate: not available, or the frame that carries it is missing."""
    samples_standing: int = 0
    """With the last acceleration or rate again, which comes at a lower rate than the other."""
    samples_lost: int = 0
    """Known from the counter or the time stamps of the instrument."""
    losses_estimated: int = 0
    """Samples lost by the host clock, where the counter cannot tell."""
    gaps: int = 0
    """Places where samples are missing."""
    clock_resets: int = 0
    """Places where the counter or the time of the instrument jumped for no loss (a restart)."""
    least_loss_s: float = 0.0
    """Shortest loss that the time stamps of a bus show, where they are too uneven to show a single sample; else 0."""
    by_kind: dict[str, int] = field(default_factory=dict)
    nominal_rate_hz: float | None = None
    """Sample rate by the instrument's own clock; None while not known."""
    rate_hz: float | None = None
    """Sample rate measured against the host clock; None while not known (needs 2 s)."""

    @property
    def lost(self) -> int:
        """Samples that are missing, counted and estimated."""
        return self.samples_lost + self.losses_estimated

    def to_dict(self) -> dict[str, object]:
        """Return plain values."""
        return asdict(self)


def remarks(parts: Sequence[DecoderStatistics]) -> list[str]:
    """Return sentences about what the numbers of samples and losses do not show; none where all is well."""
    samples = sum(part.samples for part in parts)
    incomplete = sum(part.samples_incomplete for part in parts)
    resets = sum(part.clock_resets for part in parts)
    found = []
    if incomplete:
        share = 100 * incomplete / max(samples, 1)
        remedy = (
            "; where one message comes less than about every twentieth time, or many are lost, samples that begin with the"
            " rarer one (starts_with) are whole"
        )
        percent = f"{share:.0f}" if share >= 10 else f"{share:.2g}"
        found.append(
            f"{incomplete} of {samples} samples ({percent} %) lack acceleration or rate, and enter no mean"
            f"{remedy if share >= _MANY_PERCENT else ''}"
        )
    standing = sum(part.samples_standing for part in parts)
    if standing:
        found.append(
            f"acceleration and rate come at different rates: in {standing} of {samples} samples the slower one stands at its"
            f" last value (status {Status.STANDING.value})"
        )
    left_out = sum(part.by_kind.get(LEFT_OUT, 0) for part in parts)
    if left_out > _FEW_LEFT_OUT and 100 * left_out >= samples:
        found.append(
            f"{left_out} frames belong to none of the {samples} samples and are left out: they came twice, what a sample begins"
            " with was lost, or they come more often than that (starts_with names it)"
        )
    if resets:
        times = "once" if resets == 1 else f"{resets} times"
        found.append(f"counter or time of the instrument jumped {times} where nothing was lost, as a restart does")
    least_loss_s = max((part.least_loss_s for part in parts), default=0.0)
    if least_loss_s:
        found.append(
            f"losses shorter than {1e3 * least_loss_s:.0f} ms cannot be seen here: the messages are not numbered, and their"
            " time stamps are as uneven as that; a counter, or an adapter that stamps frames itself, would show single losses"
        )
    return found
