"""``python -m imufield.cli.watched WORDS``: imufield for a program that has started it, and ends with that one however it ends.

The other program holds the writing end of standard input and says nothing. Where that end closes, by its hand or because it
was killed, this one is interrupted as by Ctrl-C, on every system: files are closed, nothing recorded is lost.
"""

from __future__ import annotations

import _thread
import os
import signal
import threading
import time
from pathlib import Path

from imufield import progress
from imufield.errors import EXIT_INTERRUPTED
from imufield.limits import LONGEST_CLOSING_S


def _end_with(starter: int) -> None:
    while os.read(starter, 1):
        pass
    if os.name == "posix":
        # All of its group, as a terminal does: what it has started itself hears it, too. Not SIGINT, to which programs that are
        # started in the background of a shell are deaf; both are handled as Ctrl-C is. The group of whoever has started this
        # one is left alone.
        end = os.killpg if os.getpgrp() == os.getpid() else os.kill
        end(os.getpid(), signal.SIGTERM)
    else:
        _thread.interrupt_main(signal.SIGTERM)
    time.sleep(LONGEST_CLOSING_S)
    os._exit(EXIT_INTERRUPTED)


if __name__ == "__main__":
    from imufield.cli import app, program

    app.boxes = False
    # For this thread alone: a question to a person must find nobody, and what is started here must not hold it.
    held = os.dup(0)
    with Path(os.devnull).open() as nobody:
        os.dup2(nobody.fileno(), 0)
    progress.tell()
    threading.Thread(target=_end_with, args=(held,), daemon=True).start()
    program()
