"""Open a port and make sure that an instrument speaks there, before a session is begun.

What is heard while listening is kept and goes into the recording first, so nothing is lost to it. Where the driver or the
bit rate are not given, each is tried, and what was assumed is said.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import typer

from imufield.acquire.background_link import BackgroundLink, ReopenableLink
from imufield.acquire.decoder import Decoder
from imufield.acquire.driver import Driver, Wire
from imufield.acquire.host_clock import HostClock, ScaledClock, SystemClock
from imufield.acquire.link import Chunk, open_link
from imufield.acquire.ports import serial_ports
from imufield.acquire.protocol import Protocol, load_protocol, parse_protocol
from imufield.acquire.registry import driver_names, load_driver
from imufield.acquire.statistics import DecoderStatistics
from imufield.errors import LinkError, LinkTimeoutError, Reason, UsageError

LISTEN_S = 5.0
"""Longest silence or noise before giving up where driver and bit rate are given: instruments start within 1 s to 5 s."""
TRY_S = 1.2
"""Listening to each bit rate where it is not given: more than ten frames of a 10 Hz instrument."""
CERTAIN_SAMPLES = 20
"""Samples with good checksums that end the listening; 20 false ones of a 16-bit checksum would take 10^96 tries."""
FEWEST_SAMPLES = 5
TEXT_SHARE = 0.5
"""Share of the bytes that must belong to good frames, so that noise does not pass for a format without checksum."""
ANSWER_S = 0.5
"""Wait for the answer to a question about identity; an instrument that takes none stays unasked and says nothing."""
FALLBACK_BAUD = 115200
"""Where a protocol file is given without a bit rate: the usual setting of serial instruments."""

Say = Callable[[str], None]


@dataclass(frozen=True, slots=True)
class ConnectOptions:
    """Options of the commands that open a port."""

    port: str | None = None
    driver: str | None = None
    baud: int | None = None
    protocol: Path | None = None
    settings: Mapping[str, str] = field(default_factory=dict)
    protocol_text: str | None = None
    """A protocol that a session holds, where neither driver nor file is given."""
    bus: str | None = None
    """A CAN bus instead of a port, ``INTERFACE:CHANNEL``; ``baud`` is its bit rate then."""
    dbc: Path | None = None
    mapping: Mapping[str, str] = field(default_factory=dict)
    """Which signal of ``dbc`` is which axis, as ``parse_map`` returns it."""


@dataclass(frozen=True, slots=True)
class Connected:
    """An open link with an instrument that was understood; it is read in the background from now on."""

    link: BackgroundLink
    protocol: Protocol
    driver: str
    model: str
    baud: int | None
    """Bit rate; None on a bus where it is set elsewhere."""
    chunks: list[Chunk]
    """What arrived while listening; the first of the recording."""
    identity: dict[str, str]
    wire: Wire = "serial"

    def session_tables(self) -> dict[str, Any]:
        """Return the tables of ``session.toml`` that describe instrument, link and protocol."""
        protocol, units, nominal = self.protocol, self.protocol.units, self.protocol.nominal
        return {
            "instrument": {"driver": self.driver, "model": self.model, **self.identity},
            "link": self._link_table(),
            "protocol": {"name": protocol.name, "sha256": protocol.sha256, "text": protocol.text},
            "settings": {name: {"value": one.value, "origin": one.origin} for name, one in protocol.settings.items()},
            "units": {
                "accelerometer": units.accelerometer,
                "gyroscope": units.gyroscope,
                "accelerometer_is_increment": units.accelerometer_is_increment,
                "gyroscope_is_increment": units.gyroscope_is_increment,
                "interval_s": units.interval_s,
            },
            "nominal": {"raw_zero": nominal.raw_zero, "rate_hz": nominal.rate_hz},
        }

    def _link_table(self) -> dict[str, Any]:
        if self.wire == "can":
            bit_rate = {} if self.baud is None else {"bit_rate": self.baud}
            return {"bus": self.link.name, **bit_rate}
        return {"port": self.link.name, "baud": self.baud}


@dataclass(frozen=True, slots=True)
class _Candidate:
    """A way to read the wire: a driver, or the user's protocol."""

    name: str
    title: str
    protocol: Protocol
    bauds: tuple[int, ...]
    driver: type[Driver] | None


@dataclass(slots=True)
class _Hearing:
    """What one listening gave: chunks, and a decoder for each candidate."""

    link: ReopenableLink
    baud: int
    chunks: list[Chunk]
    decoders: list[tuple[_Candidate, Decoder]]

    @property
    def byte_count(self) -> int:
        return sum(len(chunk.data) for chunk in self.chunks)

    def best(self) -> tuple[_Candidate, Decoder] | None:
        """Return the candidate that understood the most bytes, if any understood enough."""
        good = [(found, decoder) for found, decoder in self.decoders if _is_understood(decoder.statistics)]
        return max(good, key=lambda one: -one[1].statistics.bytes_skipped, default=None)


def host_clock(speed: float) -> HostClock:
    """Return the clock to read an instrument with that runs ``speed`` times faster than real time, as emulated ones may."""
    if speed == 1.0:
        return SystemClock()
    typer.echo(f"the clock of the host runs {speed:g} times fast: only an emulated instrument can be read like this", err=True)
    return ScaledClock(speed)


def parse_mapping(texts: list[str] | None) -> dict[str, str]:
    """Split options of the form ``accelerometer.x=SIGNAL``; raises UsageError as ``parse_map``."""
    if not texts:
        return {}
    from imufield.acquire.can_map import parse_map

    return parse_map(texts)


def connect(options: ConnectOptions, clock: HostClock, *, say: Say | None = None) -> Connected:
    """Open the port and listen until an instrument is understood.

    Parameters
    ----------
    options : ConnectOptions
    clock : HostClock
    say : callable, optional
        Told what was assumed; by default it is printed to standard error.

    Raises
    ------
    LinkError
        Port or bus not found, busy, no permission; silence; bytes that nobody understands.
    """
    say = say or (lambda sentence: typer.echo(sentence, err=True))
    if options.bus is not None:
        from imufield.commands.connect_can import connect_bus

        return connect_bus(options, clock, say)
    _refuse_can_options(options)
    port = options.port or _only_port(say)
    candidates = _candidates(options)
    bauds = _bauds(options, candidates, port)
    patience_s = LISTEN_S if len(bauds) == 1 else TRY_S
    if len(bauds) > 1:
        say(f"listening on {port} at {len(bauds)} bit rates, up to {patience_s:g} s each (--baud is quicker)")
    heard: list[_Hearing] = []
    for baud in bauds:
        hearing = _listen(port, baud, [one for one in candidates if baud in one.bauds or len(bauds) == 1], clock, patience_s)
        found = hearing.best()
        if found is not None:
            return _connected(hearing, *found, options, clock, say)
        hearing.link.close()
        heard.append(hearing)
    raise _nothing_understood(port, heard, candidates, patience_s)


def _refuse_can_options(options: ConnectOptions) -> None:
    """Refuse what needs a bus where none is given.

    Raises
    ------
    UsageError
        ``--dbc``, ``--map`` or a driver of a CAN instrument.
    """
    if options.dbc is not None or options.mapping:
        raise UsageError("--dbc and --map are for a CAN bus; name it with --bus, e.g. --bus socketcan:can0")
    if options.driver in driver_names() and load_driver(options.driver).wire == "can":
        raise UsageError(f"{options.driver} is on a CAN bus; name it with --bus, e.g. --bus socketcan:can0")


def _only_port(say: Say) -> str:
    """Return the one serial port of the machine.

    Raises
    ------
    UsageError
        If there is none, or more than one.
    """
    ports = [one.device for one in serial_ports()]
    if len(ports) == 1:
        say(f"port {ports[0]} (assumed: it is the only one)")
        return ports[0]
    found = ", ".join(ports) if ports else "none was found"
    raise UsageError(f"which port? give it with --port; serial ports of this machine: {found}", Reason.PORT_NOT_FOUND)


def _candidates(options: ConnectOptions) -> list[_Candidate]:
    if options.protocol is not None or options.protocol_text is not None:
        if options.protocol is not None:
            protocol = load_protocol(options.protocol, options.settings)
        else:
            protocol = parse_protocol(options.protocol_text or "", options.settings, label="protocol of the session")
        baud = options.baud or FALLBACK_BAUD
        return [_Candidate(protocol.name, protocol.title, protocol, (baud,), None)]
    names = driver_names()
    if options.driver is not None:
        if options.driver not in names:
            raise UsageError(f"there is no driver {options.driver!r}; choose one of {', '.join(names)}", Reason.UNKNOWN_DRIVER)
        names = [options.driver]
    candidates = []
    for name in names:
        driver = load_driver(name)
        if driver.wire != "serial":
            continue
        known = load_protocol(driver.protocol).settings
        given = options.settings if options.driver else {key: value for key, value in options.settings.items() if key in known}
        candidates.append(_Candidate(name, driver.title, driver.load_protocol(given), driver.bauds, driver))
    return candidates


def _bauds(options: ConnectOptions, candidates: list[_Candidate], port: str) -> list[int]:
    """Return the bit rates to try: one where it is given or means nothing, else those of the candidates, likeliest first."""
    if options.baud is not None:
        return [options.baud]
    if _has_no_baud(port):
        return [candidates[0].bauds[0]]
    longest = max(len(one.bauds) for one in candidates)
    in_order = [one.bauds[rank] for rank in range(longest) for one in candidates if rank < len(one.bauds)]
    return list(dict.fromkeys(in_order))


def _has_no_baud(port: str) -> bool:
    """Return whether the bit rate means nothing to a port: addresses and pseudo-terminals take any."""
    return "://" in port or _is_pseudo_terminal(port)


def _is_pseudo_terminal(port: str) -> bool:
    return str(Path(port).resolve()).startswith("/dev/pts/")


def _listen(port: str, baud: int, candidates: list[_Candidate], clock: HostClock, patience_s: float) -> _Hearing:
    """Read until one candidate is certain, or the patience is over."""
    link = open_link(port, baud=baud, clock=clock)
    hearing = _Hearing(link, baud, [], [(one, Decoder(one.protocol)) for one in candidates])
    end_s = clock.monotonic_s() + patience_s
    try:
        while clock.monotonic_s() < end_s:
            chunk = link.read()
            if chunk is None:
                continue
            hearing.chunks.append(chunk)
            for _, decoder in hearing.decoders:
                decoder.feed(chunk.data, chunk.monotonic_s)
            if any(_is_certain(decoder.statistics) for _, decoder in hearing.decoders):
                break
    except BaseException:
        link.close()
        raise
    return hearing


def _is_understood(statistics: DecoderStatistics) -> bool:
    enough = statistics.samples >= FEWEST_SAMPLES
    return enough and statistics.bytes_skipped <= (1 - TEXT_SHARE) * statistics.bytes_total


def _is_certain(statistics: DecoderStatistics) -> bool:
    return statistics.samples >= CERTAIN_SAMPLES and _is_understood(statistics)


def ask_identity(
    link: ReopenableLink, chunks: list[Chunk], driver: type[Driver], decoder: Decoder, clock: HostClock
) -> list[dict[str, Any]]:
    """Return the instrument's messages: those heard, or the answers to commands that change nothing in it."""
    messages = decoder.messages()
    if driver.read_settings(messages) or driver.identity(messages):
        return messages
    for command in driver.identity_commands:
        link.write(command)
        end_s = clock.monotonic_s() + ANSWER_S
        before = len(messages)
        while clock.monotonic_s() < end_s and len(messages) == before:
            chunk = link.read()
            if chunk is not None:
                chunks.append(chunk)
                decoder.feed(chunk.data, chunk.monotonic_s)
                messages += decoder.messages()
    return messages


def _connected(
    hearing: _Hearing, found: _Candidate, decoder: Decoder, options: ConnectOptions, clock: HostClock, say: Say
) -> Connected:
    identity: dict[str, str] = {}
    protocol = found.protocol
    if found.driver is not None:
        messages = ask_identity(hearing.link, hearing.chunks, found.driver, decoder, clock)
        identity = found.driver.identity(messages)
        if found.driver.read_settings(messages):
            given = {name: one.value for name, one in protocol.settings.items() if one.origin == "given"}
            protocol = found.driver.load_protocol(given, messages=messages)
    model = identity.pop("model", "") or found.name
    # Where the rate means nothing, the instrument's own is what a real port would need.
    baud = found.bauds[0] if options.baud is None and _has_no_baud(hearing.link.name) else hearing.baud
    if found.driver is not None and options.driver is None:
        say(f"driver {found.name} (recognised: {decoder.statistics.frames} good frames of {found.title})")
    if options.baud is None and "://" not in hearing.link.name:
        say(f"bit rate {baud} (assumed)")
    for sentence in assumed(protocol):
        say(sentence)
    return Connected(BackgroundLink(hearing.link), protocol, found.name, model, baud, hearing.chunks, identity)


def assumed(protocol: Protocol) -> list[str]:
    """Return a sentence for each setting that was assumed and changes every number."""
    return [
        f"{name} = {one.value} (assumed: the wire does not tell; change with --set {name}=...)"
        for name, one in protocol.settings.items()
        if one.origin == "assumed" and name in _WORTH_SAYING
    ]


_WORTH_SAYING = ("accelerometer_range_g", "columns", "accelerometer_unit", "gyroscope_unit")
"""Settings that change every number, so that an assumed value must be seen."""


def _nothing_understood(port: str, heard: list[_Hearing], candidates: list[_Candidate], patience_s: float) -> LinkError:
    bauds = ", ".join(str(hearing.baud) for hearing in heard)
    total = sum(hearing.byte_count for hearing in heard)
    names = ", ".join(one.name for one in candidates)
    if total == 0:
        return LinkTimeoutError(
            f"{port} is silent: no byte within {patience_s:g} s at {bauds} bit/s; check power, cable, RX/TX and that the "
            "instrument is set to send by itself",
            Reason.SILENCE,
            port=port,
            waited_s=patience_s,
        )
    good = max(decoder.statistics.samples for hearing in heard for _, decoder in hearing.decoders)
    return LinkError(
        f"{port} sends, but not {names}: {total} bytes at {bauds} bit/s made {good} samples and {FEWEST_SAMPLES} are "
        "needed; give the right --baud or --driver, or describe the format with --protocol",
        Reason.NO_FRAMES,
        port=port,
        bytes=total,
        samples=good,
    )
