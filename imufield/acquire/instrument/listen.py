"""Listen on a serial port at one baud rate after another, until an instrument is recognised or the time is over."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

from imufield.acquire.driver import Driver, Wire
from imufield.acquire.instrument.recognise import FEWEST_SAMPLES, Candidate, Ear, best
from imufield.acquire.link.host_clock import HostClock, patience_s
from imufield.acquire.link.serial import Chunk, SerialLink, open_link
from imufield.acquire.protocol.protocol import load_protocol
from imufield.acquire.registry import driver_names, load_driver
from imufield.errors import LinkError, LinkTimeoutError, ProtocolError, Reason, SettingError

Say = Callable[[str], None]
Described = TypeVar("Described")

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
    ears: list[Ear]

    @property
    def byte_count(self) -> int:
        """Bytes that arrived."""
        return sum(len(chunk.data) for chunk in self.chunks)


@dataclass(slots=True)
class Search:
    """What was heard on one port; the link is open and at the baud rate of the last hearing."""

    link: SerialLink
    hearings: list[Hearing]
    found: Ear | None

    @property
    def last(self) -> Hearing:
        """The hearing in which something was found, or the last of all."""
        return self.hearings[-1]


def serial_candidates(settings: Mapping[str, str] | None = None, *, say: Say | None = None) -> list[Candidate]:
    """Return every way to read a serial port that the drivers know; ``settings`` go to those that have them."""

    def candidates(driver: type[Driver]) -> list[Candidate]:
        return list(driver_candidates(driver, settings or {}, only_known=True, variants=True))

    return usable("serial", candidates, say)


def usable(wire: Wire, describe: Callable[[type[Driver]], list[Described]], say: Say | None = None) -> list[Described]:
    """Return what the drivers of a wire give; one that cannot be used is passed over, and ``say`` told in one sentence."""
    found: list[Described] = []
    for name in driver_names():
        try:
            driver = load_driver(name)
            found += describe(driver) if driver.wire == wire else []
        except SettingError:
            raise
        except ProtocolError as error:
            if say is not None:
                say(f"passed over: {error.message}")
    return found


def driver_candidates(
    driver: type[Driver], settings: Mapping[str, str], *, only_known: bool = False, variants: bool = False
) -> Iterator[Candidate]:
    """Yield the ways to read one instrument: the usual one, then its variants."""
    known = load_protocol(driver.protocol).settings
    given = {key: value for key, value in settings.items() if key in known or not only_known}
    for variant in ({}, *(driver.variants if variants else ())):
        if not given.keys() & variant.keys():
            protocol = driver.load_protocol({**given, **variant})
            yield Candidate(
                name=driver.name, title=driver.title, protocol=protocol, bauds=driver.bauds, driver=driver, variant=variant
            )


def bauds_to_try(candidates: list[Candidate], port: str, baud: int | None) -> list[int]:
    """Return the baud rates to try: one where it is given or means nothing, else those of the candidates, likeliest first."""
    if baud is not None:
        return [baud]
    if has_no_baud(port):
        return [candidates[0].bauds[0]]
    longest = max(len(one.bauds) for one in candidates)
    in_order = [one.bauds[rank] for rank in range(longest) for one in candidates if rank < len(one.bauds)]
    return list(dict.fromkeys(in_order))


def has_no_baud(port: str) -> bool:
    """Return whether the baud rate means nothing to a port: addresses and pseudo-terminals take any."""
    return "://" in port or str(Path(port).resolve()).startswith("/dev/pts/")


def search(port: str, candidates: list[Candidate], bauds: list[int], clock: HostClock, *, is_given: bool = False) -> Search:
    """Listen at each baud rate until a candidate is recognised.

    Parameters
    ----------
    port : str
    candidates : list of Candidate
    bauds : list of int
    clock : HostClock
    is_given : bool
        The user said what it is, so plausibility is not asked for.

    Raises
    ------
    LinkError
        The port cannot be opened, is gone, or takes none of the baud rates.
    """
    link = open_link(port, baud=_first_baud(port, bauds), clock=clock)
    found = Search(link, [], None)
    try:
        end_s = clock.monotonic_s() + patience_s(clock, SEARCH_S)
        for baud in bauds:
            if not _set_baud(link, baud, bauds):
                continue
            ears = [Ear(one, is_given=is_given) for one in candidates if len(bauds) == 1 or baud in one.bauds]
            hearing = Hearing(baud, [], ears)
            found.hearings.append(hearing)
            _listen(link, hearing, clock, _limits_s(found, bauds), end_s=end_s)
            found.found = best(ears)
            if found.found is not None or clock.monotonic_s() >= end_s:
                break
    except BaseException:
        link.close()
        raise
    return found


def listen_again(found: Search, clock: HostClock) -> None:
    """Listen once more at the last baud rate, to an instrument that was told to send in between."""
    before = found.last
    hearing = Hearing(before.baud, [], [Ear(ear.candidate, is_given=True) for ear in before.ears])
    found.hearings.append(hearing)
    _listen(found.link, hearing, clock, (LISTEN_S, LISTEN_S), end_s=clock.monotonic_s() + patience_s(clock, LISTEN_S))
    found.found = best(hearing.ears)


def _first_baud(port: str, bauds: list[int]) -> int:
    # A baud rate that an adapter does not know may only show when it is set: 115200 is known to all.
    return bauds[0] if len(bauds) == 1 or has_no_baud(port) else 115200


def _set_baud(link: SerialLink, baud: int, bauds: list[int]) -> bool:
    """Go to a baud rate; return whether the adapter knows it, where there are others to try."""
    if len(bauds) == 1:
        return True
    try:
        link.set_baud(baud)
    except LinkError as error:
        if error.reason is Reason.BOUNDS:
            return False
        raise
    return True


def _limits_s(so_far: Search, bauds: list[int]) -> tuple[float, float]:
    """Return how long to listen without and with frames."""
    if len(bauds) == 1:
        return LISTEN_S, LISTEN_S
    if len(so_far.hearings) > 1 and not any(one.byte_count for one in so_far.hearings):
        return SILENT_TRY_S, PROMISING_S
    return TRY_S, PROMISING_S


def _listen(link: SerialLink, hearing: Hearing, clock: HostClock, limits_s: tuple[float, float], *, end_s: float) -> None:
    """Read until one candidate is certain, or the patience is over."""
    begin_s, real = clock.monotonic_s(), patience_s(clock, 1.0)
    while not any(ear.is_certain for ear in hearing.ears):
        elapsed_s = (clock.monotonic_s() - begin_s) / real
        quiet, promising = limits_s
        if hearing.byte_count == 0 and quiet == TRY_S:
            quiet = SILENT_S
        limit_s = promising if any(ear.is_promising for ear in hearing.ears) else quiet
        if elapsed_s >= limit_s or (elapsed_s >= TRY_S and clock.monotonic_s() >= end_s and limit_s != LISTEN_S):
            break
        chunk = link.read()
        if chunk is not None:
            hearing.chunks.append(chunk)
            for ear in hearing.ears:
                ear.feed(chunk)
    for ear in hearing.ears:
        ear.close()


def nothing_recognised(port: str, found: Search) -> LinkError:
    """Return the error that says what was heard instead."""
    bauds = ", ".join(str(one.baud) for one in found.hearings)
    total = sum(one.byte_count for one in found.hearings)
    if total == 0:
        waited_s = LISTEN_S if len(found.hearings) == 1 else SILENT_S
        return LinkTimeoutError(
            f"{port} is silent: no byte within {waited_s:g} s at {bauds} bit/s; check power, cable, RX/TX and that the "
            "instrument is set to send by itself",
            Reason.SILENCE,
            port=port,
            waited_s=waited_s,
        )
    ears = [ear for one in found.hearings for ear in one.ears]
    finding = max(ears, key=lambda ear: (ear.decoder.statistics.frames, ear.accelerations)).finding()
    names = ", ".join(dict.fromkeys(ear.candidate.name for ear in ears))
    hint = f"; closest is {finding.name}: {finding.reason}" if finding.frames else ""
    return LinkError(
        f"{port} sends, but not {names}: {total} bytes at {bauds} bit/s made {finding.samples} samples and {FEWEST_SAMPLES} "
        f"are needed{hint}; give the right --baud or --driver, or describe the format with --protocol",
        Reason.NO_FRAMES,
        port=port,
        bytes=total,
        samples=finding.samples,
    )
