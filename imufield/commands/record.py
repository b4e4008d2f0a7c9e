"""``imufield record``: plain recording, e.g. hours of standstill."""

from __future__ import annotations

import json
import sys
from contextlib import ExitStack, nullcontext, suppress

from imufield.acquire.decode.statistics import DecoderStatistics, combined, remarks
from imufield.acquire.instrument.connect import connect
from imufield.acquire.instrument.same_stream import SameStream
from imufield.acquire.link.chunk import Chunk
from imufield.acquire.link.host_clock import HostClock, patience_s
from imufield.acquire.link.reconnect import ReconnectingLink
from imufield.acquire.recording.recorder import Recorder, part_metadata
from imufield.acquire.recording.session import Session, create_session
from imufield.commands.options.acquire_commands import RecordOptions
from imufield.commands.terminal.output import echo, host_clock, say, say_assumed
from imufield.commands.terminal.ramp import RampLead
from imufield.deliver.parameters.printed_numbers import beside
from imufield.errors import LinkTimeoutError, Reason, RecordingError
from imufield.pipeline.chain import Chain, ReadingPlan
from imufield.pipeline.intake import Intake
from imufield.pipeline.windows import RAMP
from imufield.progress import hidden
from imufield.sentences import Sentences

sentence = Sentences(__package__)

TELL_EVERY_S = 1.0  # A count that changes faster cannot be read.


def run_record(options: RecordOptions, clock: HostClock | None = None) -> Session:
    """Record until the time is over or the user interrupts; a lost link is opened again, and an error if lost at the end.

    Raises
    ------
    ImufieldError
        Link or recording errors; what was recorded stays.
    """
    clock = clock or host_clock(options.clock_speed)
    # Refused now, an impossible latitude costs no recording.
    options.site.gravity()
    connected = connect(options.connect, clock, say_assumed)
    with ExitStack() as stack:
        # The recording has a line of its own.
        stack.enter_context(hidden())
        stack.callback(connected.close)
        kind = RAMP if options.ramp else "record"
        metadata = {**connected.session_tables(), "kind": kind, "site": options.site.place().record()}
        session = create_session(options.session, options.root, connected.model, metadata)
        stack.enter_context(session.lock())
        of_part = part_metadata(connected.protocol, connected.session_tables())
        recorder = stack.enter_context(Recorder(session.add_part(), of_part, clock=clock, remedy=sentence("record.remedy")))
        stream = SameStream(connected.link.name, patience_s(clock, 1.0))
        ramp = RampLead(connected.protocol.raw_zero_rate(), as_json=options.as_json) if options.ramp else None
        listeners = (stream.hear,) if ramp is None else (stream.hear, ramp.feed)
        chain = Chain(ReadingPlan(None), listeners=listeners, judging=False)
        intake = Intake(recorder=recorder, chain=chain, stream=stream)
        intake.start_part(connected.protocol)
        stream.begin()
        link = ReconnectingLink(connected.link, clock, connected.ask_again)
        try:
            try:
                _record(link, intake, clock, heard=connected.chunks, options=options, ramp=ramp)
            except KeyboardInterrupt:
                # What was read before Ctrl-C still waits in the link.
                intake.take_rest(connected.link.drain())
                raise
            intake.take_rest(connected.link.drain())
        finally:
            # Ctrl-C and a pulled cable end a recording, too: whatever it is, it is complete up to here.
            # Where nothing could be recorded (the folder is gone), that is what has to be told, not what follows from it.
            with suppress(RecordingError) if isinstance(sys.exception(), RecordingError) else nullcontext():
                session.update(finished=True)
            _tell_end(session, intake, link.pauses_s, as_json=options.as_json)
            if ramp is not None:
                ramp.tell_end(session)
    return session


def _record(
    link: ReconnectingLink,
    intake: Intake,
    clock: HostClock,
    *,
    heard: list[Chunk],
    options: RecordOptions,
    ramp: RampLead | None,
) -> None:
    # What was heard while connecting is recorded, so its time is part of what was asked for.
    for chunk in heard:
        intake.take(chunk)
    told_s = clock.monotonic_s()
    start_s, has_begun = (heard[0].monotonic_s, True) if heard else (told_s, False)
    was_lost, trouble = False, ("", "")
    while options.duration_s is None or clock.monotonic_s() - start_s < options.duration_s:
        read = link.read()
        if link.lost is not None and not was_lost:
            intake.link_lost()
        was_lost = link.lost is not None
        trouble = _tell_trouble(_trouble(link, intake.stream), trouble, as_json=options.as_json)
        if read is not None:
            start_s, has_begun = (start_s if has_begun else read.monotonic_s), True
            intake.take(read)
        else:
            intake.catch_up()
        now_s = clock.monotonic_s()
        if now_s - told_s >= TELL_EVERY_S:
            told_s = now_s
            if ramp is not None:
                ramp.tell()
            else:
                _tell_progress(combined(intake.chain.statistics), now_s - start_s, link.pause_s, as_json=options.as_json)
    if link.lost is not None:
        raise link.lost
    if link.is_silent:
        raise LinkTimeoutError(sentence("record.ended_silent", port=link.name, pause_s=link.pause_s))
    if intake.stream.is_unread:
        raise LinkTimeoutError(
            sentence("record.ended_unread", port=link.name, unread_s=intake.stream.unread_s), Reason.NO_FRAMES
        )


def _trouble(link: ReconnectingLink, stream: SameStream) -> tuple[str, str]:
    """Return why no sample arrives, and what is said when it does again; empty while all is well."""
    if link.lost is not None:
        return sentence("record.waiting", lost=link.lost.message.removesuffix(".")), sentence("record.back")
    if link.is_silent:
        return sentence("record.silent", port=link.name), sentence("record.data_again")
    if stream.is_unread:
        return sentence("record.unread", port=link.name), sentence("record.samples_again")
    return "", ""


def _tell_trouble(trouble: tuple[str, str], before: tuple[str, str], *, as_json: bool) -> tuple[str, str]:
    """Say what is wrong, and when it is over, each once; return what is wrong now."""
    if trouble[0] != before[0]:
        # On a terminal the line of the progress stands open; lines for a program do not.
        if sys.stdout.isatty() and not as_json:
            echo()
        say(trouble[0] or before[1], err=True)
    return trouble


def _tell_progress(counts: DecoderStatistics, elapsed_s: float, pause_s: float, *, as_json: bool) -> None:
    if as_json:
        times = {"elapsed_s": round(elapsed_s, 3), "pause_s": round(pause_s, 3)}
        echo(json.dumps({"event": "recording", **times, **counts.to_dict()}))
    elif sys.stdout.isatty():
        state = f"NO DATA for {pause_s:.0f} s" if pause_s else "(Ctrl-C ends)"
        echo(f"{elapsed_s:8.0f} s  {counts.samples} samples  {counts.lost} lost  {state:<20}", begin="\r", end="")


def _tell_end(session: Session, intake: Intake, pauses_s: float, *, as_json: bool) -> None:
    if not session.folder.exists():
        return
    # What the decoder holds back until it is sure of its time counts as well.
    intake.finish()
    statistics = intake.chain.statistics
    counts = combined(statistics)
    if as_json:
        told = {"session": str(session.folder), "pauses_s": round(pauses_s, 3)}
        echo(json.dumps({"event": "recorded", **told, **counts.to_dict()}))
        return
    if sys.stdout.isatty():
        echo()
    echo(beside(f"{counts.samples} samples, {counts.lost} lost, session", session.folder))
    if pauses_s:
        say(sentence("record.pauses", pauses_s=pauses_s))
    for remark in remarks(statistics):
        say(remark)
