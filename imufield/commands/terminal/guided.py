"""One run of a guided session: chunks to the disk first, then through the chain, events to the view of the person."""

from __future__ import annotations

import re
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, suppress
from functools import cache
from typing import TYPE_CHECKING

import numpy as np

from imufield.acquire.decode.statistics import remarks
from imufield.acquire.instrument.connected import Connected
from imufield.acquire.instrument.same_stream import SameStream
from imufield.acquire.link.chunk import Chunk
from imufield.acquire.link.host_clock import HostClock, ScaledClock, patience_s
from imufield.acquire.link.reconnect import ReconnectingLink
from imufield.acquire.recording.reader import Damage
from imufield.acquire.recording.recorder import Recorder, part_metadata
from imufield.acquire.recording.session import Session, create_session
from imufield.acquire.recording.session_record import GuideRecord
from imufield.calibrate.accelerometer.ellipsoid_start import FEWEST_FOR_SCALE_AND_BIAS
from imufield.commands.options.acquire_commands import CaptureOptions, ViewName
from imufield.commands.options.shared import one_of
from imufield.commands.terminal.output import echo, say
from imufield.commands.terminal.page import SHOWN_EVERY_S, serve_page
from imufield.commands.terminal.views import View, make_view
from imufield.dataclass import dataclass, replace
from imufield.deliver.parameters.file import load
from imufield.deliver.parameters.printed_numbers import beside
from imufield.errors import CalibrationError, ImufieldError, RecordingError, UsageError
from imufield.files import read_small_file, typed_write_errors, write_atomically
from imufield.guide.events import Advice, Event, Topic
from imufield.guide.positions import DEFAULT_SCHEME, REVISIT_FROM, SCHEME_FILE, SCHEMES, scheme
from imufield.guide.view.marks import AGAIN_WITHIN_S, KEYS
from imufield.guide.view.plain import known_words, words
from imufield.guide.view.terminal import Keyboard
from imufield.pipeline.calibration import FEWEST_CHECKED
from imufield.pipeline.chain import ROTATIONS, Chain, ReadingPlan, replay_into, require_gravity
from imufield.pipeline.intake import Intake
from imufield.pipeline.reading import ReadingCollector
from imufield.pipeline.reading_cache import write_cache
from imufield.pipeline.site import SiteOptions
from imufield.pipeline.solving import reading_of
from imufield.progress import can_draw, hidden
from imufield.sentences import Sentences, shell_word

if TYPE_CHECKING:
    from imufield.web.address import PageAddress

sentence = Sentences(__package__)

REFRESH_EVERY_S = 0.1  # Ten pictures a second: a person sees a turn without delay, and the decoder keeps its time.
BIG = "b"
HELP = "?"
QUIT = "q"
FINISH = "f"
QUICKLY_DECODED = 10
"""Reads that take no time that a person notices; more, on a machine that is behind, and a screen that does not answer is
pressed again."""
REOPEN = "reopen"  # Not a key: recorded where a session that was finished goes on.
_SEQUENCE = re.compile(r"\x1b(\[[\d;]*[\w~]|o\w)?")  # Of arrows and the like, lower case as keys are.


@dataclass(frozen=True, slots=True, kw_only=True)
class Captured:
    """How a capture ended."""

    session: Session
    accepted: int
    planned: int
    finished: bool
    turns: tuple[int, int] = (0, 0)
    """Whole turns: made, and planned."""
    remarks: tuple[str, ...] = ()
    """About the samples."""
    summary: tuple[str, ...] = ()
    """What the screen showed last, which is gone with it: how well all is known, drift, common scale."""

    @property
    def missing(self) -> int:
        """How many positions more a result needs at least, of those that are planned."""
        return max(0, min(FEWEST_CHECKED, self.planned) - self.accepted)

    @property
    def lacking(self) -> str:
        """What is missing for a result, in words; empty where nothing is."""
        if not self.missing:
            return ""
        to_solve = FEWEST_FOR_SCALE_AND_BIAS - self.accepted
        if to_solve > 0:
            return sentence("guided.too_few", missing=to_solve)
        return sentence("guided.missing", missing=self.missing)

    @property
    def can_be_solved(self) -> bool:
        """Whether nothing is left to measure, and enough was."""
        return self.finished and not self.missing


def guide_record(options: CaptureOptions) -> GuideRecord:
    """Return what was given of the options of the guide, as a session keeps it.

    Raises
    ------
    UsageError
        If the rotations are of no known kind.
    ParameterFileError
        If the preset cannot be read.
    """
    rotations = None if options.rotations is None else ROTATIONS[one_of("rotations", options.rotations, tuple(ROTATIONS))]
    scale, sigma = None, None
    if options.preset is not None:
        # The common scale of the earlier calibration: what a wrong gravity shows against.
        earlier = load(options.preset).calibration.intrinsic
        scale = float(np.exp(np.mean(np.log(np.abs(earlier.scale)))))
        # The worst axis: a warning about gravity must not come from an axis that was hardly known.
        sigma = float(np.max(earlier.scale_sigma / np.abs(earlier.scale)))
    return GuideRecord(
        hold_s=options.hold_s,
        target_bias_ug=options.target_bias_ug,
        target_scale_ppm=options.target_scale_ppm,
        rotations=rotations,
        earlier_scale_raw=scale,
        earlier_scale_sigma=sigma if sigma is not None and sigma > 0 else None,
    )


def new_session(options: CaptureOptions, connected: Connected, site: SiteOptions) -> Session:
    """Create the session's folder with everything that is known before the first byte.

    Raises
    ------
    ParameterFileError
        If the earlier calibration is of another instrument or in another unit.
    CalibrationError
        If the instrument sends no gravity.
    """
    require_gravity(connected.protocol)
    if options.preset is not None:
        preset = load(options.preset)
        preset.check_instrument(connected.identity.get("serial_number", ""))
        preset.check_unit("accelerometer", connected.protocol.units.accelerometer_rate_unit)
    name = DEFAULT_SCHEME if options.positions is None else options.positions
    positions = None
    if name not in SCHEMES:
        try:
            positions = read_small_file(name)
        except OSError as error:
            raise UsageError(sentence("guided.no_positions", path=name, cause=error.strerror)) from error
    guide = replace(guide_record(options), revisit_first=True if len(scheme(name)) >= REVISIT_FROM else None)
    metadata = {
        **connected.session_tables(),
        "kind": "capture",
        "scheme": name if positions is None else SCHEME_FILE,
        "guide": guide,
        "site": site.record(),
    }
    session = create_session(options.session, options.root, connected.model, metadata)
    if positions is not None:
        with typed_write_errors(session.folder, RecordingError):
            write_atomically(session.folder / SCHEME_FILE, positions)
    return session


def guided_session(
    session: Session,
    connected: Connected,
    clock: HostClock,
    options: CaptureOptions,
    *,
    place: PageAddress | None = None,
    check: Callable[[], None] = lambda: None,
    again: str = "",
) -> Captured:
    """Run the loop and say what there is and how to go on, also where it is broken off; the reason is passed on.

    The page is served at ``place``, where one is wanted. ``check`` is called again and again, and may break it off by an
    ``ImufieldError``. ``again`` is the command that begins anew, where the instrument ends with the session.
    """
    stream = SameStream(connected.link.name, patience_s(clock, 1.0))
    collected, damage = ReadingCollector(), list[Damage]()
    chain = Chain(ReadingPlan.of(session), listeners=(stream.hear, collected.feed))
    # Of a session that goes on, so that the guide knows again what it knew; of a new one there is nothing.
    replay_into(chain, session, damage, collected.hear, ended=False)
    stream.begin()
    metadata = part_metadata(connected.protocol, connected.session_tables())
    loop = None
    try:
        with hidden(), ExitStack() as stack:
            recorder = stack.enter_context(
                Recorder(session.add_part(), metadata, clock=clock, remedy=sentence("guided.remedy"))
            )
            keyboard = stack.enter_context(Keyboard())
            positions = scheme(chain.plan.scheme or DEFAULT_SCHEME)
            page = None
            if place is not None:
                as_json = options.view == "json"
                page = stack.enter_context(serve_page(place, positions, session, cable=options.cable, as_json=as_json))
            view = stack.enter_context(make_view(options, session.folder, positions, chain.origin_s))
            view.page = page
            loop = CaptureLoop(
                session=session,
                connected=connected,
                intake=Intake(recorder=recorder, chain=chain, stream=stream),
                hear=collected.hear,
                view=view,
                keyboard=keyboard,
                clock=clock,
                check=check,
                retake=tuple(options.retake or ()),
            )
            reason = ""
            try:
                captured = loop.run()
            except ImufieldError as error:
                reason = error.message
                raise
            finally:
                if page is not None:
                    ended = loop.captured()
                    counts = {"accepted": ended.accepted, "planned": ended.planned, "lacking": ended.lacking}
                    outcome = "finished" if ended.can_be_solved else "stopped"
                    page.end({"outcome": outcome, "reason": reason, "command": _next_command(ended, clock), **counts})
    except (KeyboardInterrupt, ImufieldError):
        if loop is not None:
            farewell(loop.captured(), options.view, clock, again)
        raise
    farewell(captured, options.view, clock, again)
    if not damage:
        # For who solves it: all has been seen already. Where there is nothing to be calibrated from, solving says so.
        with suppress(CalibrationError):
            write_cache(session, reading_of(session, chain, collected, sha256=session.sha256()))
    return captured


@dataclass(kw_only=True)
class CaptureLoop:
    """One run of a session: chunks to the disk first, then through the chain, events to the view."""

    session: Session
    connected: Connected
    intake: Intake
    view: View
    keyboard: Keyboard
    clock: HostClock
    check: Callable[[], None]
    hear: Callable[[list[Event]], None] = lambda _: None
    """Is told every event."""
    retake: tuple[str, ...] = ()
    """Positions to be measured again."""

    def __post_init__(self) -> None:
        self.chain = self.intake.chain
        self._last_refresh_s = self._last_shown_s = float("-inf")
        self._link = ReconnectingLink(self.connected.link, self.clock, self.connected.ask_again)
        self._finish_until_s = float("-inf")  # Until then the key that finishes is believed.
        self._advice: dict[Topic, Advice] = {}  # The newest of those that are for the end.

    def run(self) -> Captured:
        """Go on until all is done or the operator quits."""
        self._publish(self.intake.start_part(self.connected.protocol))
        self._go_on()
        for heard in self.connected.chunks:
            self._take(heard)
        try:
            quitting = False
            while not (quitting or self._done):
                chunk = self._next_chunk()
                if chunk is not None:
                    self._take(chunk)
                else:
                    self._publish(self.intake.catch_up())
                quitting = self._follow_keys()
                self._refresh()
                self.check()
        except KeyboardInterrupt:
            # Recorded and not decoded: the decoder may have been interrupted in its work.
            for chunk in self.connected.link.drain():
                self.intake.recorder.write_chunk(chunk)
            raise
        # What was read in the background before the last key may hold the end of a hold.
        waiting = self.connected.link.drain()
        if quitting and len(waiting) > QUICKLY_DECODED:
            self.view.tell(sentence("guided.quitting"))
            self._refresh(at_once=True)
        for chunk in waiting:
            self._take(chunk)
        self._publish(self.intake.finish())
        self._refresh(at_once=True)  # The last words are not for the next picture: there is none.
        if self._done:
            self.session.update(finished=True)
        return self.captured()

    def _go_on(self) -> None:
        """Take up a session that was finished, and what is to be measured again; noted, so that a replay does the same."""
        if self._done:
            self._publish(self.intake.mark(REOPEN))
        for position in self.retake:
            self._publish(self.intake.mark("retake", position))

    def captured(self) -> Captured:
        """Return how far the session has come."""
        guide = self.chain.guide
        accepted, planned = (0, 0) if guide is None else (len(guide.plan.accepted), len(guide.plan.scheme))
        return Captured(
            session=self.session,
            accepted=accepted,
            planned=planned,
            finished=self._done,
            turns=(0, 0) if guide is None else guide.turns,
            remarks=tuple(remarks(self.chain.statistics)),
            summary=tuple(self._summary()),
        )

    def _summary(self) -> Iterator[str]:
        """Say how well the parameters are known, what was advised at the end, and what solving will refuse."""
        guide = self.chain.guide
        known = None if guide is None else guide.snapshot().forecast
        # With fewer there is nothing to solve.
        if guide is not None and known is not None and len(guide.plan.accepted) >= FEWEST_FOR_SCALE_AND_BIAS:
            yield sentence("guided.known", bias=known_words(known, "bias_ug"), scale=known_words(known, "scale_ppm"))
        yield from (words(advice) for advice in self._advice.values())
        wrong = None if guide is None else guide.check_axes().error
        if wrong is not None:
            yield wrong.message

    @property
    def _done(self) -> bool:
        return self.chain.guide is not None and self.chain.guide.done

    def _next_chunk(self) -> Chunk | None:
        was_lost = self._link.lost is not None
        chunk = self._link.read()
        if self._link.lost is not None and not was_lost:
            self._publish(self.intake.link_lost())
        return chunk

    def _take(self, chunk: Chunk) -> None:
        self._publish(self.intake.take(chunk))

    def _follow_keys(self) -> bool:
        keys, page = _SEQUENCE.sub("", self.keyboard.read()), self.view.page
        if page is not None:
            if keys and page.notice and QUIT not in keys:
                keys = page.notice = ""
            keys += page.read()
        for key in keys:
            if key == QUIT:
                return True
            if key == BIG:
                self.view.toggle_big()
            elif key == HELP:
                self.view.tell(sentence("guided.keys"))
            elif key not in KEYS:
                self.view.tell(sentence("guided.no_key", key=key))
            elif key != FINISH or self._is_sure():
                self._publish(self.intake.mark(KEYS[key]))
        return False

    def _is_sure(self) -> bool:
        """Whether the session may be finished: at the second press, said at the first; nothing of the first is recorded."""
        now_s, guide = time.monotonic(), self.chain.guide
        if guide is None or now_s <= self._finish_until_s:
            return True
        self._finish_until_s = now_s + AGAIN_WITHIN_S
        self.view.show([guide.asked_to_finish()])
        return False

    def _publish(self, events: list[Event]) -> None:
        self.hear(events)
        for event in events:
            if isinstance(event, Advice) and event.topic in (Topic.DRIFT, Topic.SCALE):
                self._advice[event.topic] = event
        if events:
            self._note_accepted()
            self.view.show(events)

    def _note_accepted(self) -> None:
        """Keep beside the recording how many positions are measured: a list of sessions decodes none."""
        accepted = 0 if self.chain.guide is None else len(self.chain.guide.plan.accepted)
        if accepted != (self.session.record.accepted or 0):
            self.session.update(accepted=accepted)

    def _refresh(self, *, at_once: bool = False) -> None:
        # The time of a person is real: with an emulated instrument that runs fast all of it would go into pictures.
        now_s, page = time.monotonic(), self.view.page
        draws = now_s - self._last_refresh_s >= REFRESH_EVERY_S or at_once
        shows = page is not None and (draws or (page.is_looked_at and now_s - self._last_shown_s >= SHOWN_EVERY_S))
        if not (draws or shows) or self.chain.guide is None:
            return
        snapshot = cache(self.chain.guide.snapshot)
        silent, lost = self._link.is_silent or self.intake.stream.is_unread, sum(part.lost for part in self.chain.statistics)
        if page is not None and shows:
            self._last_shown_s = now_s
            page.refresh(snapshot(), silent=silent, samples_lost=lost)
        if draws:
            self._last_refresh_s = now_s
            self.view.refresh(snapshot, self.connected.link.name, silent=silent, samples_lost=lost)


def farewell(captured: Captured, view: ViewName, clock: HostClock, again: str = "") -> None:
    """Say what there is and what to type next, as it can be pasted."""
    folder = captured.session.folder
    if view == "json" or not folder.exists():
        return
    # Whoever reads lines has read these already.
    for line in captured.summary if view == "auto" and can_draw(sys.stdout) else ():
        say(line)
    for line in captured.remarks:
        say(line)
    turned, turns = captured.turns
    with_turns = f" and {turned} of {turns} whole turns" if turns else ""
    measured = f"{captured.accepted} of {captured.planned} positions{with_turns} measured"
    echo(beside(f"{measured}, session" if captured.can_be_solved else f"{measured} so far, all on disk in", folder))
    if captured.finished and captured.lacking:
        say(captured.lacking)
    if again and not captured.can_be_solved:
        echo(beside("again:", again))
    else:
        echo(beside("next: " if captured.can_be_solved else "go on:", _next_command(captured, clock)))
    if not (captured.can_be_solved or captured.missing):
        echo(beside("or now:", f"imufield solve {shell_word(folder)}"))


def _next_command(captured: Captured, clock: HostClock) -> str:
    """Return what to type next, as it can be pasted."""
    folder = shell_word(captured.session.folder)
    if captured.can_be_solved:
        return f"imufield solve {folder}"
    # An emulated instrument that runs faster than real must be read as fast again.
    speed = f" --clock-speed {clock.speed:g}" if isinstance(clock, ScaledClock) else ""
    return f"imufield capture --resume --session {folder}{speed}"
