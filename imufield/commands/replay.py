"""``imufield replay``: a recorded session through the same chain, or its bytes to a port or a bus for other programs."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from contextlib import ExitStack, closing
from typing import TYPE_CHECKING

from imufield.acquire.decode.statistics import combined
from imufield.acquire.decoded_session import Items, session_protocol
from imufield.acquire.recording.reader import (
    BLOCK_SPAN_S,
    Damage,
    Pacer,
    PartStart,
    RecordedBlock,
    read_blocks,
    recorded_chunks,
)
from imufield.acquire.recording.session import Session, open_or_newest
from imufield.commands.options.acquire_commands import ReplayOptions
from imufield.commands.terminal.output import echo, say, say_each
from imufield.commands.terminal.page import SHOWN_EVERY_S, ServedPage, bind_page, serve_page
from imufield.deliver.parameters.file import PARAMETER_FILE, load_found
from imufield.errors import ImufieldError, UsageError
from imufield.files import Origin
from imufield.guide.events import Event
from imufield.guide.positions import scheme
from imufield.guide.view.plain import JsonLinesView, PlainView
from imufield.pipeline.chain import Chain, ReadingPlan, replay_into
from imufield.sentences import Sentences, counted, shell_word

if TYPE_CHECKING:
    from imufield.acquire.protocol.can_frame import Frame
    from imufield.simulate.emulator.port import PseudoTerminal

sentence = Sentences(__package__)

LONGEST_PAUSE_S = 5.0  # A cable that was out longer, or a break, is not waited for on a page.
WAIT_S = 0.05  # Between two looks for a reader: shorter than a person notices.
SLOT_S = 0.002  # Between two looks at a full buffer, which holds some ten times as long at 1 Mbit/s.
LINGER_S = 0.5
"""The port stays this long after the last byte: a reader that polls may not have taken it yet."""


def run_replay(options: ReplayOptions) -> None:
    """Replay a session.

    Raises
    ------
    ImufieldError
        If the session cannot be read, or the bus not be opened.
    """
    session = open_or_newest(options.session)
    damage: list[Damage] = []
    asked = {"--to-pty": options.to_pty, "--bus": options.bus is not None, "--web": options.web}
    if sum(asked.values()) > 1:
        raise UsageError(sentence("replay.one_of", options=" and ".join(name for name, is_asked in asked.items() if is_asked)))
    if options.bus is not None or options.to_pty:
        _replay_to_others(session, options, damage)
        say_each((entry.what for entry in damage), err=True)
        return
    chain = Chain(ReadingPlan.of(session))
    view = JsonLinesView(echo) if options.as_json else PlainView(say, origin_s=chain.origin_s)
    if options.web:
        _replay_to_page(session, options, chain, show=view.show, damage=damage)
    else:
        replay_into(chain, session, damage, view.show)
    say_each((entry.what for entry in damage), err=True)
    # JSON lines are for programs, which count for themselves.
    if not options.as_json:
        _tell(chain)
        _tell_left_out(session)


def _replay_to_page(
    session: Session, options: ReplayOptions, chain: Chain, *, show: Callable[[list[Event]], None], damage: list[Damage]
) -> None:
    """Replay at a pace of its own, with a page that shows what a capture's showed; it takes no marks."""
    if chain.plan.scheme is None:
        raise UsageError(sentence("replay.no_guide", folder=session.folder))
    positions = scheme(chain.plan.scheme, Origin.INSIDE)
    pacer = Pacer(options.speed or None, longest_s=LONGEST_PAUSE_S)
    with ExitStack() as stack:
        place = bind_page(stack)
        page = stack.enter_context(serve_page(place, positions, session, as_json=options.as_json, replay_speed=options.speed))
        shown_s = -math.inf

        def refresh(*, at_once: bool = False) -> None:
            nonlocal shown_s
            now_s = time.monotonic()
            if chain.guide is not None and (at_once or now_s - shown_s >= SHOWN_EVERY_S):
                shown_s = now_s
                page.refresh(chain.guide.snapshot(), samples_lost=sum(part.lost for part in chain.statistics))

        def items() -> Items:
            # What a page is shown in one step is fed in one: hours are replayed in minutes.
            span_s = min(SHOWN_EVERY_S * options.speed, BLOCK_SPAN_S) or BLOCK_SPAN_S
            for item in _once_seen(page, read_blocks(session, damage, span_s=span_s)):
                refresh()
                if isinstance(item, PartStart):
                    pacer.begin_anew()
                elif isinstance(item, RecordedBlock):
                    pacer.wait(float(item.monotonic_s[-1]))
                yield item

        def listen(events: list[Event]) -> None:
            show(events)
            page.show(events)

        replay_into(chain, session, damage, listen, items=items())
        refresh(at_once=True)
        command = f"imufield replay --web {shell_word(session.folder)}"
        counts = {"accepted": len(chain.observations()), "planned": len(positions), "lacking": ""}
        page.end({"outcome": "replayed", "reason": "", "command": command, **counts})


def _once_seen(page: ServedPage, items: Items) -> Items:
    """Yield items; wait at the first block until a page looks, or a short recording would be over before anybody sees it."""
    is_awaited = True
    for item in items:
        # Only now: a recording that cannot be read waits for nobody.
        if is_awaited and isinstance(item, RecordedBlock):
            say(sentence("replay.waits"), err=True)
            while not page.is_looked_at:
                time.sleep(WAIT_S)
            is_awaited = False
        yield item


def _tell(chain: Chain) -> None:
    counts = combined(chain.statistics)
    say(
        f"{counts.samples} samples of {counts.frames} frames; {counts.lost} lost, "
        f"{counts.frames_bad_checksum} with a bad checksum, {counts.bytes_skipped} bytes skipped"
    )
    if chain.finder is not None:
        found = chain.still_intervals()
        echo(f"{counted(len(found.observations), 'still interval')}, {len(found.refused)} refused")


def _tell_left_out(session: Session) -> None:
    """Say which positions the parameters in the session's folder were solved without."""
    try:
        positions = load_found(session.folder / PARAMETER_FILE, Origin.INSIDE).document["position"]
    except ImufieldError:
        return
    if names := [position["name"] for position in positions if not position["used"]]:
        say(sentence("replay.left_out", file=PARAMETER_FILE, names=names))


def _replay_to_others(session: Session, options: ReplayOptions, damage: list[Damage]) -> None:
    """Send what was recorded to other programs: bytes to a port, frames to a bus or to an adapter on a port."""
    can = session_protocol(session).can
    if options.bus is None:
        (_replay_to_pty if can is None else _replay_to_slcan)(session, damage, options.speed or None)
        return
    if can is None:
        raise UsageError(sentence("replay.no_bus", folder=session.folder))
    from imufield.acquire.formats.can_logs import replay_to_bus

    echo(f"sending to {options.bus}  (Ctrl-C ends)")
    pace, bit_rate = options.speed or None, options.bit_rate or can.bit_rate
    sent = replay_to_bus(session, options.bus, damage, pace=pace, bit_rate=bit_rate)
    echo(f"{sent} frames sent")


def _replay_to_slcan(session: Session, damage: list[Damage], pace: float | None) -> None:
    """Send frames as an adapter that speaks slcan, from the moment a program opens its channel."""
    from imufield.acquire.formats.can_logs import replay_frames
    from imufield.simulate.emulator.slcan import SlcanDevice

    with closing(SlcanDevice()) as device:

        def send(frame: Frame) -> None:
            device.send([frame])
            _wait_until_read(device.port)

        echo(f"waiting for a reader of slcan:{device.port.address}  (Ctrl-C ends)")
        while not device.is_open:
            device.receive()
            time.sleep(WAIT_S)
        sent = replay_frames(session, send, damage, pace=pace, on_chunk=device.receive)
        echo(f"{sent - device.frames_dropped} frames sent")
        time.sleep(LINGER_S)


def _wait_until_read(port: PseudoTerminal) -> None:
    """Wait until the reader has taken what was written, or has left: as fast as possible means as fast as it takes bytes."""
    while port.bytes_waiting and port.has_reader():
        time.sleep(SLOT_S)
        port.write(b"")


def _replay_to_pty(session: Session, damage: list[Damage], pace: float | None) -> None:
    """Send the bytes at the pace they were recorded with, from the moment a program opens the port."""
    from imufield.simulate.emulator.port import PseudoTerminal

    sent, said = 0, False
    with closing(PseudoTerminal()) as port:
        echo(f"waiting for a reader of {port.address}  (Ctrl-C ends)")
        while not port.has_reader():
            time.sleep(WAIT_S)
        for chunk in recorded_chunks(session, damage, pace=pace):
            port.write(chunk.data)
            sent += len(chunk.data)
            _wait_until_read(port)
            # Said only when a chunk has shown it: no file says of itself that it has no times.
            if pace and not said and math.isnan(chunk.monotonic_s):
                said = True
                say(sentence("replay.no_times"))
        echo(f"{sent} bytes sent")
        time.sleep(LINGER_S)
