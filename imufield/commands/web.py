"""``imufield web``: the whole way in a browser on this machine, by the commands of imufield."""

from __future__ import annotations

import time
from contextlib import ExitStack

from imufield.commands.options.acquire_commands import WebOptions
from imufield.commands.terminal.output import say
from imufield.commands.terminal.page import bind_page, show_in_browser
from imufield.errors import UsageError
from imufield.files import typed_write_errors
from imufield.progress import hidden
from imufield.sentences import Sentences

sentence = Sentences(__package__)

LOOK_S = 1.0  # A Ctrl-C ends the sleep at once.


def run_web(options: WebOptions) -> None:
    """Serve the workbench until Ctrl-C, and end what it has started.

    Raises
    ------
    UsageError
        If the folder is none or cannot be made, packages are missing, or the port cannot be had.
    """
    if options.folder.exists() and not options.folder.is_dir():
        raise UsageError(sentence("sessions.no_folder", folder=options.folder))
    with typed_write_errors(options.folder, UsageError):
        options.folder.mkdir(parents=True, exist_ok=True)
    with hidden(), ExitStack() as stack:
        place = bind_page(stack, port=options.web_port)
        # Packages that are missing were told by now.
        from imufield.web.access import Access, Role
        from imufield.web.server import PageServer
        from imufield.web.workbench import Workbench

        bench = Workbench(options.folder)
        stack.callback(bench.close)
        # Before the first page comes: it is told where it is with its first message.
        bench.refresh()
        access = Access(place.hosts)
        stack.enter_context(PageServer(place.listening, access, bench.board, bench.take, service=bench.service))
        url = f"{place.url}#token={access.mark}"
        say(sentence("web.at", url=url), err=True)
        show_in_browser(f"{place.url}#token={access.once(Role.MARK)}")
        while True:
            time.sleep(LOOK_S)
