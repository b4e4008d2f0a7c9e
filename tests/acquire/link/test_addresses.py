"""The names that other packages import from the room."""

from __future__ import annotations

import subprocess
import sys


def test_the_ports_are_there_as_soon_as_they_are_named() -> None:
    code = """
import sys
import imufield.acquire.link as link
assert "serial" not in sys.modules and {"open_link", "Chunk"} <= set(dir(link))
assert link.serial.open_link is link.open_link
"""
    subprocess.run([sys.executable, "-c", code], check=True)
