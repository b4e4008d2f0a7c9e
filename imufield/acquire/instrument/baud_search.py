"""Listen on a serial port at one baud rate after another, until an instrument is recognised or the time is over.

The rates are ``bauds`` of each driver; ``connect`` chooses the port, and asks here where no rate is given.
"""

from __future__ import annotations

import shlex
from collections.abc import Callable, Iterable, Iterator, Mapping
from itertools import chain, zip_longest

from imufield.acquire.driver import Driver, Wire
from imufield.acquire.instrument.recognise import FEWEST_SAMPLES, Candidate, Listener, best
from imufield.acquire.instrument.text_columns import (
    LineListener,
    are_labelled,
    first_lines,
    other_lines,
    read_lines,
    usual_columns,
)
from imufield.acquire.link.chunk import Chunk
from imufield.acquire.link.host_clock import HostClock, patience_s
from imufield.acquire.link.serial import PSEUDO_TERMINALS, SerialLink, open_link
from imufield.acquire.protocol.protocol import load_protocol
from imufield.acquire.registry import driver_names, load_driver
from imufield.dataclass import dataclass
from imufield.errors import LinkError, LinkTimeoutError, ProtocolError, Reason, SettingError
from imufield.files import real_path
from imufield.sentences import Sentences

sentence = Sentences(__package__)

Say = Callable[[str], None]

LISTEN_S = 5.0
"""Longest silence or noise before giving up at the one baud rate that is possible: instruments start within 1 s to 5 s."""
SEARCH_S = 10.0
"""All baud rates together."""
TRY_S = 0.5
"""Each baud rate that gives nothing: ten frames of a 20 Hz instrument."""
PROMISING_S = 2.5
"""A baud rate at which frames are heard: twenty samples of a 10 Hz instrument."""
SILENT_S = 2.0
"""The first baud rate without a byte: at a wrong baud rate an instrument is heard, too, as noise."""
SILENT_TRY_S = 0.2
"""Each further baud rate of a port that was silent at the first."""


@dataclass(slots=True)
class Hearing:
    """What was heard at one baud rate."""

    baud: int
    chunks: list[Chunk]
    listeners: list[Listener]

    @property
    def data(self) -> bytes:
        """All of it."""
        return b"".join(chunk.data for chunk in self.chunks)

    @property
    def byte_count(self) -> int:
        """Bytes that arrived."""
        return sum(len(chunk.data) for chunk in self.chunks)


@dataclass(slots=True)
class Search:
    """What was heard on one port; the link is open and at the baud rate of the last hearing."""

    link: SerialLink
    hearings: list[Hearing]
    recognised: Listener | None = None

    @property
    def last(self) -> Hearing:
        """The hearing in which something was found, or the last of all."""
        return self.hearings[-1]


def serial_candidates(settings: Mapping[str, str] | None = None, *, say: Say | None = None) -> list[Candidate]:
    """Return every way to read a serial port that the drivers know; ``settings`` go to those that have them."""
    return usable("serial", lambda driver: driver_candidates(driver, settings or {}, only_known=True, variants=True), say)


def usable(wire: Wire, ways: Callable[[type[Driver]], Iterable[Candidate]], say: Say | None = None) -> list[Candidate]:
    """Return the ways to read a wire by every driver; ``say`` is told in a sentence of each that cannot be used."""
    found: list[Candidate] = []
    for name in driver_names():
        try:
            driver = load_driver(name)
            found += ways(driver) if driver.wire == wire else ()
        except SettingError:
            # The user typed a value that no driver takes: an error, and no driver is passed over for it.
            raise
        except ProtocolError as error:
            # A broken driver of another distribution must not keep the others from working.
            if say is not None:
                say(sentence("baud_search.passed_over", error=error.message))
    return found


def driver_candidates(
    driver: type[Driver],
    settings: Mapping[str, str],
    *,
    read: Mapping[str, str] | None = None,
    only_known: bool = False,
    variants: bool = False,
) -> Iterator[Candidate]:
    """Yield the ways to read one instrument: the usual one, then its variants."""
    known = load_protocol(driver.protocol).settings
    given = {key: value for key, value in settings.items() if key in known or not only_known}
    # Of another driver nothing holds.
    read = {key: value for key, value in (read or {}).items() if key in known}
    for variant in ({}, *(driver.variants if variants else ())):
        # What the user gave decides the form of the stream; other forms are not tried.
        if not given.keys() & variant.keys():
            protocol = driver.load_protocol({**given, **variant}, read=read)
            yield Candidate(
                name=driver.name, title=driver.title, protocol=protocol, bauds=driver.bauds, driver=driver, variant=variant
            )


def bauds_to_try(candidates: list[Candidate], port: str, baud: int | None) -> list[int]:
    """Return the baud rates to try: one where it is given or means nothing, else those of the candidates, likeliest first."""
    if baud is not None:
        return [baud]
    if has_no_baud(port):
        return [candidates[0].bauds[0]]
    # Everybody's likeliest first, then everybody's second.
    in_order = chain.from_iterable(zip_longest(*(candidate.bauds for candidate in candidates)))
    return [baud for baud in dict.fromkeys(in_order) if baud is not None]


def has_no_baud(port: str) -> bool:
    """Return whether the baud rate means nothing to a port: addresses and pseudo-terminals take any."""
    return "://" in port or str(real_path(port)).startswith(PSEUDO_TERMINALS)


def search(
    port: str,
    candidates: list[Candidate],
    bauds: list[int],
    clock: HostClock,
    *,
    is_given: bool = False,
    opened: Callable[[], None] = lambda: None,
) -> Search:
    """Listen at each baud rate until a candidate is recognised.

    Parameters
    ----------
    port : str
    candidates : list of Candidate
    bauds : list of int
    clock : HostClock
    is_given : bool
        The user said what it is, so plausibility is not asked for.
    opened : callable
        Called when the port is open: what is announced before may not happen.

    Raises
    ------
    LinkError
        The port cannot be opened, is gone, or takes none of the baud rates.
    """
    # A baud rate that an adapter does not know may only show when it is set: 115200 is known to all.
    first = bauds[0] if len(bauds) == 1 or has_no_baud(port) else 115200
    link = open_link(port, baud=first, clock=clock)
    result = Search(link, [])
    try:
        opened()
        end_s = clock.monotonic_s() + patience_s(clock, SEARCH_S)
        for baud in bauds:
            try:
                # The one baud rate was set as the port was opened.
                if len(bauds) > 1:
                    link.set_baud(baud)
            except LinkError as error:
                # The adapter does not know this one.
                if error.reason is Reason.BOUNDS:
                    continue
                raise
            listeners = [
                listener_of(candidate, is_given=is_given)
                for candidate in candidates
                if len(bauds) == 1 or baud in candidate.bauds
            ]
            is_silent = bool(result.hearings) and not any(hearing.byte_count for hearing in result.hearings)
            quiet_s = LISTEN_S if len(bauds) == 1 else SILENT_TRY_S if is_silent else TRY_S
            result.hearings.append(Hearing(baud, [], listeners))
            _listen(result, clock, quiet_s, end_s=end_s)
            if result.recognised is not None or clock.monotonic_s() >= end_s:
                break
    except BaseException:
        link.close()
        raise
    return result


def listener_of(candidate: Candidate, *, is_given: bool) -> Listener:
    """Return who listens to a candidate."""
    columns = candidate.protocol.settings.get("columns")
    is_open = candidate.driver is not None and columns is not None and columns.origin == "assumed"
    return (LineListener if is_open else Listener)(candidate, is_given=is_given)


def listen_again(result: Search, clock: HostClock) -> None:
    """Listen once more at the last baud rate, to an instrument that was told to send in between."""
    # New listeners: the old ones have counted the silence.
    before = result.last
    result.hearings.append(
        Hearing(before.baud, [], [Listener(listener.candidate, is_given=True) for listener in before.listeners])
    )
    _listen(result, clock, LISTEN_S, end_s=clock.monotonic_s() + patience_s(clock, LISTEN_S))


def _listen(result: Search, clock: HostClock, quiet_s: float, *, end_s: float) -> None:
    """Read until one candidate is certain, or the patience is over: ``quiet_s`` without a frame, longer with some."""
    hearing = result.last
    # Patience counts in real seconds: an emulated instrument may be fast, the machine is not.
    begin_s, real = clock.monotonic_s(), patience_s(clock, 1.0)
    while not any(listener.is_certain for listener in hearing.listeners):
        elapsed_s = (clock.monotonic_s() - begin_s) / real
        if any(listener.is_promising for listener in hearing.listeners):
            limit_s = max(quiet_s, PROMISING_S)
        elif hearing.byte_count == 0 and quiet_s == TRY_S:
            limit_s = SILENT_S
        else:
            limit_s = quiet_s
        # The end of the whole search cuts all but the one baud rate that is possible, and none shorter than a try.
        if elapsed_s >= limit_s or (elapsed_s >= TRY_S and clock.monotonic_s() >= end_s and limit_s != LISTEN_S):
            break
        chunk = result.link.read()
        if chunk is not None:
            hearing.chunks.append(chunk)
            for listener in hearing.listeners:
                listener.feed(chunk)
    for listener in hearing.listeners:
        listener.close()
    result.recognised = best(hearing.listeners)


def nothing_recognised(port: str, result: Search) -> LinkError:
    """Return the error that says what arrived instead."""
    bauds = [hearing.baud for hearing in result.hearings]
    total = sum(hearing.byte_count for hearing in result.hearings)
    if total == 0:
        waited_s = LISTEN_S if len(bauds) == 1 else SILENT_S + SILENT_TRY_S * (len(bauds) - 1)
        return LinkTimeoutError(sentence("baud_search.silent", port=port, waited_s=waited_s, bauds=bauds), Reason.SILENCE)
    listeners = [listener for hearing in result.hearings for listener in hearing.listeners]
    # The closest one helps to see what is wrong: a baud rate, a setting, a damaged line.
    closest = max(listeners, key=lambda listener: (listener.decoder.statistics.frames, listener.accelerations)).finding()
    shown = first_lines(b"".join(hearing.data for hearing in result.hearings))
    heard: dict[str, object] = {
        "lines": shown,
        "port": port,
        "names": [*dict.fromkeys(listener.candidate.name for listener in listeners)],
        "bytes": total,
        "bauds": bauds,
        "samples": closest.samples,
        "needed": FEWEST_SAMPLES,
    }
    if closest.holds_no_sample:
        other = sentence("baud_search.without_samples", port=port, title=closest.title, why=closest.reason)
        return LinkError(other, Reason.NO_FRAMES)
    lines = next(filter(None, (read_lines(hearing.data) for hearing in reversed(result.hearings))), None)
    given = [listener.candidate.protocol for listener in listeners if not listener.candidate.driver]
    if given and (differs := other_lines(port, lines, given[0])):
        return LinkError(differs, Reason.NO_FRAMES)
    texts = [listener for listener in listeners if listener.candidate.protocol.lines and listener.candidate.driver]
    text = next((listener.candidate for listener in texts if "columns" in listener.candidate.protocol.settings), None)
    if lines is not None and text is not None and text.protocol.lines is not None:
        width, expected = lines.rows.shape[1], len(text.protocol.lines.columns)
        settings = text.variant or {"columns": usual_columns(width)}
        option = " ".join(f"--set {shlex.quote(f'{name}={value}')}" for name, value in settings.items())
        key = "baud_search.few_columns" if width != expected else "baud_search.columns"
        said = {"found": width, "expected": expected, "why": closest.reason, "name": text.name, "option": option}
        return LinkError(sentence(key, **heard, **said), Reason.NO_FRAMES)
    if are_labelled(shown):
        return LinkError(sentence("baud_search.labelled", **heard), Reason.NO_FRAMES)
    if closest.frames:
        return LinkError(sentence("baud_search.closest", **heard, closest=closest.name, why=closest.reason), Reason.NO_FRAMES)
    return LinkError(sentence("baud_search.nothing", **heard), Reason.NO_FRAMES)
