"""Open a CAN bus and make sure that an instrument sends there: what ``connect`` does where ``--bus`` is given.

Nothing is tried on a bus: an adapter with the wrong bit rate disturbs everyone on it, so a rate that the bus does not have
by itself must be known. Frames have no checksum of their own, and products share messages: where several drivers understand
the same frames, the user says which it is.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable

from imufield.acquire.decode.statistics import LEFT_OUT
from imufield.acquire.driver import Message
from imufield.acquire.instrument.baud_search import LISTEN_S, Say, driver_candidates, usable
from imufield.acquire.instrument.can_map import bus_candidate
from imufield.acquire.instrument.connected import (
    Connected,
    ConnectOptions,
    ask_identity,
    read_identity,
    say_what_is_known,
    with_settings,
)
from imufield.acquire.instrument.instrument import Instrument
from imufield.acquire.instrument.recognise import CERTAIN_SAMPLES, FEWEST_SAMPLES, Candidate, Listener
from imufield.acquire.link.background import BackgroundLink
from imufield.acquire.link.can import CanLink, open_can_link, parse_bus
from imufield.acquire.link.chunk import Chunk
from imufield.acquire.link.host_clock import HostClock, patience_s
from imufield.acquire.protocol.can_frame import ERROR
from imufield.acquire.protocol.can_frames import unpack_frames
from imufield.acquire.protocol.protocol import parse_protocol
from imufield.dataclass import dataclass
from imufield.errors import LinkError, LinkTimeoutError, Reason, UsageError
from imufield.sentences import Sentences

sentence = Sentences(__package__)

_IDENTIFIERS_NAMED = 8  # More identifiers than this do not help a reader of an error message.


def _known_frames(listener: Listener) -> int:
    """Count the frames of samples and messages that a candidate knows."""
    counts = listener.decoder.statistics
    return counts.frames - sum(counts.by_kind.get(kind, 0) for kind in ("other", "error frame", LEFT_OUT))


def connect_bus(options: ConnectOptions, clock: HostClock, say: Say) -> Connected:
    """Open the bus and listen until an instrument is understood.

    Parameters
    ----------
    options : ConnectOptions
        With a ``bus``.
    clock : HostClock
    say : callable
        Told what was assumed.

    Raises
    ------
    LinkError
        No such bus; silence; error frames alone; frames that nobody understands.
    UsageError
        Driver, DBC file or bit rate are missing, contradict each other, or several drivers understand the same frames.
    ProtocolError
        DBC file or protocol cannot be understood.
    """
    if options.rate_hz is not None:
        raise UsageError(sentence("connect_can.rate"))
    link, chunks, listener = _recognised(options, clock, say)
    candidate = listener.candidate
    driver, protocol, identity = candidate.driver, candidate.protocol, {}
    try:
        if driver is not None:
            instrument = Instrument(driver, clock, set(listener.decoder.statistics.by_kind))
            messages = ask_identity(instrument, link, chunks, listener.messages())
            identity = read_identity(driver, messages)
            protocol = with_settings(driver, protocol, messages)
        if driver is not None and options.driver is None:
            frames = _known_frames(listener)
            say(sentence("connect_can.recognised", driver=candidate.name, frames=frames, title=protocol.title))
        say_what_is_known(driver, protocol, identity, say)
        model = identity.pop("model", "") or candidate.name
        return Connected(
            link=BackgroundLink(link),
            protocol=protocol,
            driver=candidate.name,
            model=model,
            baud=link.address.bit_rate or link.bit_rate,
            chunks=chunks,
            identity=identity,
            wire="can",
            say=say,
        )
    except BaseException:
        link.close()
        raise


@dataclass(frozen=True, slots=True, kw_only=True)
class BusFinding:
    """What sends on a bus: driver, its title, frames it knows, samples made of them, and what it said of itself."""

    name: str
    title: str
    frames: int
    samples: int
    identity: dict[str, str]


def probe_bus(
    options: ConnectOptions, clock: HostClock, say: Say, *, ask: bool, opened: Callable[[], None] = lambda: None
) -> BusFinding:
    """Listen on a bus, send nothing unless ``ask``, and leave it; raises as ``connect_bus``. ``opened`` as in ``search``."""
    link, chunks, listener = _recognised(options, clock, say, opened)
    candidate, identity = listener.candidate, {}
    try:
        messages: list[Message] = [*listener.messages()]
        if candidate.driver is not None:
            if ask:
                instrument = Instrument(candidate.driver, clock, set(listener.decoder.statistics.by_kind))
                messages = ask_identity(instrument, link, chunks, messages)
            identity = read_identity(candidate.driver, messages)
    finally:
        link.close()
    return BusFinding(
        name=candidate.name,
        title=candidate.protocol.title,
        frames=_known_frames(listener),
        samples=listener.decoder.statistics.samples,
        identity=identity,
    )


def _recognised(
    options: ConnectOptions, clock: HostClock, say: Say, opened: Callable[[], None] = lambda: None
) -> tuple[CanLink, list[Chunk], Listener]:
    """Return the open bus, what arrived, and who understood it; raises as ``connect_bus``."""
    bus = options.bus or ""
    address = parse_bus(bus)
    candidates = bus_candidates(options, say)
    bit_rate = options.baud
    if not address.takes_bit_rate:
        if bit_rate not in (None, address.bit_rate):
            say(sentence("connect_can.other_bit_rate", bus=bus, bit_rate=bit_rate))
        bit_rate = None
    elif bit_rate is None:
        known = {candidate.bauds[:1] for candidate in candidates}
        if len(known) != 1 or known == {()}:
            raise UsageError(sentence("connect_can.which_bit_rate", bus=bus))
        bit_rate = candidates[0].bauds[0]
        say(sentence("connect_can.bit_rate", bit_rate=bit_rate))
    link = open_can_link(bus, bit_rate=bit_rate, clock=clock)
    listeners = [Listener(candidate) for candidate in candidates]
    try:
        opened()
        chunks = _listen(link, listeners, clock)
        return link, chunks, _best(bus, chunks, listeners)
    except BaseException:
        link.close()
        raise


def bus_candidates(options: ConnectOptions, say: Say | None = None) -> list[Candidate]:
    """Return the ways to read the bus: the one that was given, else every CAN driver; raises as ``connect_bus``."""
    if options.protocol is not None and options.dbc is not None:
        raise UsageError(sentence("connect_can.protocol_and_dbc"))
    if options.mapping and options.dbc is None:
        raise UsageError(sentence("connect_can.map_without_dbc"))
    if options.protocol is not None or options.dbc is not None:
        # A file that is named goes before a driver, which may be a default.
        return [bus_candidate(protocol=options.protocol, dbc=options.dbc, mapping=options.mapping, settings=options.settings)]
    if options.driver is not None:
        return [bus_candidate(driver=options.driver, settings=options.settings)]
    if options.protocol_text is not None:
        protocol = parse_protocol(options.protocol_text, options.settings, label="protocol of the session")
        return [bus_candidate(protocol=protocol)]
    return usable("can", lambda driver: driver_candidates(driver, options.settings, only_known=True), say)


def _listen(link: CanLink, listeners: list[Listener], clock: HostClock) -> list[Chunk]:
    """Read until one listener is certain, or the patience is over."""
    chunks: list[Chunk] = []
    end_s = clock.monotonic_s() + patience_s(clock, LISTEN_S)
    while clock.monotonic_s() < end_s:
        chunk = link.read()
        if chunk is None:
            continue
        chunks.append(chunk)
        for listener in listeners:
            listener.feed(chunk)
        if any(listener.decoder.statistics.samples >= CERTAIN_SAMPLES for listener in listeners):
            return chunks
    # A decoder keeps samples back while stamps are too uneven to tell their rate: they are understood all the same.
    for listener in listeners:
        listener.close()
    return chunks


def _best(bus: str, chunks: Iterable[Chunk], listeners: list[Listener]) -> Listener:
    """Return the listener that understood the most frames; an error where none did, or several the same."""
    good = [listener for listener in listeners if listener.decoder.statistics.samples >= FEWEST_SAMPLES]
    if not good:
        raise _nothing_understood(bus, chunks, listeners)
    # Drivers of one family understand parts of what the others send.
    most = max(_known_frames(listener) for listener in good)
    best = [listener for listener in good if _known_frames(listener) == most]
    if len(best) > 1:
        # The titles are those of the drivers: instruments that send the same messages share a protocol.
        drivers = "; ".join(f"{listener.candidate.name}, {listener.candidate.title}" for listener in best)
        raise UsageError(sentence("connect_can.several_drivers", bus=bus, drivers=drivers))
    return best[0]


def _nothing_understood(bus: str, chunks: Iterable[Chunk], listeners: list[Listener]) -> LinkError:
    frames = [frame for chunk in chunks for frame in unpack_frames(chunk.data)]
    identifiers = Counter(frame.text.partition("#")[0] for frame in frames if not frame.can_id & ERROR)
    if not frames:
        return LinkTimeoutError(sentence("connect_can.silent", bus=bus, waited_s=LISTEN_S), Reason.SILENCE)
    if not identifiers:
        return LinkError(sentence("connect_can.error_frames", bus=bus, error_frames=len(frames)), Reason.NO_FRAMES)
    heard = {"bus": bus, "frames": len(frames), "needed": FEWEST_SAMPLES}
    known = max(listeners, key=_known_frames)
    # The frames are known and yet make no samples: then it is not the driver that is wrong.
    if _known_frames(known) >= len(frames) / 2:
        found = {"driver": known.candidate.name, "known": _known_frames(known), "samples": known.decoder.statistics.samples}
        return LinkError(sentence("connect_can.not_joined", **heard, **found), Reason.NO_FRAMES)
    names = [f"{text} x {count}" for text, count in identifiers.most_common(_IDENTIFIERS_NAMED)]
    if len(identifiers) > _IDENTIFIERS_NAMED:
        names.append(sentence("connect_can.others", others=len(identifiers) - _IDENTIFIERS_NAMED))
    # One that was given: which messages are mapped is wrong, and not which driver.
    is_own = all(listener.candidate.driver is None for listener in listeners)
    drivers = [listener.candidate.name for listener in listeners]
    samples = max(listener.decoder.statistics.samples for listener in listeners)
    key = "connect_can.unmapped" if is_own else "connect_can.unknown"
    unknown = sentence(key, **heard, drivers=drivers, identifiers=names, samples=samples)
    return LinkError(unknown, Reason.NO_FRAMES)
