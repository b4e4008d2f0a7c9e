"""Counts of what a decoder has seen."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from typing import Any


@dataclass(slots=True)
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
    samples_lost: int = 0
    """Known from the counter or the time stamps of the instrument."""
    losses_estimated: int = 0
    """Samples lost by the host clock, where the counter cannot tell."""
    gaps: int = 0
    """Places where samples are missing."""
    clock_resets: int = 0
    """Places where the counter or the time of the instrument jumped for no loss (a restart)."""
    by_kind: dict[str, int] = field(default_factory=dict)
    nominal_rate_hz: float | None = None
    """Sample rate by the instrument's own clock; None while not known."""
    rate_hz: float | None = None
    """Sample rate measured against the host clock; None while not known (needs 2 s)."""

    @property
    def lost(self) -> int:
        """Samples that are missing, counted and estimated."""
        return self.samples_lost + self.losses_estimated

    def to_dict(self) -> dict[str, Any]:
        """Return plain values."""
        return asdict(self)
