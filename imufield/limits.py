"""Ranges that options, files and protocols share, each stated once, lowest and highest: every start of the program reads it."""

from __future__ import annotations

HOLD_RANGE_S = (1.0, 600.0)
"""More than ten minutes is a slip of the finger: 24 positions would take a working day."""

TARGET_RANGE = (0.1, 1e6)
"""Of an uncertainty wanted, in ug or ppm: a million parts are the whole."""

RATE_RANGE_HZ = (1e-3, 1e6)
"""Of samples: from one in a quarter of an hour to what no inertial sensor settles in."""

BAUD_RANGE = (50, 100_000_000)
"""Of a port, or bits/s of a bus: 50 is the lowest that serial ports know; the fastest adapters are below 50 Mbit/s."""
TEMPERATURE_RANGE_DEGC = (-100.0, 300.0)
"""Of an instrument that works: those for boreholes go to 225 degC."""
LONGEST_CLOSING_S = 30.0
"""Of a program that is to end: what is interrupted closes its files, which takes seconds on a busy machine."""
PORT_RANGE = (1024, 65535)
"""TCP ports that a program may take without rights of its own."""
