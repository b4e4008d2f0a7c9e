"""``imufield emulate``: a virtual instrument for other programs, until Ctrl-C."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, get_args

import typer

from imufield.commands.capture import REVISIT_FROM
from imufield.errors import UsageError
from imufield.guide.positions import scheme
from imufield.simulate.emulate import DeviceName, emulate, make_virtual_imu
from imufield.simulate.emulate import EmulateOptions as Emulation
from imufield.simulate.emulator import Emulator, EmulatorSettings
from imufield.simulate.faults import Faults
from imufield.simulate.operator import OperatorSettings

STANDS_STILL = "none"
INITIAL_STILL_S = 6.0
"""Before the first hold; the guide needs 3 s of it for the noise floor."""


@dataclass(frozen=True, slots=True)
class EmulateOptions:
    """Options of the command."""

    driver: str
    rate_hz: float | None
    speed: float
    grade: str
    seed: int
    positions: str
    hold_s: float
    link: Path | None
    truth: Path | None
    duration_s: float | None
    faults: list[str]
    wait_for_reader: bool
    style: str
    as_json: bool


def run_emulate(options: EmulateOptions) -> None:
    """Emulate until the time is over or the user interrupts, telling the port first."""
    emulation = make_emulation(options)
    emulator = emulate(emulation, on_start=lambda running: _announce(options, emulation, running))
    if not options.as_json:
        typer.echo(f"stopped after {emulator.samples_sent} samples")


def make_emulation(options: EmulateOptions) -> Emulation:
    """Turn the options of the command into those of the simulator.

    Raises
    ------
    UsageError
        If one is not known.
    """
    if options.driver not in get_args(DeviceName):
        raise UsageError(f"there is no emulator for {options.driver!r}; choose one of {', '.join(get_args(DeviceName))}")
    if options.style not in ("placed", "held"):
        raise UsageError(f"--style {options.style!r} is neither placed nor held")
    positions = None if options.positions == STANDS_STILL else scheme(options.positions)
    # A long session ends with the first position again, as ``capture`` asks for it.
    directions = () if positions is None else positions.directions()[_order(len(positions))]
    return Emulation(
        device=options.driver,  # type: ignore[arg-type]  # checked above
        rate_hz=options.rate_hz,
        grade=options.grade,
        seed=options.seed,
        directions=directions,
        operator=OperatorSettings(
            style=options.style,  # type: ignore[arg-type]  # checked above
            hold_s=options.hold_s,
            initial_still_s=INITIAL_STILL_S,
            begins_in_first_position=options.style == "placed",
        ),
        faults=parse_faults(options.faults),
        run=EmulatorSettings(
            speed=options.speed, wait_for_reader=options.wait_for_reader, duration_s=options.duration_s, link=options.link
        ),
        truth=options.truth,
    )


def _order(count: int) -> list[int]:
    return [*range(count), *([0] if count >= REVISIT_FROM else [])]


def parse_faults(texts: list[str]) -> Faults:
    """Read faults of the form NAME=VALUE.

    Raises
    ------
    UsageError
        If a name is unknown or a value no number.
    """
    known = {field.name for field in fields(Faults)}
    values: dict[str, Any] = {}
    for text in texts:
        name, _, value = text.partition("=")
        try:
            number = float(value)
        except ValueError:
            number = math.nan
        if name not in known or not math.isfinite(number):
            raise UsageError(f"--fault {text!r} is not of the form NAME=NUMBER with a name of {', '.join(sorted(known))}")
        values[name] = (number,) if name == "disconnect_at_s" else number
    return Faults(**values)


def _announce(options: EmulateOptions, emulation: Emulation, emulator: Emulator) -> None:
    rate_hz = options.rate_hz or 1 / make_virtual_imu(emulation).interval_s
    port = str(options.link or emulator.port)
    if options.as_json:
        facts = {"event": "started", "port": port, "driver": options.driver, "rate_hz": rate_hz, "speed": options.speed}
        typer.echo(json.dumps(facts))
        return
    typer.echo(f"{options.driver} at {rate_hz:.0f} Hz, {options.speed:g} times real time, on {port}")
    clock = "" if options.speed == 1 else f"IMUFIELD_CLOCK_SPEED={max(options.speed, 1):g} "
    # The right latitude matters: the scale of the accelerometer is as good as the gravity it is given.
    typer.echo(f"read it with:  {clock}imufield capture --port {port} --latitude {emulation.site.latitude_deg:g}")
    typer.echo("Ctrl-C ends it")
