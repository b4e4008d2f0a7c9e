"""A Ctrl-C at every moment at which Python lets one in: behind calls, at the begin of functions, at jumps back."""

from __future__ import annotations

import dis
import sys
import threading
from collections.abc import Callable
from functools import cache
from itertools import pairwise
from types import CodeType, FrameType
from typing import Any

HANGS_S = 60.0  # Only what waits for ever takes so long.


def interrupted_at(moment: int, work: Callable[[], object]) -> bool:
    """Do some work with a KeyboardInterrupt at its n-th such moment; whether there was one. Any other error is passed on.

    An interrupt that the work swallows is an error too.
    """
    left, before = moment, sys.gettrace()

    def trace(frame: FrameType, event: str, _: Any) -> Any:
        nonlocal left
        frame.f_trace_opcodes = True
        if event == "opcode" and frame.f_lasti in _let_in(frame.f_code):
            left -= 1
            if not left:
                sys.settrace(before)
                raise KeyboardInterrupt
        return trace

    sys.settrace(trace)
    try:
        work()
    except KeyboardInterrupt:
        return True
    finally:
        sys.settrace(before)
    assert left > 0, f"the interrupt at moment {moment} was swallowed"
    return False


@cache
def _let_in(code: CodeType) -> set[int]:
    instructions = [each for each in dis.get_instructions(code) if each.opname != "CACHE"]
    return {one.offset for last, one in pairwise(instructions) if last.opname.startswith(("CALL", "RESUME", "JUMP_BACKWARD"))}


def ends(work: Callable[[], object]) -> bool:
    """Do some work; whether it ends, or waits for a lock that nobody will release."""
    thread = threading.Thread(target=work, daemon=True)
    thread.start()
    thread.join(HANGS_S)
    return not thread.is_alive()
