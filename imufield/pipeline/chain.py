"""The way of the data from bytes to observations: the same for a live capture, a replay and a test (CONTRIBUTING.md).

A chain has one decoder per part and one guide (or, for sessions that nobody guided, one finder of still intervals) per
session. It reads no clock: arrival times come with the bytes.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from imufield.acquire.decode.statistics import DecoderStatistics
from imufield.acquire.decoded_session import (
    Items,
    Step,
    decoded,
    recorded_protocol,
    recorded_settings,
    session_blocks,
    session_protocol,
)
from imufield.acquire.decoder import Decoder
from imufield.acquire.decoding_process import session_steps
from imufield.acquire.protocol.protocol import Protocol
from imufield.acquire.recording.reader import Damage, PartStart, RecordedBlock, read_blocks, size_bytes
from imufield.acquire.recording.session import SETTINGS_FILE, Session
from imufield.acquire.session_decoder import SessionDecoder
from imufield.calibrate.model.observations import Observations
from imufield.dataclass import asdict, dataclass, field, replace
from imufield.errors import CalibrationError, Reason, RecordingError
from imufield.files import Origin
from imufield.guide.events import ACTIONS, HORIZONTAL, VERTICAL, Event, LinkLost
from imufield.guide.lead.settings import GuideSettings
from imufield.guide.positions import SCHEME_FILE, SCHEMES, scheme
from imufield.guide.stillness.scale import RoughScale
from imufield.pipeline.damage import name_recording, require_samples
from imufield.pipeline.site import SiteOptions
from imufield.samples import FloatArray, Samples, concatenate, no_samples
from imufield.sentences import Sentences

if TYPE_CHECKING:
    from imufield.guide.lead.guide import Guide
    from imufield.guide.lead.unguided import StillIntervalFinder, StillIntervals

sentence = Sentences(__package__)

MARK = "mark"
"""Name of a recorded event: what the operator said, to be said again on replay."""
ROTATIONS = {"rolled": HORIZONTAL, "table": VERTICAL}
"""Kinds of whole turns, as ``--rotations`` names them, and the axis they are about."""
_LATEST_MARK_S = 1e10  # Three centuries of the sample clock: beyond it is no time.
OUTLINE_BYTES = 1 << 25
"""Of a recording, decoded for a first picture of it: a second of one core at 2000 Hz."""

SamplesListener = Callable[[Samples], None]


@dataclass(frozen=True, slots=True)
class ReadingPlan:
    """How a session is read: guided through a scheme, or every still interval for itself (``scheme`` is None)."""

    scheme: str | None
    guide: GuideSettings = field(default_factory=GuideSettings)
    raw_zero: tuple[float, ...] | None = None
    """Raw zero of the accelerometer or of both triads, as the instrument sends it, where the protocol does not tell it."""

    @classmethod
    def of(cls, session: Session) -> ReadingPlan:
        """Return the plan written in ``session.toml``; positions of the user's own stand beside it."""
        record, site = session.record, session.record.site
        # No other name: it would be one of a file anywhere.
        if record.scheme not in (*SCHEMES, SCHEME_FILE, "", None):
            path = session.folder / SETTINGS_FILE
            raise RecordingError(sentence("chain.scheme", path=path, scheme=record.scheme, known=[*SCHEMES, SCHEME_FILE]))
        scheme = str(session.folder / SCHEME_FILE) if record.scheme == SCHEME_FILE else record.scheme or None
        gravity = SiteOptions().gravity(site)
        # The settings have the names that they have in the file; what it does not state keeps its default.
        stated: dict[str, Any] = {name: value for name, value in asdict(record.guide).items() if value is not None}
        return cls(scheme, GuideSettings(gravity=gravity, **stated), record.nominal.raw_zero)


class Chain:
    """Bytes in, events out.

    Parameters
    ----------
    plan : ReadingPlan
    listeners : sequence of callable
        Each is given every block of samples, in order.
    judging : bool
        False where only the samples are wanted.
    """

    def __init__(self, plan: ReadingPlan, listeners: tuple[SamplesListener, ...] = (), *, judging: bool = True) -> None:
        self.plan = plan
        self._judging = judging
        self.guide: Guide | None = None
        self.finder: StillIntervalFinder | None = None
        self.decoder = SessionDecoder()
        self.temperature_degc = (float("nan"), float("nan"))  # Lowest and highest so far.
        self._offsets = np.zeros((2, 6))  # Of the axes' thermometers from that temperature: sums, and how many.
        self.notes: list[str] = []  # Sentences about how the recording was read.
        self._listeners = listeners
        self._first_s: float | None = None

    @property
    def protocol(self) -> Protocol | None:
        """That of the part under way."""
        return self.decoder.protocol

    @property
    def statistics(self) -> list[DecoderStatistics]:
        """One for each decoder."""
        return self.decoder.statistics

    def start_part(self, protocol: Protocol) -> list[Event]:
        """Begin a part: clocks, counters and half frames do not carry over.

        Raises
        ------
        ProtocolError
            If its samples have other units than those of the parts before.
        CalibrationError
            If the instrument has taken gravity out of them.
        """
        return self._begin_part(protocol, self.decoder.start_part(protocol))

    def _begin_part(self, protocol: Protocol, held_back: Samples | None) -> list[Event]:
        if self._judging:
            require_gravity(protocol)
        # Not before the first part: the judge needs the units and the rough scale, which its protocol tells.
        if self._judging and self.guide is None and self.finder is None:
            self._begin_to_judge(protocol)
        return _as_resumed(self._begin_anew(held_back))

    def _begin_to_judge(self, protocol: Protocol) -> None:
        # Each imported here: samples alone need neither of them, and what nobody guided needs no guide.
        nominal = protocol.nominal
        scale = RoughScale(
            accelerometer=nominal.accelerometer_scale, gyroscope=nominal.gyroscope_scale, raw_zero=self.raw_zero(protocol)[:3]
        )
        if self.plan.scheme is None:
            from imufield.guide.lead.unguided import StillIntervalFinder

            self.finder = StillIntervalFinder(protocol.units, scale)
        else:
            from imufield.guide.lead.guide import Guide

            settings = replace(self.plan.guide, grade=nominal.grade)
            self.guide = Guide(scheme(self.plan.scheme, Origin.INSIDE), protocol.units, scale=scale, settings=settings)

    def feed(self, block: RecordedBlock) -> list[Event]:
        """Take what was read and return what the guide has to say."""
        return self._take(self.decoder.feed(block))

    def take(self, step: Step, session: Session) -> list[Event]:
        """Take what one item of a recorded session gives; raises as ``start_part``."""
        if isinstance(step.item, PartStart):
            self.notes += _edited_settings(step.item, session)
            # The decoder has it from the part's start.
            return self._begin_part(cast("Protocol", self.protocol), step.samples)
        if step.is_anew:
            return self._begin_anew(step.samples)
        events = self._take(step.samples)
        return events if step.item is None else events + self._say_again(step.item.event)

    def _say_again(self, event: Mapping[str, object]) -> list[Event]:
        """Repeat what a person did while the session was recorded."""
        # Of what the file says only what can be meant is taken: it may be edited, or by another version.
        action, time_s, position = (event.get(name) for name in ("action", "time_s", "position"))
        if event.get("event") != MARK or action not in ACTIONS:
            return []
        return self.mark(
            str(action),
            time_s if isinstance(time_s, int | float) and abs(time_s) <= _LATEST_MARK_S else None,
            position if isinstance(position, str) else None,
        )

    def _take(self, samples: Samples | None) -> list[Event]:
        if samples is None:
            return []
        if self._first_s is None:
            self._first_s = float(samples.time_s[0])
        known = samples.temperature_degc[np.isfinite(samples.temperature_degc)]
        if len(known):
            low, high = self.temperature_degc
            # fmin and fmax take the number where the other is NaN, as both are before the first.
            self.temperature_degc = (float(np.fmin(low, known.min())), float(np.fmax(high, known.max())))
        if samples.sensor_temperature_degc is not None:
            offsets = samples.sensor_temperature_degc - samples.temperature_degc[:, np.newaxis]
            # Hardly any instrument has them all the time, and most never.
            if (finite := np.isfinite(offsets)).any():
                self._offsets += [np.nansum(offsets, axis=0), finite.sum(axis=0)]
        for listener in self._listeners:
            listener(samples)
        if self.finder is not None:
            self.finder.feed(samples)
        return self.guide.feed(samples) if self.guide is not None else []

    def sensor_offset_degc(self) -> FloatArray:
        """Return the temperature of each axis' sensor less that of the instrument, mean of all samples; NaN where not sent."""
        total, count = self._offsets
        return np.asarray(np.divide(total, count, out=np.full(6, np.nan), where=count > 0))

    def origin_s(self) -> float:
        """Return the sample clock at the session's first sample, what a person counts from; 0 before it."""
        return self._first_s or 0.0

    def mark(self, action: str, time_s: float | None = None, position: str | None = None) -> list[Event]:
        """Take what the operator says, now or at a time of the sample clock."""
        if self.guide is None:
            return []
        # A session that was finished is reopened by a mark.
        return _as_resumed(self.guide.mark(action, self.guide.time_s if time_s is None else time_s, position))

    def link_lost(self) -> list[Event]:
        """Say that nothing arrives any more; what comes later is read anew."""
        # A decoder that has read nothing is a new one: to lose the link twice changes nothing.
        return self._begin_anew(self.decoder.start_anew()) if self.decoder.has_read else []

    def finish(self) -> list[Event]:
        """Take what the decoder held back; nothing will follow."""
        events = self._take(self.decoder.flush())
        return events + self.guide.flush() if self.guide is not None else events

    def observations(self) -> Observations:
        """Return the accepted positions of a guided session, or those of the stills of another; raises as these do."""
        return self.still_intervals().observations if self.guide is None else self.guide.observations()

    def turn_rests(self) -> Observations | None:
        """Return the stills between the whole turns of a guided session; None where there are none."""
        rests = None if self.guide is None else self.guide.turn_rests()
        return rests if rests is not None and len(rests) else None

    def still_intervals(self) -> StillIntervals:
        """Return what an unguided session holds; nothing can be fed afterwards.

        Raises
        ------
        CalibrationError
            If no stretch is quiet enough.
        ValueError
            If the session is guided.
        """
        if self.finder is None:
            raise ValueError("the session is guided: ask `observations`")
        return self.finder.finish()

    def raw_zero(self, protocol: Protocol) -> FloatArray:
        """Return the raw zero of the accelerometer, shape (3,), or of both triads, shape (6,), as rates."""
        return protocol.raw_zero_rate(None if self.plan.raw_zero is None else np.array(self.plan.raw_zero))

    def _begin_anew(self, held_back: Samples | None) -> list[Event]:
        """Go on with a new decoder, behind what the one before held back."""
        events = self._take(held_back)
        # At the very first no link was lost.
        return events if self._first_s is None or self.guide is None else events + self.guide.link_lost()


def _as_resumed(events: list[Event]) -> list[Event]:
    """Return the events of an operator who had stopped or finished the session and goes on: no link was lost."""
    words = sentence("chain.part_begins")
    return [replace(event, words=words, resumed=True) if isinstance(event, LinkLost) else event for event in events]


def require_gravity(protocol: Protocol) -> None:
    """Refuse values that an instrument has corrected itself: without gravity there is nothing to calibrate by.

    Raises
    ------
    CalibrationError
        With what to set the instrument to.
    """
    if protocol.samples.corrected:
        corrected = sentence("chain.corrected", title=protocol.title, advice=protocol.samples.advice)
        raise CalibrationError(corrected, Reason.GRAVITY)


def _edited_settings(part: PartStart, session: Session) -> list[str]:
    """Say which settings in ``session.toml`` are not those the bytes of a part were recorded with, which are used."""
    # With an edited range every sample would have another scale, and nothing in the result would show it.
    recorded = recorded_settings(part.metadata)
    return [
        sentence("chain.edited", name=name, value=value, part=part.path.name, recorded=recorded[name])
        for name, value in session.record.setting_values.items()
        if name in recorded and recorded[name] != value
    ]


def replay_into(
    chain: Chain,
    session: Session,
    damage: list[Damage],
    listener: Callable[[list[Event]], None] | None = None,
    *,
    ended: bool = True,
    items: Items | None = None,
) -> None:
    """Run a recorded session through a chain, with the operator's marks at their places.

    Parameters
    ----------
    chain : Chain
    session : Session
    damage : list of Damage
        Receives what could not be read.
    listener : callable, optional
        Given the events of each step.
    ended : bool
        Nothing will follow; False where a capture goes on.
    items : iterator, optional
        Of ``read_blocks``, at a pace of its own; by default the session is read as fast as possible.

    Raises
    ------
    RecordingError
        If it cannot be read, or has ended without a sample.
    """
    # Asked before reading: a recording that ends meanwhile was read while it went on.
    under_way = session.part_under_way if ended else None
    if ended and items is None:
        steps = session_steps(session, damage, chain.decoder)
    else:
        steps = decoded(items or session_blocks(session, damage), session, chain.decoder)
    for step in steps:
        _hand_on(chain.take(step, session), listener)
    name_recording(damage, under_way)
    # Where a capture goes on, what the decoder holds back is completed by what comes, and no sample yet is no fault.
    if ended:
        _hand_on(chain.finish(), listener)
        require_samples(session, chain.protocol, chain.statistics, damage)


def _hand_on(events: list[Event], listener: Callable[[list[Event]], None] | None) -> None:
    if events and listener is not None:
        listener(events)


def session_samples(session: Session, damage: list[Damage]) -> Iterator[Samples]:
    """Decode a session, block by block, on one sample clock; raises as ``replay_into``."""
    decoder, under_way = SessionDecoder(), session.part_under_way
    for step in session_steps(session, damage, decoder):
        if step.samples is not None:
            yield step.samples
    name_recording(damage, under_way)
    require_samples(session, decoder.protocol, decoder.statistics, damage)


def session_outline(session: Session, damage: list[Damage]) -> Iterator[Samples]:
    """Decode one second in some of a long recording, each for itself, timed by its arrival: for a first picture.

    A recording of at most ``OUTLINE_BYTES``, and one without arrival times, is decoded whole. Raises as ``replay_into``.
    """
    # Rounded up: what is decoded takes as long for a day as for an hour.
    every = -(-size_bytes(session.parts) // OUTLINE_BYTES)
    # The bytes of an import have no arrival that tells their time.
    if every <= 1 or session.record.kind == "import":
        yield from session_samples(session, damage)
        return
    protocol, number, begun, under_way = session_protocol(session), 0, None, session.part_under_way
    for item in read_blocks(session, damage):
        if isinstance(item, PartStart):
            protocol = recorded_protocol(item.metadata, session)
        elif isinstance(item, RecordedBlock):
            number += 1
            samples = _alone(item, protocol) if number % every == 1 else no_samples(protocol.units)
            if len(samples):
                # The first keeps its times; of every other the last sample has arrived so much later.
                begun = begun or (item.utc_ns, float(samples.time_s[-1]))
                last_s = begun[1] + (item.utc_ns - begun[0]) / 1e9
                yield replace(samples, time_s=samples.time_s - samples.time_s[-1] + last_s)
    name_recording(damage, under_way)


def _alone(block: RecordedBlock, protocol: Protocol) -> Samples:
    decoder = Decoder(protocol)
    return concatenate([decoder.feed_chunks(block.data, block.end, block.monotonic_s), decoder.flush()])
