"""Counts of frames, samples and losses of a decoder, and the sentences that tell a person what they mean."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

from imufield.acquire.protocol.protocol import Protocol
from imufield.dataclass import asdict, dataclass, field, fields, replace
from imufield.samples import Status
from imufield.sentences import Sentence, Sentences, shortened

sentence = Sentences(__package__)

LEFT_OUT = "without a sample"
"""Kind under which frames of a bus are counted that belong to no sample."""
NO_TIME = "sample without a time"
"""Kind under which samples are counted whose time stamps are no times."""
NO_COUNT = "sample without a count"
"""Kind under which the samples are counted that showed that a counter does not count them."""
_FEW_LEFT_OUT = 10  # A stream begins and ends within a sample, and a bus sends a frame again now and then.
_KINDS_NAMED = 8  # An instrument sends a few kinds of frames; thousands would fill a page.
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
    rate_sigma: float | None = None
    """1 sigma of ``rate_hz`` by how late samples come at the host, relative; the host's clock has its own."""
    follows_host: bool = False
    """Whether the time of the samples is that of the host, not that of the instrument or of a stated rate."""

    @property
    def lost(self) -> int:
        """Samples that are missing, counted and estimated."""
        return self.samples_lost + self.losses_estimated

    @property
    def is_understood(self) -> bool:
        """Whether most of the bytes are in good frames, so that they are of the protocol they were read by."""
        return self.frames > 0 and 2 * self.bytes_skipped <= self.bytes_total

    def count(self, kind: str, number: int = 1) -> None:
        """Count frames or lines of a kind."""
        if number:
            self.by_kind[kind] = self.by_kind.get(kind, 0) + number

    def to_dict(self) -> dict[str, object]:
        """Return plain values."""
        return asdict(self)


def without_samples(protocol: Protocol, parts: Sequence[DecoderStatistics]) -> Sentence:
    """Return which good frames came where no sample did, the most frequent first, and what to set the instrument to."""
    counts: Counter[str] = Counter()
    for part in parts:
        counts.update(part.by_kind)
    kinds = [f"{number} {protocol.kind_names.get(kind, shortened(kind))}" for kind, number in counts.most_common(_KINDS_NAMED)]
    if len(counts) > _KINDS_NAMED:
        kinds.append(f"{len(counts) - _KINDS_NAMED} other kinds")
    return sentence(
        "statistics.without_samples",
        protocol=protocol.name,
        frames=sum(part.frames for part in parts),
        kinds=kinds,
        advice=protocol.samples.advice or sentence("statistics.advice"),
    )


def combined(parts: Sequence[DecoderStatistics]) -> DecoderStatistics:
    """Return the counts of decoders, one for each time that a link was opened, as if one had read all; rates of the last."""
    total = replace(parts[-1], by_kind=dict(sum((Counter(part.by_kind) for part in parts), Counter())))
    for name in _COUNTS:
        setattr(total, name, sum(getattr(part, name) for part in parts))
    total.least_loss_s = max(part.least_loss_s for part in parts)
    return total


_COUNTS = tuple(each.name for each in fields(DecoderStatistics) if each.type == "int")


def remarks(parts: Sequence[DecoderStatistics]) -> list[Sentence]:
    """Return sentences about what the numbers of samples and losses do not show; none where all is well."""

    def total(name: str) -> int:
        return sum(getattr(part, name) for part in parts)

    samples, incomplete, standing, resets = map(total, ("samples", "samples_incomplete", "samples_standing", "clock_resets"))
    found = []
    if incomplete:
        share = 100 * incomplete / max(samples, 1)
        percent = f"{share:.0f}" if share >= 10 else f"{share:.2g}"
        key = "statistics.many_incomplete" if share >= _MANY_PERCENT else "statistics.incomplete"
        found.append(sentence(key, incomplete=incomplete, samples=samples, percent=percent))
    if standing:
        found.append(sentence("statistics.standing", standing=standing, samples=samples, status=Status.STANDING.value))
    left_out = sum(part.by_kind.get(LEFT_OUT, 0) for part in parts)
    if left_out > _FEW_LEFT_OUT and 100 * left_out >= samples:
        found.append(sentence("statistics.left_out", left_out=left_out, samples=samples))
    if any(NO_TIME in part.by_kind for part in parts):
        found.append(sentence("statistics.no_time"))
    if any(NO_COUNT in part.by_kind for part in parts):
        found.append(sentence("statistics.no_count"))
    if resets:
        found.append(sentence("statistics.resets", times="once" if resets == 1 else f"{resets} times"))
    least_loss_s = max((part.least_loss_s for part in parts), default=0.0)
    if least_loss_s:
        found.append(sentence("statistics.unseen", least_loss_ms=1e3 * least_loss_s))
    return found
