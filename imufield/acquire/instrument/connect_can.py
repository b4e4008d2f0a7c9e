"""Open a CAN bus and make sure that an instrument speaks there: what ``connect`` does where ``--bus`` is given.

Nothing is tried on a bus: an adapter with the wrong bit rate disturbs everyone on it, so a rate that the bus does not have
by itself must be known. Frames have no checksum of their own, and products share messages: where several drivers understand
the same frames, the user says which it is.
"""

from __future__ import annotations

import logging
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass

from imufield.acquire.decode.statistics import LEFT_OUT
from imufield.acquire.decoder import Decoder
from imufield.acquire.driver import Driver
from imufield.acquire.instrument.can_map import CanDescription, describe_can
from imufield.acquire.instrument.connect import Connected, ConnectOptions, ask_identity, assumed, untried, with_settings
from imufield.acquire.instrument.listen import LISTEN_S, Say, usable
from imufield.acquire.instrument.recognise import CERTAIN_SAMPLES, FEWEST_SAMPLES
from imufield.acquire.link.background import BackgroundLink
from imufield.acquire.link.can import BusAddress, CanLink, open_can_link, parse_bus
from imufield.acquire.link.host_clock import HostClock, patience_s
from imufield.acquire.link.serial import Chunk
from imufield.acquire.protocol.can_frames import ERROR, unpack_frames
from imufield.acquire.protocol.protocol import parse_protocol
from imufield.errors import LinkError, LinkTimeoutError, Reason, UsageError

_IDENTIFIERS_NAMED = 8  # More identifiers than this do not help a reader of an error message.


@dataclass(frozen=True, slots=True)
class _Ear:
    """A way to read the bus, and what it has understood so far."""

    description: CanDescription
    decoder: Decoder

    @property
    def driver(self) -> type[Driver] | None:
        return self.description.driver

    @property
    def samples(self) -> int:
        return self.decoder.statistics.samples

    @property
    def frames(self) -> int:
        """Frames of samples and messages that it knows."""
        counts = self.decoder.statistics
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
    link, chunks, found = _heard(options, clock, say)
    try:
        return _connected(link, chunks, found, options, clock=clock, say=say)
    except BaseException:
        link.close()
        raise


@dataclass(frozen=True, slots=True, kw_only=True)
class BusFinding:
    """What speaks on a bus: driver, its title, frames it knows, samples made of them, and what it said of itself."""

    name: str
    title: str
    frames: int
    samples: int
    identity: dict[str, str]


def probe_bus(options: ConnectOptions, clock: HostClock, say: Say, *, ask: bool) -> BusFinding:
    """Listen on a bus, send nothing unless ``ask``, and leave it; raises as ``connect_bus``."""
    link, chunks, found = _heard(options, clock, say)
    try:
        driver, messages = found.driver, found.decoder.messages()
        if driver is not None and ask:
            messages = ask_identity(link, chunks, driver, found.decoder, clock=clock)
        identity = {} if driver is None else driver.identity(messages)
    finally:
        link.close()
    return BusFinding(
        name=found.description.name,
        title=found.description.protocol.title,
        frames=found.frames,
        samples=found.samples,
        identity=identity,
    )


def _heard(options: ConnectOptions, clock: HostClock, say: Say) -> tuple[CanLink, list[Chunk], _Ear]:
    """Return the open bus, what came, and who understood it; raises as ``connect_bus``."""
    # What python-can has to say of drivers that are not installed is said in one sentence by the error of the bus.
    logging.getLogger("can").setLevel(logging.CRITICAL)
    address = parse_bus(options.bus or "")
    descriptions = can_descriptions(options, say)
    bit_rate = _bit_rate(options, address, descriptions, say)
    link = open_can_link(options.bus or "", bit_rate=bit_rate, clock=clock)
    ears = [_Ear(one, Decoder(one.protocol)) for one in descriptions]
    try:
        chunks = _listen(link, ears, clock)
        found = _best(link.name, ears)
        if found is None:
            raise _nothing_understood(link.name, chunks, ears)
    except BaseException:
        link.close()
        raise
    return link, chunks, found


def can_descriptions(options: ConnectOptions, say: Say | None = None) -> list[CanDescription]:
    """Return what the bus may be understood by; raises as ``connect_bus``."""
    if options.protocol is not None and options.dbc is not None:
        raise UsageError("--protocol and --dbc contradict each other; give one of them")
    if options.mapping and options.dbc is None:
        raise UsageError("--map names signals of a DBC file; give the file with --dbc")
    from_file = options.protocol is not None or options.dbc is not None
    if options.protocol_text is not None and not from_file and options.driver is None:
        protocol = parse_protocol(options.protocol_text, options.settings, label="protocol of the session")
        return [describe_can(protocol=protocol)]
    if from_file or options.driver is not None:
        return [
            describe_can(
                # A file that is named goes before a driver, which may be a default.
                driver=None if from_file else options.driver,
                protocol=options.protocol,
                dbc=options.dbc,
                mapping=options.mapping,
                settings=options.settings,
            )
        ]
    return _all_drivers(options, say)


def _all_drivers(options: ConnectOptions, say: Say | None) -> list[CanDescription]:
    """Return every CAN instrument there is a driver for."""

    def describe(driver: type[Driver]) -> list[CanDescription]:
        known = driver.load_protocol().settings
        settings = {key: value for key, value in options.settings.items() if key in known}
        return [describe_can(driver=driver.name, settings=settings)]

    return usable("can", describe, say)


def _bit_rate(options: ConnectOptions, address: BusAddress, descriptions: list[CanDescription], say: Say) -> int | None:
    """Return the bit rate to set; None where the bus has its own."""
    if not address.takes_bit_rate:
        if options.baud not in (None, address.options.get("bitrate")):
            say(f"bit rate {options.baud} is not used: {options.bus} has one of its own")
        return None
    if options.baud is not None:
        return options.baud
    known = {one.bit_rate for one in descriptions}
    if len(known) == 1 and (rate := known.pop()) is not None:
        say(f"bit rate {rate} (assumed)")
        return rate
    raise UsageError(
        f"at which bit rate is {options.bus}? give it with --baud, e.g. --baud 250000 (J1939): trying disturbs a bus",
        bus=options.bus,
    )


def _listen(link: CanLink, ears: list[_Ear], clock: HostClock) -> list[Chunk]:
    """Read until one ear is certain, or the patience is over."""
    chunks: list[Chunk] = []
    end_s = clock.monotonic_s() + patience_s(clock, LISTEN_S)
    while clock.monotonic_s() < end_s and not any(ear.samples >= CERTAIN_SAMPLES for ear in ears):
        chunk = link.read()
        if chunk is None:
            continue
        chunks.append(chunk)
        for ear in ears:
            ear.decoder.feed(chunk.data, chunk.monotonic_s)
    if not any(ear.samples >= CERTAIN_SAMPLES for ear in ears):
        # A decoder holds samples back while stamps are too uneven to tell their rate: they are understood all the same.
        for ear in ears:
            ear.decoder.flush()
    return chunks


def _best(bus: str, ears: list[_Ear]) -> _Ear | None:
    """Return the ear that understood the most frames.

    Raises
    ------
    UsageError
        If several understood the same.
    """
    good = [ear for ear in ears if ear.samples >= FEWEST_SAMPLES]
    most = max((ear.frames for ear in good), default=0)
    best = [ear for ear in good if ear.frames == most]
    if len(best) > 1:
        names = "; ".join(f"{ear.description.name}, {_title(ear)}" for ear in best)
        raise UsageError(
            f"{bus} carries messages that several instruments send, with their axes in different order; say with --driver "
            f"which it is: {names}",
            bus=bus,
        )
    return best[0] if best else None


def _title(ear: _Ear) -> str:
    """Return which instrument it would be; instruments that send the same messages share a protocol."""
    return ear.description.protocol.title if ear.driver is None else ear.driver.title


def _connected(
    link: CanLink, chunks: list[Chunk], found: _Ear, options: ConnectOptions, *, clock: HostClock, say: Say
) -> Connected:
    protocol, identity = found.description.protocol, {}
    if found.driver is not None:
        messages = ask_identity(link, chunks, found.driver, found.decoder, clock=clock)
        identity = found.driver.identity(messages)
        protocol = with_settings(found.driver, protocol, messages)
    name = found.description.name
    if found.driver is not None and options.driver is None:
        say(f"driver {name} (recognised by {found.frames} frames with identifiers of {protocol.title})")
    for sentence in (*untried(found.driver), *assumed(protocol)):
        say(sentence)
    model = identity.pop("model", "") or name
    bit_rate = link.address.options.get("bitrate", link.bit_rate)
    return Connected(
        link=BackgroundLink(link),
        protocol=protocol,
        driver=name,
        model=model,
        baud=bit_rate,
        chunks=chunks,
        identity=identity,
        wire="can",
    )


def _nothing_understood(bus: str, chunks: Iterable[Chunk], ears: list[_Ear]) -> LinkError:
    frames = [frame for chunk in chunks for frame in unpack_frames(chunk.data)]
    identifiers = Counter(frame.text.partition("#")[0] for frame in frames if not frame.can_id & ERROR)
    names = ", ".join(ear.description.name for ear in ears)
    if not frames:
        return LinkTimeoutError(
            f"{bus} is silent: no frame within {LISTEN_S:g} s; check power, wiring, the two 120 ohm ends, the bit rate, and "
            "that the instrument is set to send by itself",
            Reason.SILENCE,
            bus=bus,
            waited_s=LISTEN_S,
        )
    if not identifiers:
        return LinkError(
            f"{bus} carries {len(frames)} error frames and nothing else: the bit rate is wrong or the wiring is bad; give the "
            "instrument's bit rate",
            Reason.NO_FRAMES,
            bus=bus,
            error_frames=len(frames),
        )
    known = max(ears, key=lambda ear: ear.frames)
    if known.frames >= len(frames) / 2:
        return LinkError(
            f"{bus} carries frames of {known.description.name}, but {known.frames} of them could be joined in time to "
            f"{known.samples} samples only, and {FEWEST_SAMPLES} are needed: check that the instrument sends all its messages, "
            "and play a recording at its own pace",
            Reason.NO_FRAMES,
            bus=bus,
            frames=len(frames),
        )
    heard = ", ".join(f"{text} x {count}" for text, count in identifiers.most_common(_IDENTIFIERS_NAMED))
    more = f" and {len(identifiers) - _IDENTIFIERS_NAMED} others" if len(identifiers) > _IDENTIFIERS_NAMED else ""
    return LinkError(
        f"{bus} carries frames, but not of {names}: the identifiers {heard}{more} made {max(ear.samples for ear in ears)} "
        f"samples and {FEWEST_SAMPLES} are needed; give the right --driver, or --dbc with --map",
        Reason.NO_FRAMES,
        bus=bus,
        frames=len(frames),
    )
