"""The way of the data from bytes to observations: the same for a live capture, a replay and a test (CONTRIBUTING.md).

A chain has one decoder per part and one guide (or, for sessions that nobody guided, one finder of still intervals) per
session. It reads no clock: arrival times come with the bytes.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict, dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from imufield.acquire.decode.statistics import DecoderStatistics
from imufield.acquire.decoder import Decoder
from imufield.acquire.protocol.protocol import Protocol, parse_protocol
from imufield.acquire.recording.reader import Damage, PartStart, RecordedBlock, RecordedEvent, read_blocks, read_session
from imufield.acquire.recording.session import SETTINGS_FILE, Session
from imufield.calibrate.model.observations import Observations
from imufield.errors import CalibrationError, ProtocolError, Reason, RecordingError, SettingError
from imufield.files import Origin
from imufield.guide.events import HORIZONTAL, VERTICAL, Event, LinkLost
from imufield.guide.lead.settings import GuideSettings
from imufield.guide.positions import SCHEME_FILE, SCHEMES, scheme
from imufield.guide.stillness.scale import RoughScale
from imufield.pipeline.damage import name_recording, require_samples
from imufield.pipeline.site import SiteOptions
from imufield.samples import FloatArray, Samples, Status, concatenate, no_samples
from imufield.sentences import Sentences

if TYPE_CHECKING:
    from imufield.guide.lead.guide import Guide
    from imufield.guide.lead.unguided import StillIntervalFinder, StillIntervals

sentence = Sentences(__package__)

MARK = "mark"
"""Name of a recorded event: what the operator said, to be said again on replay."""
ROTATIONS = {"rolled": HORIZONTAL, "table": VERTICAL}
"""Kinds of whole turns, as ``--rotations`` names them, and the axis they are about."""
UNPLUGGED = "unplugged"
"""Name of a recorded event: the link was lost, and what comes behind it is read anew. Recordings that are older have only what
the guide said of it, ``link_lost``."""
PART_GAP_S = 1.0
"""Least time between the samples of two parts, whatever the clocks of the host say of them."""

# Of a replay that nobody watches: as much as the decoder works off at once. More would not stay in the cache, and of what comes
# slowly a hundred samples cost as much as one.
_BLOCK_BYTES = 1 << 18
_BLOCK_SPAN_S = 16.0

OUTLINE_BYTES = 1 << 25
"""Of a recording, decoded for a first picture of it: a second of one core at 2000 Hz."""

SamplesListener = Callable[[Samples], None]
Items = Iterator[PartStart | RecordedBlock | RecordedEvent]


@dataclass(frozen=True, slots=True)
class ReadingPlan:
    """How a session is read: guided through a scheme, or every still interval for itself (``scheme`` is None)."""

    scheme: str | None
    guide: GuideSettings = field(default_factory=GuideSettings)
    raw_zero: tuple[float, ...] | None = None
    """Mid-scale of the accelerometer, where the protocol does not tell it."""

    @classmethod
    def of(cls, session: Session) -> ReadingPlan:
        """Return the plan written in ``session.toml``; positions of the user's own stand beside it."""
        record, site = session.record, session.record.site
        # No other name: it would be one of a file anywhere.
        if record.scheme not in (*SCHEMES, SCHEME_FILE, "", None):
            path = session.folder / SETTINGS_FILE
            raise RecordingError(sentence("chain.scheme", path=path, scheme=record.scheme, known=[*SCHEMES, SCHEME_FILE]))
        scheme = str(session.folder / SCHEME_FILE) if record.scheme == SCHEME_FILE else record.scheme or None
        gravity = SiteOptions(is_default=True).gravity(site)
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
        self.protocol: Protocol | None = None
        self.decoder: Decoder | None = None
        self.statistics: list[DecoderStatistics] = []  # One per part.
        self.temperature_degc = (float("nan"), float("nan"))  # Lowest and highest so far.
        self._offsets = np.zeros((2, 6))  # Of the axes' thermometers from that temperature: sums, and how many.
        self.notes: list[str] = []  # Sentences about how the recording was read.
        self._listeners = listeners
        self._offset_s: float | None = 0.0  # None from the start of a later part to its first samples, which tell it.
        self._first_s: float | None = None
        self._last_s: float | None = None
        self._last_utc_ns = 0  # Of the newest read.
        self._pause_s: float | None = None  # From the last read of a decoder to the first of the next one.

    def start_part(self, protocol: Protocol) -> list[Event]:
        """Begin a part: clocks, counters and half frames do not carry over.

        Raises
        ------
        ProtocolError
            If its samples have other units than those of the parts before.
        CalibrationError
            If the instrument has taken gravity out of them.
        """
        if self.protocol is not None and protocol.units != self.protocol.units:
            units = [self.protocol.units.words, protocol.units.words]
            raise ProtocolError(sentence("chain.units", units=units), Reason.UNITS)
        self.protocol = protocol
        if self._judging:
            require_gravity(protocol)
        # Not before the first part: the judge needs the units and the rough scale, which its protocol tells.
        if self._judging and self.guide is None and self.finder is None:
            self._begin_to_judge(protocol)
        events = self._start_decoder(protocol)
        # Whoever stopped and goes on wanted the pause: to call it a lost link would alarm for nothing.
        return [
            replace(event, words=sentence("chain.part_begins"), resumed=True) if isinstance(event, LinkLost) else event
            for event in events
        ]

    def _begin_to_judge(self, protocol: Protocol) -> None:
        # Each imported here: samples alone need neither of them, and what nobody guided needs no guide.
        nominal = protocol.nominal
        scale = RoughScale(nominal.accelerometer_scale, nominal.gyroscope_scale, self.raw_zero(protocol))
        if self.plan.scheme is None:
            from imufield.guide.lead.unguided import StillIntervalFinder

            self.finder = StillIntervalFinder(protocol.units, scale)
        else:
            from imufield.guide.lead.guide import Guide

            settings = replace(self.plan.guide, grade=nominal.grade)
            self.guide = Guide(scheme(self.plan.scheme, Origin.INSIDE), protocol.units, scale=scale, settings=settings)

    def feed_block(self, block: RecordedBlock) -> list[Event]:
        """Take many recorded reads at once, as if they came one by one."""
        self._note_arrival(block.first_utc_ns, block.utc_ns)
        return self._take(self._started().feed_chunks(block.data, block.end, block.monotonic_s))

    def feed(self, data: bytes, arrival_s: float, utc_ns: int) -> list[Event]:
        """Take the bytes of one read and return what the guide has to say."""
        self._note_arrival(utc_ns, utc_ns)
        return self._take(self._started().feed(data, arrival_s))

    def _note_arrival(self, first_utc_ns: int, last_utc_ns: int) -> None:
        """Measure the pause behind which a new decoder begins: by reads, which are the same however they are joined."""
        if self._offset_s is None and self._pause_s is None:
            self._pause_s = max((first_utc_ns - self._last_utc_ns) / 1e9, PART_GAP_S)
        self._last_utc_ns = last_utc_ns

    def _started(self) -> Decoder:
        if self.decoder is None:
            raise RecordingError(sentence("chain.no_part"), Reason.DAMAGED)
        return self.decoder

    def _take(self, samples: Samples) -> list[Event]:
        if not len(samples):
            return []
        samples = self._on_session_clock(samples)
        if self._first_s is None:
            self._first_s = float(samples.time_s[0])
        self._last_s = float(samples.time_s[-1])
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
        return self.guide.mark(action, self.guide.time_s if time_s is None else time_s, position)

    def link_lost(self) -> list[Event]:
        """Say that nothing arrives any more; what comes later is read anew."""
        # A decoder that has read nothing is a new one: to say it twice, as recordings do, changes nothing.
        is_new = self.decoder is None or not self.decoder.statistics.bytes_total
        return [] if is_new or self.protocol is None else self._start_decoder(self.protocol)

    def finish(self) -> list[Event]:
        """Take what the decoder held back; nothing will follow."""
        events = self._flush_decoder()
        return events + self.guide.flush() if self.guide is not None else events

    def observations(self) -> Observations:
        """Return the accepted positions of a guided session."""
        if self.guide is None:
            raise ValueError("the session is not guided: ask `still_intervals`")
        return self.guide.observations()

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
        """
        if self.finder is None:
            raise ValueError("the session is guided: ask `observations`")
        return self.finder.finish()

    def raw_zero(self, protocol: Protocol) -> FloatArray:
        """Return the raw accelerometer output at no input, shape (3,)."""
        return protocol.nominal.raw_zero if self.plan.raw_zero is None else np.array(self.plan.raw_zero)

    def _start_decoder(self, protocol: Protocol) -> list[Event]:
        """Begin with fresh clocks, behind what was read before."""
        events = self._flush_decoder()
        self.decoder = Decoder(protocol)
        self.statistics.append(self.decoder.statistics)
        # At the very first there is nothing to be behind of, and no link that was lost.
        if self._last_s is None:
            return events
        self._offset_s = self._pause_s = None
        return events + self.guide.link_lost() if self.guide is not None else events

    def _flush_decoder(self) -> list[Event]:
        return [] if self.decoder is None else self._take(self.decoder.flush())

    def _on_session_clock(self, samples: Samples) -> Samples:
        """Shift the samples of a later part behind those of the parts before, as far as the host's clock says."""
        if self._offset_s is None and self._last_s is not None and self._pause_s is not None:
            self._offset_s = self._last_s + self._pause_s - float(samples.time_s[0])
            # How many are missing meanwhile, nobody has counted.
            samples = replace(samples, status=samples.status.copy())
            samples.status[0] |= np.uint32(Status.GAP_ESTIMATED)
        return replace(samples, time_s=samples.time_s + self._offset_s) if self._offset_s else samples


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


def recorded_protocol(metadata: Mapping[str, object], session: Session) -> Protocol:
    """Return the protocol a part was recorded with; the session's own where the part's start is damaged.

    Raises
    ------
    RecordingError
        If neither holds one.
    """
    # The part goes first: session.toml can be edited, and the bytes are what their part says.
    text = metadata.get("protocol_text") or session.record.protocol.text
    if not isinstance(text, str) or not text:
        raise RecordingError(sentence("chain.no_protocol", folder=session.folder))
    try:
        settings = _recorded_settings(metadata) or session.record.setting_values
        return parse_protocol(text, settings, label=f"protocol of {session.name}")
    except SettingError as error:
        # Nobody typed it: it stands in the recording.
        raise ProtocolError(error.message, error.reason, **error.values) from error


def session_protocol(session: Session) -> Protocol:
    """Return the protocol of a session's first part, which is what its samples are decoded with; as ``recorded_protocol``."""
    part = next((item for item in read_session(session) if isinstance(item, PartStart)), None)
    return recorded_protocol({} if part is None else part.metadata, session)


def _recorded_settings(metadata: Mapping[str, object]) -> Mapping[str, object]:
    """Return the settings that a part was recorded with; empty where its start is damaged."""
    settings = metadata.get("settings")
    return settings if isinstance(settings, dict) else {}


def _edited_settings(part: PartStart, session: Session) -> list[str]:
    """Say which settings in ``session.toml`` are not those the bytes of a part were recorded with, which are used."""
    # With an edited range every sample would have another scale, and nothing in the result would show it.
    recorded = _recorded_settings(part.metadata)
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
    for events in _replayed(chain, session, damage, ended=ended, items=items):
        if events and listener is not None:
            listener(events)


def _replayed(
    chain: Chain, session: Session, damage: list[Damage], *, ended: bool = True, items: Items | None = None
) -> Iterator[list[Event]]:
    """Yield the events of each step of a replay; raises as ``replay_into``."""
    # Asked before reading: a recording that ends meanwhile was read while it went on.
    under_way = session.part_under_way if ended else None
    for item in items or read_blocks(session, damage, block_bytes=_BLOCK_BYTES, span_s=_BLOCK_SPAN_S):
        if isinstance(item, PartStart):
            events = chain.start_part(recorded_protocol(item.metadata, session))
            chain.notes += _edited_settings(item, session)
        elif isinstance(item, RecordedEvent):
            events = _say_again(chain, item.event)
        else:
            events = chain.feed_block(item)
        yield events
    name_recording(damage, under_way)
    # Where a capture goes on, what the decoder holds back is completed by what comes, and no sample yet is no fault.
    if ended:
        yield chain.finish()
        require_samples(session, chain.protocol, chain.statistics, damage)


def session_samples(session: Session, damage: list[Damage]) -> Iterator[Samples]:
    """Decode a session, block by block, on one sample clock; raises as ``replay_into``."""
    blocks: list[Samples] = []
    chain = Chain(ReadingPlan(None), listeners=(blocks.append,), judging=False)
    for _ in _replayed(chain, session, damage):
        yield from blocks
        # Cleared at once, or hours of samples would be in memory at the end.
        blocks.clear()


def session_outline(session: Session, damage: list[Damage]) -> Iterator[Samples]:
    """Decode one second in some of a long recording, each for itself, timed by its arrival: for a first picture.

    A recording of at most ``OUTLINE_BYTES``, and one without arrival times, is decoded whole. Raises as ``replay_into``.
    """
    # Rounded up: what is decoded takes as long for a day as for an hour.
    every = -(-sum(path.stat().st_size for path in session.parts) // OUTLINE_BYTES)
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


def _say_again(chain: Chain, event: Mapping[str, object]) -> list[Event]:
    """Repeat what a person or the link did while the session was recorded."""
    kind = event.get("event")
    if kind == MARK:
        # Of what the file says only what is of the right type is taken: it may be edited, or by another version.
        time_s, position = event.get("time_s"), event.get("position")
        return chain.mark(
            str(event.get("action")),
            time_s if isinstance(time_s, int | float) else None,
            position if isinstance(position, str) else None,
        )
    return chain.link_lost() if kind in (UNPLUGGED, "link_lost") else []
