"""Recognise an instrument by what it sends: every way to read the wire gets the same bytes and is judged by its frames.

``baud_search`` opens the port at one rate after another, those of each driver first, and asks here at each.

What a frame must show by itself (fixed bytes and checksum) decides how much evidence is needed. With 24 bits and more, five
frames of noise would take 2^120 tries, and a handful of frames is proof. With less, or none (lines of numbers, frames without
a checksum), bytes that only look like frames are possible: then nearly all bytes must belong to frames, the frames must come
steadily, and the acceleration must be of the size of gravity.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping

import numpy as np

from imufield.acquire.decode.statistics import without_samples
from imufield.acquire.decoder import Decoder
from imufield.acquire.driver import Driver, Message
from imufield.acquire.link.chunk import Chunk
from imufield.acquire.protocol.protocol import Protocol
from imufield.acquire.protocol.settings import with_origin
from imufield.dataclass import asdict, dataclass, field, replace
from imufield.earth import MICRO_G_M_S2
from imufield.errors import ProtocolError
from imufield.samples import Samples, median
from imufield.sentences import Sentence, Sentences

sentence = Sentences(__package__)

FEWEST_SAMPLES = 5  # Five strong frames by chance take 2^120 tries.
CERTAIN_SAMPLES = 20
"""Samples that end the listening."""
RATE_S = 0.3
"""Least listening where the rate is to be told, in chunks of 20 ms."""
_PACE_S = 1.0  # Least listening where samples are timed by the rate that is measured.
_USUAL_HZ = (1, 2, 5, 10, 20, 25, 40, 50, 100, 125, 200, 250, 400, 500, 800, 1000, 2000)
_SAME_RATE = 0.1  # By arrival, in a second.
_OTHER_RATE = 0.2  # From this on it is not the rate that was set: neither delays nor quartzes make as much.
STRONG_BITS = 24  # Two sync bytes and a checksum of one byte, the least of binary protocols that have one.
STRONG_SHARE = 0.5
"""Share of the bytes in good frames: text of a receiver or a damaged line may take the rest."""
WEAK_SHARE = 0.9
"""The same without strong frames: bit errors of 1e-4 damage up to 1 % of lines of 100 bytes."""
GRAVITY_M_S2 = (4.0, 20.0)
"""Median size of the acceleration in the hand or on a table, calibrated or not; values in g give 1, counts thousands."""
# Departure from an even pace that chunks of 20 ms and a busy machine explain, in share of all frames and in frames.
_STEADY_SHARE = 0.15
_STEADY_FRAMES = 3
_NORMS_KEPT = 4000  # More would not move their median.


@dataclass(frozen=True, slots=True, kw_only=True)
class Candidate:
    """A way to read the wire.

    Attributes
    ----------
    name, title : str
    protocol : Protocol
    bauds : tuple of int
        The likeliest first.
    driver : type of Driver or None
        None where only a protocol file is known.
    variant : mapping
        Settings of a form of the stream that is not the usual one.
    reasons : mapping
        Why settings were taken, by name; "recognised" where there is none.
    """

    name: str
    title: str
    protocol: Protocol
    bauds: tuple[int, ...]
    driver: type[Driver] | None
    variant: Mapping[str, object] = field(default_factory=dict)
    reasons: Mapping[str, str] = field(default_factory=dict)

    def taken(self) -> list[str]:
        """Return in sentences the settings that were taken, and why."""
        return [
            sentence("recognise.taken", name=name, value=self.protocol.settings[name].value, why=why)
            for name, why in {**dict.fromkeys(self.variant, "recognised"), **self.reasons}.items()
        ]


@dataclass(frozen=True, slots=True, kw_only=True)
class Finding:
    """What a candidate made of the bytes.

    Attributes
    ----------
    found : bool
        Whether the evidence is enough.
    reason : str
        Why it is not; empty where it is.
    checked_bits : int
        Fixed bits and checksum bits of the weakest frame.
    share : float
        Of the bytes, in good frames.
    checksum_ratio : float or None
        Good frames among those whose checksum was checked; None without any.
    rate_hz : float or None
        Samples for each second of the host.
    norm_m_s2 : float or None
        Median size of the acceleration; None where its unit is not known.
    noise_ug : float or None
        White noise of it, micro-g per root Hz, by the differences between neighbours, which a unit in the hand hardly changes.
    """

    name: str
    title: str
    variant: dict[str, object]
    found: bool
    reason: str
    frames: int
    frames_bad_checksum: int
    samples: int
    bytes_total: int
    share: float
    checked_bits: int
    rate_hz: float | None
    norm_m_s2: float | None
    noise_ug: float | None
    steady: bool

    @property
    def is_strong(self) -> bool:
        """Whether a handful of its frames is proof."""
        return self.checked_bits >= STRONG_BITS

    @property
    def holds_no_sample(self) -> bool:
        """Whether it is the instrument without a doubt, and sends other things than samples."""
        return self.samples == 0 and self.frames >= FEWEST_SAMPLES and self.is_strong and self.share >= STRONG_SHARE

    @property
    def checksum_ratio(self) -> float | None:
        """Return the share of good frames among those that were checked."""
        checked = self.frames + self.frames_bad_checksum
        return self.frames / checked if checked else None

    def to_dict(self) -> dict[str, object]:
        """Return plain values."""
        return {**asdict(self), "checksum_ratio": self.checksum_ratio}

    def evidence(self) -> str:
        """Return it in words."""
        parts = [f"{self.frames} good frames", f"{self.frames_bad_checksum} bad", f"{100 * self.share:.0f} % of the bytes"]
        if self.rate_hz is not None:
            parts.append(f"{self.rate_hz:.4g} Hz")
        if self.norm_m_s2 is not None:
            parts.append(f"acceleration {self.norm_m_s2:.2f} m/s^2")
        return ", ".join(parts)


class Listener:
    """Decodes what arrives as one candidate would send it, and counts what is understood.

    Parameters
    ----------
    candidate : Candidate
    is_given : bool
        The user said what it is: then plausibility is not asked for.

    Attributes
    ----------
    accelerations : int
        Samples that have an acceleration.
    """

    def __init__(self, candidate: Candidate, *, is_given: bool = False) -> None:
        self._is_given = is_given
        # Kept, since a rate that is missing shows only while decoding, and decoding then begins again.
        self._chunks: list[Chunk] = []
        self._begin(candidate)

    def _begin(self, candidate: Candidate) -> None:
        self.candidate = candidate
        self.decoder = Decoder(candidate.protocol)
        self.accelerations = 0
        self._checked_bits = checked_bits(candidate.protocol)
        self._norms: list[float] = []
        self._arrivals: list[tuple[float, int]] = []
        self._messages: list[Message] = []
        self._fault = ""
        # Bad frames and skipped bytes before the end of the listening cut a frame; None while it goes on.
        self._before_end: tuple[int, int] | None = None

    def feed(self, chunk: Chunk) -> None:
        """Take the bytes of one read."""
        self._chunks.append(chunk)
        self._decode([chunk])

    def close(self) -> None:
        """Count the samples that the decoder kept back; nothing will follow."""
        counts = self.decoder.statistics
        # A frame that the end cuts is no fault of the candidate.
        self._before_end = (counts.frames_bad_checksum, counts.bytes_skipped)
        self._decode([], is_last=True)

    def _decode(self, chunks: Iterable[Chunk], *, is_last: bool = False) -> None:
        if self._fault:
            return
        try:
            for chunk in chunks:
                self._count(self.decoder.feed(chunk.data, chunk.monotonic_s))
                self._arrivals.append((chunk.monotonic_s, self.decoder.statistics.frames))
            if is_last:
                self._count(self.decoder.flush())
        except ProtocolError as error:
            # Increments may turn out to need a rate, which the error has: listen again with it, unless it is known already.
            rate_hz = error.values.get("rate_hz")
            candidate = None if rate_hz is None else self._at_rate(float(f"{rate_hz:.4g}"))
            if candidate is None:
                self._fault = error.message
                return
            self._begin(candidate)
            self._decode(self._chunks)

    def _at_rate(self, rate_hz: float) -> Candidate | None:
        """Return the candidate at another rate; None where the user gave one, or it cannot be set."""
        candidate = self.candidate
        setting = candidate.protocol.settings.get("rate_hz")
        if candidate.driver is None or setting is None or setting.origin == "given":
            return None
        given = with_origin(candidate.protocol.settings, "given")
        variant = {**candidate.variant, "rate_hz": rate_hz}
        try:
            protocol = candidate.driver.load_protocol({**given, **variant})
        except ProtocolError:  # Beyond what the setting may be.
            return None
        return replace(candidate, protocol=protocol, variant=variant)

    def at_pace(self) -> tuple[Candidate, Sentence | None]:
        """Return the candidate at the rate at which samples come, where their time is counted at a rate that is another.

        With it comes a sentence where that rate was given, or cannot be set here.
        """
        set_hz, (arrival_hz, is_steady) = self.candidate.protocol.clock.rate_hz, self._pace(by_arrival=True)
        counts = self.decoder.statistics
        if not (self.decoder.time_is_counted and set_hz and arrival_hz and is_steady):
            return self.candidate, None
        # The counter tells what was lost on the way.
        arrival_hz *= (counts.samples + counts.samples_lost) / counts.samples
        if abs(arrival_hz / set_hz - 1) <= _OTHER_RATE:
            return self.candidate, None
        rate_hz = usual_rate(arrival_hz)
        candidate = self._at_rate(rate_hz)
        if candidate is None:
            return self.candidate, sentence("recognise.other_rate", arrival_hz=arrival_hz, set_hz=set_hz, rate_hz=rate_hz)
        reason = sentence("recognise.rate", rate_hz=arrival_hz)
        return replace(candidate, reasons={**candidate.reasons, "rate_hz": reason}), None

    def messages(self) -> list[Message]:
        """Return the messages that arrived and are no samples."""
        self._messages += self.decoder.messages()
        return self._messages

    @property
    def is_promising(self) -> bool:
        """Whether longer listening is worth it."""
        # One frame may be a coincidence.
        return self.decoder.statistics.frames >= 2

    def finding(self) -> Finding:
        """Judge what was heard so far."""
        counts = self.decoder.statistics
        bad, skipped = self._before_end or (counts.frames_bad_checksum, counts.bytes_skipped)
        share = 1.0 - skipped / counts.bytes_total if counts.bytes_total else 0.0
        norm = float(median(self._norms)) if self._norms else None
        rate_hz, steady = self._pace()
        heard = Finding(
            name=self.candidate.name,
            title=self.candidate.title,
            variant=dict(self.candidate.variant),
            found=True,
            reason="",
            frames=counts.frames,
            frames_bad_checksum=bad,
            samples=counts.samples,
            bytes_total=counts.bytes_total,
            share=share,
            checked_bits=self._checked_bits,
            rate_hz=rate_hz,
            norm_m_s2=norm,
            noise_ug=self._noise_ug(rate_hz),
            steady=steady,
        )
        reason = self._objection(heard)
        return replace(heard, found=not reason, reason=reason)

    @property
    def is_certain(self) -> bool:
        """Whether listening longer would add nothing."""
        if self.decoder.statistics.samples < CERTAIN_SAMPLES:
            return False
        # The rate is part of the evidence; who named the instrument need not wait for it, unless samples are timed by it.
        least_s = _PACE_S if self.decoder.time_is_counted else 0.0 if self._is_given else RATE_S
        heard_s = self._arrivals[-1][0] - self._arrivals[0][0] if self._arrivals else 0.0
        return heard_s >= least_s and self.finding().found

    def _count(self, samples: Samples) -> None:
        # Messages of rates alone have no acceleration to judge by.
        finite = np.isfinite(samples.accelerometer).all(axis=1)
        self.accelerations += int(finite.sum())
        units = samples.units
        scale = units.interval_s if units.accelerometer_is_increment else 1.0
        if units.accelerometer in ("m/s^2", "m/s") and scale and len(self._norms) < _NORMS_KEPT:
            self._norms += (np.linalg.norm(samples.accelerometer[finite], axis=1) / scale).tolist()

    def _noise_ug(self, rate_hz: float | None) -> float | None:
        # Fewer tell a variance to no better than a factor.
        if not rate_hz or len(self._norms) < CERTAIN_SAMPLES:
            return None
        # A second difference of independent values has six times their variance, and no drift or slow turn.
        sigma_m_s2 = float(np.std(np.diff(self._norms, 2))) / math.sqrt(6)
        return sigma_m_s2 / math.sqrt(rate_hz) / MICRO_G_M_S2 or None

    def _objection(self, heard: Finding) -> str:
        """Return why this is not the instrument; empty if it is."""
        share, norm = heard.share, heard.norm_m_s2
        if self._fault:
            return self._fault
        if heard.holds_no_sample:
            return without_samples(self.candidate.protocol, [self.decoder.statistics])
        if heard.samples < FEWEST_SAMPLES:
            return sentence("recognise.few_samples", samples=heard.samples, needed=FEWEST_SAMPLES)
        if share < STRONG_SHARE:
            return sentence("recognise.share", percent=100 * share, needed_percent=100 * STRONG_SHARE)
        if self._is_given or heard.is_strong:
            return ""
        # Frames that may be a coincidence.
        if heard.samples < CERTAIN_SAMPLES:
            return sentence("recognise.few_weak_samples", samples=heard.samples, needed=CERTAIN_SAMPLES)
        if share < WEAK_SHARE:
            return sentence("recognise.share", percent=100 * share, needed_percent=100 * WEAK_SHARE)
        if norm is None:
            return sentence("recognise.unknown_unit")
        if not GRAVITY_M_S2[0] <= norm <= GRAVITY_M_S2[1]:
            return sentence("recognise.no_gravity", norm_m_s2=norm)
        return "" if heard.steady else sentence("recognise.unsteady")

    def _pace(self, *, by_arrival: bool = False) -> tuple[float | None, bool]:
        """Return samples in each second, by the protocol where it knows that, and whether they come evenly to the host."""
        # A line through two points fits any pace.
        if len(self._arrivals) < 3:
            return None, False
        time_s, frames = np.array(self._arrivals, dtype=np.float64).T
        if time_s[-1] <= time_s[0] or frames[-1] == frames[0]:
            return None, False
        slope, offset = np.polyfit(time_s - time_s[0], frames, 1)
        departure = np.abs(frames - offset - slope * (time_s - time_s[0])).max()
        counts = self.decoder.statistics
        # Frames may hold several samples, or several make one.
        each = counts.samples / counts.frames if counts.frames else math.nan
        # The rate that the protocol knows is exact; the slope has the jitter of the host.
        known_hz = None if by_arrival else counts.nominal_rate_hz
        rate_hz = known_hz or (slope * each if each > 0 else None)
        return rate_hz, bool(departure <= max(_STEADY_FRAMES / max(each, 1e-9), _STEADY_SHARE * (frames[-1] - frames[0])))


def usual_rate(rate_hz: float) -> float:
    """Return the usual rate that one by arrival stands for, or that in three digits where none is near."""
    nearest = min(_USUAL_HZ, key=lambda usual_hz: abs(math.log(usual_hz / rate_hz)))
    return float(nearest if abs(nearest / rate_hz - 1) < _SAME_RATE else f"{rate_hz:.3g}")


def best(listeners: Iterable[Listener]) -> Listener | None:
    """Return the listener whose candidate is the instrument: strong frames first, then the most understood; None without."""
    found = [(listener, finding) for listener in listeners if (finding := listener.finding()).found]
    return max(found, key=lambda pair: (pair[1].is_strong, pair[0].accelerations, pair[1].share), default=(None, None))[0]


def checked_bits(protocol: Protocol) -> int:
    """Return how many bits of the weakest frame of a protocol are fixed or a checksum."""
    if protocol.frame is not None:
        return 8 * min(len(form.sync) + form.tail for form in protocol.frame.forms)
    rule = protocol.lines
    if rule is None or not rule.sentences:
        # A prefix that was found in the lines, or given, proves nothing.
        return 8 * len(rule.prefix) if rule and "prefix" not in protocol.settings else 0
    # Of a sentence its "$", its name and the checksum are fixed.
    shortest = min(len(sentence.name) for sentence in rule.sentences)
    return 8 * (1 + shortest + min((checksum.size for checksum in rule.checksums), default=0))
