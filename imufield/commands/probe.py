"""``imufield probe``: what is on a port, with the evidence, and the command line that reads it."""

from __future__ import annotations

import json
import shlex
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from functools import partial

from imufield.acquire.instrument.baud_search import (
    Search,
    bauds_to_try,
    has_no_baud,
    nothing_recognised,
    search,
    serial_candidates,
)
from imufield.acquire.instrument.connected import identity_text, read_identity
from imufield.acquire.instrument.instrument import Instrument
from imufield.acquire.instrument.recognise import Candidate, Finding, Listener
from imufield.acquire.link.host_clock import HostClock
from imufield.acquire.link.ports import serial_ports
from imufield.commands.options.acquire_commands import ProbeOptions
from imufield.commands.terminal.output import echo, host_clock, say
from imufield.dataclass import asdict, dataclass, field
from imufield.deliver.parameters.printed_numbers import beside
from imufield.errors import ImufieldError, LinkError, Reason
from imufield.sentences import Sentences, printable

sentence = Sentences(__package__)

PORTS_AT_ONCE = 8  # More threads than any machine has instruments; each only waits for bytes.
_OTHERS_NAMED = 3  # Behind these come chance finds of a few frames.
_SECOND_COLUMN = 14  # Width of "  instrument  ".


@dataclass(frozen=True, slots=True, kw_only=True)
class Probed:
    """What was found on one port.

    Attributes
    ----------
    port : str
    found : Finding or None
    baud : int or None
        Baud rate that was found; None where it means nothing to the port.
    command : str
        Command line that reads it.
    identity : dict
        What the instrument said of itself.
    others : list of Finding
        What else had frames in it.
    taken : list of str
        Settings that the bytes themselves show, or that were assumed, and why.
    error : ImufieldError or None
        Why nothing was found.
    """

    port: str
    found: Finding | None = None
    baud: int | None = None
    command: str = ""
    identity: dict[str, str] = field(default_factory=dict)
    others: list[Finding] = field(default_factory=list)
    taken: list[str] = field(default_factory=list)
    error: ImufieldError | None = None

    @property
    def lines(self) -> list[str]:
        """The first lines of a text that is not understood."""
        return [] if self.error is None else [printable(line) for line in self.error.values.get("lines", ())]

    def to_dict(self) -> dict[str, object]:
        """Return plain values."""
        return {
            "port": self.port,
            "found": None if self.found is None else self.found.to_dict(),
            "baud": self.baud,
            "command": self.command,
            "identity": self.identity,
            "others": [finding.to_dict() for finding in self.others],
            "taken": self.taken,
            "lines": self.lines,
            "error": None if self.error is None else {"reason": self.error.reason.value, "message": self.error.message},
        }


def run_probe(options: ProbeOptions) -> None:
    """Probe a bus, a port, or all ports of this machine at once, and print what was found.

    Raises
    ------
    LinkError
        There is no port, or nothing was recognised.
    UsageError
        The bit rate of a bus is needed, or several instruments send the same messages.
    """
    clock = host_clock(options.clock_speed)
    if options.connect.bus is not None:
        _probe_bus(options, options.connect.bus, clock)
    else:
        _probe_ports(options, clock)


def _probe_ports(options: ProbeOptions, clock: HostClock) -> None:
    baud, port = options.connect.baud, options.connect.port
    ports = [port.device for port in serial_ports()] if port is None else [port]
    if not ports:
        raise LinkError(sentence("probe.no_ports"), Reason.PORT_NOT_FOUND)
    announce = partial(_tell_begin, options, ports, limit_s=10)
    if port is None:
        # Ports that the system lists are there.
        announce()
    with ThreadPoolExecutor(min(len(ports), PORTS_AT_ONCE)) as pool:
        # Once for all ports: a driver that cannot be loaded is said once.
        candidates = serial_candidates(say=_tell)
        probe = partial(probe_port, baud=baud, clock=clock, ask=options.ask, candidates=candidates)
        results = list(pool.map(probe if port is None else partial(probe, opened=announce), ports))
    if options.as_json:
        echo(json.dumps({"ports": [probed.to_dict() for probed in results]}))
    else:
        for probed in results:
            _show(probed, alone=len(results) == 1)
    errors = [probed.error for probed in results if probed.error is not None]
    if len(errors) == len(results):
        if len(errors) == 1:
            raise errors[0]
        # Bytes that nobody understands are another case than silence: the instrument is there, and on.
        reason = Reason.SILENCE if {error.reason for error in errors} == {Reason.SILENCE} else Reason.NO_FRAMES
        raise LinkError(sentence("probe.nothing", ports=ports), reason)


def _probe_bus(options: ProbeOptions, bus: str, clock: HostClock) -> None:
    from imufield.acquire.instrument.connect_can import probe_bus

    baud = options.connect.baud
    found = probe_bus(options.connect, clock, _tell, ask=options.ask, opened=lambda: _tell_begin(options, [bus], limit_s=5))
    words = ["imufield", "capture", "--bus", bus, *([] if baud is None else ["--baud", str(baud)])]
    command = shlex.join([*words, "--driver", found.name])
    if options.as_json:
        echo(json.dumps({"buses": [{"bus": bus, "found": asdict(found), "command": command}]}))
        return
    say(f"{bus}: {found.title}", indent=2)
    say(f"  evidence    {found.frames} frames with its identifiers, {found.samples} samples", indent=_SECOND_COLUMN)
    _show_rest(found.identity, command)


def _tell_begin(options: ProbeOptions, places: list[str], limit_s: int) -> None:
    if not options.as_json:
        _tell(sentence("probe.asking" if options.ask else "probe.listening", places=places, limit_s=limit_s))


def _tell(line: str) -> None:
    say(line, err=True)


def probe_port(
    port: str,
    baud: int | None,
    clock: HostClock,
    *,
    ask: bool = False,
    candidates: list[Candidate] | None = None,
    opened: Callable[[], None] = lambda: None,
) -> Probed:
    """Listen on one port, and (``ask``) let the instrument say who it is; errors of the port are part of the result.

    ``opened`` is called when the port is open.
    """
    candidates = candidates or serial_candidates()
    bauds = bauds_to_try(candidates, port, baud)
    try:
        result = search(port, candidates, bauds, clock, opened=opened)
    except ImufieldError as error:
        return Probed(port=port, error=error)
    with closing(result.link):
        others, listener = _others(result), result.recognised
        if listener is None:
            return Probed(port=port, others=others, error=nothing_recognised(port, result))
        # A rate of 9600 in the command for a USB port would look as if it mattered.
        rate = None if has_no_baud(port) and baud is None else result.last.baud
        command, identity = _command(port, listener, rate), _identity(result, listener, clock, ask=ask)
        return Probed(
            port=port,
            found=listener.finding(),
            baud=rate,
            command=command,
            identity=identity,
            others=others,
            taken=listener.candidate.taken(),
        )


def _identity(result: Search, listener: Listener, clock: HostClock, *, ask: bool) -> dict[str, str]:
    """Return what the instrument said of itself without being asked, or (``ask``) when asked."""
    driver = listener.candidate.driver
    if driver is None:
        return {}
    identity = read_identity(driver, listener.messages())
    if identity or not ask or "identify" not in driver.abilities:
        return identity
    try:
        instrument = Instrument(driver, clock, set(listener.decoder.statistics.by_kind))
        return read_identity(driver, instrument.identify(result.link))
    except LinkError:
        # No answer takes nothing from what was recognised.
        return {}


def _others(result: Search) -> list[Finding]:
    # Another form of the instrument that was found is the same instrument.
    name = None if result.recognised is None else result.recognised.candidate.name
    listeners = [each for hearing in result.hearings for each in hearing.listeners if each.candidate.name != name]
    findings = sorted((each.finding() for each in listeners), key=lambda finding: (finding.frames, finding.share), reverse=True)
    return [finding for finding in findings if finding.frames][:_OTHERS_NAMED]


def _command(port: str, listener: Listener, baud: int | None) -> str:
    words = ["imufield", "capture", "--port", port, "--driver", listener.candidate.name]
    words += [] if baud is None else ["--baud", str(baud)]
    for name, value in listener.candidate.variant.items():
        words += ["--set", f"{name}={value}"]
    return shlex.join(words)


def _show(probed: Probed, *, alone: bool) -> None:
    if probed.found is not None:
        say(f"{probed.port}: {probed.found.title}", indent=2)
        say(f"  evidence    {probed.found.evidence()}", indent=_SECOND_COLUMN)
        if probed.baud is not None:
            echo(f"  baud rate   {probed.baud}")
        for taken in probed.taken:
            say(f"  taken       {taken}", indent=_SECOND_COLUMN)
        _show_rest(probed.identity, probed.command)
    elif not alone and probed.error is not None:
        # Of one port alone the command ends with this sentence.
        say(f"nothing recognised: {probed.error.message}", indent=2)
    for line in probed.lines:
        say(f"  first lines {line}", indent=_SECOND_COLUMN)
    for other in probed.others:
        say(
            f"  not         {other.name}: {other.reason or 'less of it was understood'} ({other.frames} frames)",
            indent=_SECOND_COLUMN,
        )


def _show_rest(identity: dict[str, str], command: str) -> None:
    if identity:
        say(f"  instrument  {identity_text(identity)}", indent=_SECOND_COLUMN)
    # The word in capitals is for the reader to fill in; programs are given the command without it.
    echo(beside("  command    ", f"{command} --latitude DEGREES"))
