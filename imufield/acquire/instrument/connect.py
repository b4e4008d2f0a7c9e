"""Open a port and make sure that an instrument speaks there, before a session is begun.

What is heard while listening is kept and goes into the recording first, so nothing is lost to it. Where the driver or the
baud rate are not given, each is tried, and what was assumed is said.
"""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from imufield.acquire.decoder import Decoder
from imufield.acquire.driver import Driver, Wire
from imufield.acquire.instrument.exchange import Message
from imufield.acquire.instrument.instrument import Instrument
from imufield.acquire.instrument.listen import (
    SEARCH_S,
    Say,
    Search,
    bauds_to_try,
    driver_candidates,
    has_no_baud,
    listen_again,
    nothing_recognised,
    search,
    serial_candidates,
)
from imufield.acquire.instrument.recognise import Candidate, Ear
from imufield.acquire.link.background import BackgroundLink, ReopenableLink
from imufield.acquire.link.host_clock import HostClock, ScaledClock, SystemClock
from imufield.acquire.link.ports import serial_ports
from imufield.acquire.link.serial import Chunk
from imufield.acquire.protocol.protocol import Protocol, load_protocol, parse_protocol
from imufield.acquire.registry import driver_names, load_driver
from imufield.commands.terminal.output import say as tell
from imufield.errors import LinkError, Reason, UsageError

FALLBACK_BAUD = 115200
"""Where a protocol file is given without a baud rate: the usual setting of serial instruments."""
SPARE = 1.1
"""Bytes do not follow one another without a gap (the 1.1 of the STIM300 datasheet holds for the others as well)."""


@dataclass(frozen=True, slots=True, kw_only=True)
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
    rate_hz: float | None = None
    """Output rate to set; None leaves it."""


@dataclass(frozen=True, slots=True, kw_only=True)
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
    instrument: Instrument | None = None
    """Takes commands; None on a bus and without a driver."""
    rate_hz: float | None = None
    """Output rate that was asked for."""
    rate_before_hz: float | None = None
    """What it was before."""

    def close(self) -> None:
        """Leave the instrument as it was found, and give the link back."""
        try:
            if self.instrument is not None and self.instrument.is_changed:
                self.link.drain()
                self.instrument.restore(self.link)
        except LinkError as error:
            tell(f"the instrument was not put back as it was: {error.message}; switching it off and on does it", err=True)
        finally:
            self.link.close()

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
        rates = {"rate_hz": self.rate_hz, "rate_before_hz": self.rate_before_hz}
        return {
            "port": self.link.name,
            "baud": self.baud,
            **{name: value for name, value in rates.items() if value is not None},
        }


def host_clock(speed: float) -> HostClock:
    """Return the clock to read an instrument with that runs ``speed`` times faster than real time, as emulated ones may."""
    if speed == 1.0:
        return SystemClock()
    tell(f"the clock of the host runs {speed:g} times fast: only an emulated instrument can be read like this", err=True)
    return ScaledClock(speed)


def parse_mapping(texts: list[str] | None) -> dict[str, str]:
    """Split options of the form ``accelerometer.x=SIGNAL``; raises UsageError as ``parse_map``."""
    if not texts:
        return {}
    from imufield.acquire.instrument.can_map import parse_map

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
    say = say or (lambda sentence: tell(sentence, err=True, indent=2))
    if options.bus is not None:
        from imufield.acquire.instrument.connect_can import connect_bus

        if options.rate_hz is not None:
            raise UsageError("--rate-hz is for instruments on a serial port; leave it out on a CAN bus")
        return connect_bus(options, clock, say)
    _refuse_can_options(options)
    port = options.port or _only_port(say)
    candidates = _candidates(options, say)
    bauds = bauds_to_try(candidates, port, options.baud)
    if len(bauds) > 1:
        say(f"listening on {port} at {len(bauds)} baud rates, up to {SEARCH_S:g} s in all (--baud and --driver are quicker)")
    is_given = any(one is not None for one in (options.driver, options.protocol, options.protocol_text))
    found = search(port, candidates, bauds, clock, is_given=is_given)
    try:
        return _connected(found, options, clock, say)
    except BaseException:
        found.link.close()
        raise


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


def check_files(options: ConnectOptions) -> None:
    """Refuse a protocol, a driver or a DBC file that cannot be used, before anybody is asked anything; raises as they do."""
    if options.bus is not None:
        from imufield.acquire.instrument.connect_can import can_descriptions

        can_descriptions(options)
    elif options.protocol is not None or options.driver is not None:
        _candidates(options)


def _candidates(options: ConnectOptions, say: Say | None = None) -> list[Candidate]:
    if options.protocol is not None or options.protocol_text is not None:
        if options.protocol is not None:
            protocol = load_protocol(options.protocol, options.settings)
        else:
            protocol = parse_protocol(options.protocol_text or "", options.settings, label="protocol of the session")
        baud = options.baud or FALLBACK_BAUD
        return [Candidate(name=protocol.name, title=protocol.title, protocol=protocol, bauds=(baud,), driver=None)]
    if options.driver is None:
        return serial_candidates(options.settings, say=say)
    names = driver_names()
    if options.driver not in names:
        raise UsageError(f"there is no driver {options.driver!r}; choose one of {', '.join(names)}", Reason.UNKNOWN_DRIVER)
    return list(driver_candidates(load_driver(options.driver), options.settings))


def ask_identity(
    link: ReopenableLink, chunks: list[Chunk], driver: type[Driver], decoder: Decoder, *, clock: HostClock
) -> list[Message]:
    """Return the instrument's messages: those heard, or the answers to commands that change nothing in it."""
    instrument = Instrument(driver, clock, set(decoder.statistics.by_kind))
    return _ask(instrument, link, chunks, decoder.messages())


def _ask(instrument: Instrument, link: ReopenableLink, chunks: list[Chunk], heard: list[Message]) -> list[Message]:
    if instrument.driver.read_settings(heard) or instrument.driver.identity(heard):
        return heard
    answers = instrument.identify(link)
    keep(instrument, chunks)
    return [*heard, *answers]


def keep(instrument: Instrument, chunks: list[Chunk]) -> None:
    """Add what arrived during a command; where that interrupted the stream, what came before is no part of it any more."""
    if instrument.interrupted:
        chunks.clear()
    else:
        chunks += instrument.chunks


def _connected(found: Search, options: ConnectOptions, clock: HostClock, say: Say) -> Connected:
    instrument = _woken(found, clock, say) if found.found is None else None
    ear = found.found
    if instrument is None and ear is not None and ear.candidate.driver is not None:
        instrument = Instrument(ear.candidate.driver, clock)
    try:
        if ear is None:
            raise nothing_recognised(found.link.name, found)
        return _introduced(found, ear, instrument, options, say=say)
    except BaseException:
        if instrument is not None and instrument.is_changed:
            with suppress(LinkError):
                instrument.restore(found.link)
        raise


def _introduced(found: Search, ear: Ear, instrument: Instrument | None, options: ConnectOptions, *, say: Say) -> Connected:
    """Ask who it is, set what was asked for, and begin to read in the background."""
    candidate, chunks, identity = ear.candidate, found.last.chunks, {}
    protocol = candidate.protocol
    _say_found(found, ear, options, say)
    rate_before_hz = None
    if instrument is not None:
        instrument.heard = set(ear.decoder.statistics.by_kind)
        messages = _ask(instrument, found.link, chunks, ear.messages())
        identity = instrument.driver.identity(messages)
        if options.rate_hz is not None:
            rate_before_hz = _set_rate(instrument, found, options.rate_hz, say)
            messages += instrument.state
        protocol = with_settings(candidate.driver, protocol, messages, options.rate_hz)
    elif options.rate_hz is not None:
        raise UsageError("--rate-hz needs an instrument with a driver, a protocol file says nothing of commands; leave it out")
    for sentence in untried(candidate.driver):
        say(sentence)
    if identity:
        say("instrument: " + ", ".join(f"{name.replace('_', ' ')} {value}" for name, value in identity.items()))
    for sentence in assumed(protocol):
        say(sentence)
    model = identity.pop("model", "") or candidate.name
    baud = _baud_of(found, ear, options)
    link = BackgroundLink(found.link)
    return Connected(
        link=link,
        protocol=protocol,
        driver=candidate.name,
        model=model,
        baud=baud,
        chunks=chunks,
        identity=identity,
        wire="serial",
        instrument=instrument,
        rate_hz=options.rate_hz,
        rate_before_hz=rate_before_hz,
    )


def _woken(found: Search, clock: HostClock, say: Say) -> Instrument | None:
    """Tell a silent instrument to send, where the user said which it is; ``found`` has what is heard then."""
    ears = found.last.ears
    driver = ears[0].candidate.driver if len(ears) == 1 else None
    if found.last.byte_count or driver is None or "start and stop" not in driver.abilities:
        return None
    instrument = Instrument(driver, clock)
    try:
        instrument.start(found.link)
    except LinkError:
        return None
    say(f"{driver.title} was silent and was told to send; it is silenced again at the end")
    listen_again(found, clock)
    return instrument


def with_settings(
    driver: type[Driver] | None, protocol: Protocol, messages: list[Message], rate_hz: float | None = None
) -> Protocol:
    """Return the protocol with what the instrument told of its settings, and the rate that was set where it must be said."""
    by_increment = protocol.units.accelerometer_is_increment or protocol.units.gyroscope_is_increment
    said = {} if rate_hz is None or not by_increment else {"rate_hz": rate_hz}
    if driver is None or not (said or driver.read_settings(messages)):
        return protocol
    given = {name: one.value for name, one in protocol.settings.items() if one.origin == "given"} | said
    return driver.load_protocol(given, messages=messages)


def _set_rate(instrument: Instrument, found: Search, rate_hz: float, say: Say) -> float:
    """Set the output rate; return what it was."""
    if found.found is not None and not has_no_baud(found.link.name):
        check_capacity(found.found, rate_hz, found.last.baud)
    before_hz = instrument.set_rate(found.link, rate_hz)
    keep(instrument, found.last.chunks)
    tried = "" if instrument.driver.abilities["rate"] == "verified on real bytes" else "; experimental, from documents alone"
    say(f"output rate {rate_hz:g} Hz (was {before_hz:g} Hz, which is put back at the end{tried})")
    return before_hz


def check_capacity(ear: Ear, rate_hz: float, baud: int) -> None:
    """Refuse a rate that the wire cannot carry: ten bits for each byte, and a tenth to spare.

    Raises
    ------
    UsageError
        If it cannot.
    """
    counts = ear.decoder.statistics
    if counts.samples == 0:
        return
    highest_hz = baud / (10 * SPARE) / (counts.bytes_total / counts.samples)
    if rate_hz > highest_hz:
        raise UsageError(
            f"{rate_hz:g} Hz do not fit on a wire of {baud} bit/s, which carries {highest_hz:.0f} such samples a second; "
            "give a lower --rate-hz, or set a higher baud rate with the maker's program",
            rate_hz=rate_hz,
            highest_hz=highest_hz,
        )


def _baud_of(found: Search, ear: Ear, options: ConnectOptions) -> int:
    """Return the baud rate; where it means nothing, the instrument's own is what a real port would need."""
    assumed_it = options.baud is None and has_no_baud(found.link.name)
    return ear.candidate.bauds[0] if assumed_it else found.last.baud


def _say_found(found: Search, ear: Ear, options: ConnectOptions, say: Say) -> None:
    if ear.candidate.driver is not None and options.driver is None:
        say(f"driver {ear.candidate.name} (recognised: {ear.finding().evidence()} of {ear.candidate.title})")
        for name, value in ear.candidate.variant.items():
            say(f"{name} = {value} (recognised)")
    if options.baud is None and "://" not in found.link.name:
        say(f"baud rate {_baud_of(found, ear, options)} (assumed)")


def untried(driver: type[Driver] | None) -> list[str]:
    """Return a sentence where the format of an instrument was never tried on bytes of a real one."""
    if driver is None or driver.status == "verified on real bytes":
        return []
    return [f"experimental: {driver.title} was written from documents and never tried on a real one; check scale and axes"]


def assumed(protocol: Protocol) -> list[str]:
    """Return a sentence for each setting that was assumed and changes every number."""
    return [
        f"{name} = {one.value} (assumed: the wire does not tell; change with --set {name}=...)"
        for name, one in protocol.settings.items()
        if one.origin == "assumed" and name in _WORTH_SAYING
    ]


# Settings that change every number, so that an assumed value must be seen.
_WORTH_SAYING = ("accelerometer_range_g", "columns", "accelerometer_unit", "gyroscope_unit")
