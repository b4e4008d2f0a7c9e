"""Open a port and make sure that an instrument sends there, before a session is begun.

What arrives while listening is kept and goes into the recording first, so nothing is lost to it. Where no port is given, the
only one is taken. Where the driver or the baud rate are not given, each is tried, and a callback is told what was assumed.
"""

from __future__ import annotations

from contextlib import suppress

from imufield.acquire.instrument.baud_search import (
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
from imufield.acquire.instrument.connected import (
    Connected,
    ConnectOptions,
    ask_identity,
    keep,
    read_identity,
    say_what_is_known,
    with_settings,
)
from imufield.acquire.instrument.instrument import Instrument
from imufield.acquire.instrument.recognise import Candidate, Listener
from imufield.acquire.link.background import BackgroundLink
from imufield.acquire.link.host_clock import HostClock, ScaledClock
from imufield.acquire.link.link_errors import check_port
from imufield.acquire.link.ports import serial_ports
from imufield.acquire.protocol.protocol import load_protocol, parse_protocol
from imufield.acquire.registry import driver_names, load_driver
from imufield.dataclass import replace
from imufield.errors import LinkError, Reason, UsageError
from imufield.sentences import Sentences

sentence = Sentences(__package__)

FALLBACK_BAUD = 115200
"""Where a protocol file is given without a baud rate: the usual setting of serial instruments."""
SPARE = 1.1
"""Bytes do not follow one another without a gap (the 1.1 of the STIM300 datasheet holds for the others as well)."""


def connect(options: ConnectOptions, clock: HostClock, say: Say) -> Connected:
    """Open the port and listen until an instrument is understood.

    Parameters
    ----------
    options : ConnectOptions
    clock : HostClock
    say : callable
        Told in sentences what was assumed.

    Raises
    ------
    LinkError
        Port or bus not found, busy, no permission; silence; bytes that nobody understands.
    UsageError
        Options contradict each other, or several ports are there and none is chosen.
    """
    is_virtual = isinstance(clock, ScaledClock)
    if options.bus is not None:
        from imufield.acquire.instrument.connect_can import connect_bus

        return replace(connect_bus(options, clock, say), is_virtual=is_virtual)
    _refuse_bus_options(options)
    port = options.port or _only_port(say)
    candidates = _candidates(options, say)
    bauds = bauds_to_try(candidates, port, options.baud)

    def announce() -> None:
        if len(bauds) > 1:
            say(sentence("connect.search", port=port, bauds=len(bauds), limit_s=SEARCH_S))

    is_given = any(way is not None for way in (options.driver, options.protocol, options.protocol_text))
    result = search(port, candidates, bauds, clock, is_given=is_given, opened=announce)
    instrument = None
    try:
        if result.recognised is None:
            instrument = _woken(result, clock, say)
        listener = result.recognised
        if listener is None:
            raise _not_understood(port, result, say)
        if instrument is None and listener.candidate.driver is not None:
            instrument = Instrument(listener.candidate.driver, clock)
        return replace(_introduced(result, listener, instrument, options, say=say), is_virtual=is_virtual)
    except BaseException:
        try:
            if instrument is not None and instrument.is_changed:
                with suppress(LinkError):
                    instrument.restore(result.link)
        finally:
            result.link.close()
        raise


def _not_understood(port: str, result: Search, say: Say) -> LinkError:
    """Tell the first lines of a text, and return the error."""
    error = nothing_recognised(port, result)
    for line in error.values.get("lines", ()):
        say(sentence("connect.line", line=line))
    return error


def _refuse_bus_options(options: ConnectOptions) -> None:
    if options.dbc is not None or options.mapping:
        raise UsageError(sentence("connect.dbc_without_bus"))
    if options.driver in driver_names() and load_driver(options.driver).wire == "can":
        raise UsageError(sentence("connect.driver_of_bus", driver=options.driver))


def _only_port(say: Say) -> str:
    """Return the one serial port of the machine; a UsageError where there is none, or more than one."""
    ports = [port.device for port in serial_ports()]
    if len(ports) == 1:
        say(sentence("connect.only_port", port=ports[0]))
        return ports[0]
    raise UsageError(sentence("connect.which_port" if ports else "connect.no_port", ports=ports), Reason.PORT_NOT_FOUND)


def check_options(options: ConnectOptions) -> None:
    """Refuse a protocol, a driver, a DBC file or a port that cannot be used, before anybody is asked anything.

    Raises as ``connect``, as far as nothing need be opened for it.
    """
    if options.bus is not None:
        from imufield.acquire.instrument.connect_can import bus_candidates

        bus_candidates(options)
        return
    _refuse_bus_options(options)
    # Without either, all drivers are tried; those that cannot be used are named then.
    if options.protocol is not None or options.driver is not None:
        _candidates(options)
    check_port(options.port or _only_port(lambda _: None))


def _candidates(options: ConnectOptions, say: Say | None = None) -> list[Candidate]:
    """Return the ways to read the port: the one that was given, else those of every driver."""
    # A protocol goes before a driver, which may be a default.
    if options.protocol is not None or options.protocol_text is not None:
        if options.protocol is not None:
            protocol = load_protocol(options.protocol, options.settings)
        else:
            label = "protocol of the session"
            protocol = parse_protocol(options.protocol_text or "", options.settings, read=options.settings_read, label=label)
        baud = options.baud or FALLBACK_BAUD
        return [Candidate(name=protocol.name, title=protocol.title, protocol=protocol, bauds=(baud,), driver=None)]
    if options.driver is None:
        return serial_candidates(options.settings, say=say)
    return list(driver_candidates(load_driver(options.driver), options.settings, read=options.settings_read))


def _woken(result: Search, clock: HostClock, say: Say) -> Instrument | None:
    """Tell a silent instrument to send, where the user said which it is, and listen again."""
    # With several candidates nobody knows which commands it understands.
    listeners = result.last.listeners
    driver = listeners[0].candidate.driver if len(listeners) == 1 else None
    if result.last.byte_count or driver is None or "start and stop" not in driver.abilities:
        return None
    instrument = Instrument(driver, clock)
    try:
        instrument.start(result.link)
    except LinkError:
        # It stays silent, and the caller reports that.
        return None
    say(sentence("connect.woken", title=driver.title))
    listen_again(result, clock)
    return instrument


def _introduced(
    result: Search, listener: Listener, instrument: Instrument | None, options: ConnectOptions, *, say: Say
) -> Connected:
    """Ask who it is, set what was asked for, and begin to read in the background."""
    (candidate, other_rate), chunks, port = listener.at_pace(), result.last.chunks, result.link.name
    # Where the baud rate means nothing to the port, the instrument's own is what a real port would need.
    baud = candidate.bauds[0] if options.baud is None and has_no_baud(port) else result.last.baud
    if candidate.driver is not None and options.driver is None:
        evidence = listener.finding().evidence()
        say(sentence("connect.recognised", driver=candidate.name, evidence=evidence, title=candidate.title))
    for taken in (*candidate.taken(), *filter(None, (other_rate,))):
        say(taken)
    # An address has no baud rate that anybody could set.
    if options.baud is None and "://" not in port:
        say(sentence("connect.baud", baud=baud))
    protocol, identity, rate_before_hz = candidate.protocol, {}, None
    if instrument is not None:
        # Which questions it understands may depend on what it sends.
        instrument.heard = set(listener.decoder.statistics.by_kind)
        messages = ask_identity(instrument, result.link, chunks, listener.messages())
        identity = read_identity(instrument.driver, messages)
        if options.rate_hz is not None:
            rate_before_hz = _set_rate(instrument, result, listener, options.rate_hz, say=say)
            messages += instrument.state
        protocol = with_settings(candidate.driver, protocol, messages, options.rate_hz)
    elif options.rate_hz is not None:
        raise UsageError(sentence("connect.rate_without_driver"))
    say_what_is_known(candidate.driver, protocol, identity, say)
    model = identity.pop("model", "") or candidate.name
    return Connected(
        link=BackgroundLink(result.link),
        protocol=protocol,
        driver=candidate.name,
        model=model,
        baud=baud,
        chunks=chunks,
        identity=identity,
        instrument=instrument,
        rate_hz=options.rate_hz,
        rate_before_hz=rate_before_hz,
        say=say,
    )


def _set_rate(instrument: Instrument, result: Search, listener: Listener, rate_hz: float, *, say: Say) -> float:
    """Set the output rate; return what it was."""
    # Addresses and pseudo-terminals carry any rate.
    if not has_no_baud(result.link.name):
        check_capacity(listener, rate_hz, result.last.baud)
    before_hz = instrument.set_rate(result.link, rate_hz)
    keep(instrument, result.last.chunks)
    is_tried = instrument.driver.abilities["rate"] == "verified on real bytes"
    say(sentence("connect.rate" if is_tried else "connect.rate_by_document", rate_hz=rate_hz, before_hz=before_hz))
    return before_hz


def check_capacity(listener: Listener, rate_hz: float, baud: int) -> None:
    """Refuse a rate that the wire cannot carry: ten bits for each byte, and a tenth to spare; raises UsageError."""
    counts = listener.decoder.statistics
    if counts.samples == 0:
        return
    highest_hz = baud / (10 * SPARE) / (counts.bytes_total / counts.samples)
    if rate_hz > highest_hz:
        raise UsageError(sentence("connect.capacity", rate_hz=rate_hz, baud=baud, highest_hz=highest_hz))
