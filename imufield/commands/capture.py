"""``imufield capture``: a guided session, from the port to the last position."""

from __future__ import annotations

import sys
from contextlib import ExitStack

from imufield.acquire.instrument.connect import check_options, connect
from imufield.acquire.link.host_clock import HostClock
from imufield.acquire.recording.session import Session
from imufield.commands.options.acquire_commands import CaptureOptions
from imufield.commands.terminal.guided import Captured, guide_record, guided_session, new_session
from imufield.commands.terminal.output import before_recording, host_clock, say, say_assumed
from imufield.commands.terminal.page import open_page
from imufield.commands.terminal.resume import check_instrument, check_plan, connect_as_before, find_unfinished
from imufield.commands.terminal.site import ask_site
from imufield.guide.positions import DEFAULT_SCHEME, scheme
from imufield.sentences import Sentences

sentence = Sentences(__package__)


def run_capture(options: CaptureOptions, clock: HostClock | None = None) -> Captured:
    """Capture until every position is measured or the operator quits.

    Raises
    ------
    ImufieldError
        Link, recording or usage errors; what was recorded stays.
    """
    interactive = options.view == "auto" and sys.stdout.isatty()
    clock = clock or host_clock(options.clock_speed)
    # A name that is wrong is refused before the port is opened.
    scheme(DEFAULT_SCHEME if options.positions is None else options.positions)
    asked = guide_record(options)
    with ExitStack() as stack:
        with before_recording():
            place = open_page(options, stack)
            earlier = find_unfinished(
                options.session,
                options.root,
                resume=options.resume,
                interactive=interactive,
                retake=tuple(options.retake or ()),
            )
            if earlier is not None:
                check_plan(earlier, options.positions, asked)
                if options.view != "json":
                    _say_what_goes_on(earlier, options)
            how = options.connect if earlier is None else connect_as_before(options.connect, earlier)
            site = options.site.place() if earlier is None else options.site.place(earlier.record.site)
            # A place that is nowhere on Earth is a slip of what was typed, whatever the port.
            site.check()
            check_options(how)
            if interactive and not site.is_known:
                site = ask_site(options.site, options.root)
            elif not site.is_known:
                options.site.gravity()  # Refuses a typed height alone.
                if options.view != "json":
                    say(sentence("capture.gravity_unknown"), err=True)
            connected = connect(how, clock, say_assumed)
            stack.callback(connected.close)
        session = earlier or new_session(options, connected, site)
        stack.enter_context(session.lock())
        if earlier is not None:
            # Under the lock: nobody else may finish or delete the session between the look and the first byte.
            check_instrument(session, connected)
            session.update(site=site.record(), finished=False)
        return guided_session(session, connected, clock, options, place=place)


def _say_what_goes_on(earlier: Session, options: CaptureOptions) -> None:
    """Say which session goes on where nobody named it, and that it was begun at another place."""
    if options.session is None:
        say(sentence("capture.goes_on", session=earlier.folder), err=True)
    another_place = options.site.another_place(earlier.record.site)
    if another_place is not None:
        say(another_place, err=True)
