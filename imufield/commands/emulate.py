"""``imufield emulate``: a virtual instrument for other programs, on a port or a bus, until Ctrl-C."""

from __future__ import annotations

import json
import math
import re
import shlex
import sys
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any, get_args

import numpy as np

from imufield.acquire.protocol.toml import spell
from imufield.acquire.registry import driver_names, load_driver
from imufield.commands.options.acquire_commands import EmulateOptions
from imufield.commands.options.shared import one_of
from imufield.commands.terminal.output import echo, replace_only, say
from imufield.dataclass import fields
from imufield.deliver.parameters.printed_numbers import WIDTH, beside
from imufield.errors import UsageError
from imufield.files import read_small_file
from imufield.guide.positions import DEFAULT_SCHEME, REVISIT_FROM, named_direction, scheme
from imufield.limits import TEMPERATURE_RANGE_DEGC
from imufield.pipeline.chain import ROTATIONS
from imufield.progress import hidden
from imufield.sentences import Sentences, shell_word
from imufield.simulate.emulator.core import EmulatorCore, EmulatorSettings
from imufield.simulate.emulator.emulate import STIM300_RATES_HZ, TRUTH_FORMAT, Emulation, choose_wire, emulate
from imufield.simulate.emulator.faults import CanFaults, Faults, WireFaults
from imufield.simulate.truth.imu import ImuSettings
from imufield.simulate.truth.operator import NO_POSITION, OperatorSettings, StillKind, Visit

sentence = Sentences(__package__)

STANDS_STILL = "none"
STANDARD_INPUT = "-"
TYPED_HOLD_S = 0.5  # Who types a pose wants to see it.
INITIAL_STILL_S = 6.0
"""Before the first hold; the guide needs 3 s of it for the noise floor."""
SAFE_RATE_HZ = 8000.0
"""Samples in a second of real time that a machine of two cores makes, sends and reads; beyond it is told before."""
ROUNDS = 20
"""How often the operator goes through his positions: what a reader missed, or came too late for, comes up again."""


RAMP_DEGC_PER_MIN = 1.0
"""Half of what a ramp may do: an instrument in an insulating box warms about so fast."""


def run_emulate(options: EmulateOptions) -> None:
    """Emulate until the time is over or the user interrupts, telling the port first."""
    if options.truth is not None:
        replace_only(options.truth, TRUTH_FORMAT, "--truth", "the truth of an emulation")
    emulation = make_emulation(options)
    with hidden():
        emulator = emulate(
            emulation,
            on_start=lambda running: _announce(options, emulation, running),
            on_slow=lambda reached: _tell_slow(options, reached),
            on_left=lambda: None if options.as_json else say(sentence("emulate.left"), err=True),
        )
    if not options.as_json:
        echo(f"stopped after {emulator.samples_sent} samples")


def make_emulation(options: EmulateOptions) -> Emulation:
    """Turn the options of the command into those of the simulator.

    Raises
    ------
    UsageError
        If one is not known.
    """
    on_bus = options.bus is not None
    if not options.driver.endswith(".toml"):
        names = driver_names()
        if options.driver not in names:
            raise UsageError(sentence("emulate.no_emulator", driver=options.driver, names=names))
        on_bus = load_driver(options.driver).wire == "can"
    is_typed = str(options.poses) == STANDARD_INPUT and sys.stdin.isatty()
    style: StillKind = one_of("style", options.style, get_args(StillKind))
    if options.rotations is not None:
        one_of("rotations", options.rotations, tuple(ROTATIONS))
    positions = None if options.poses or options.positions == STANDS_STILL else scheme(options.positions)
    rounds = options.rounds or (ROUNDS if options.rotations is None else 1)
    # A long session ends with the first position again, as ``capture`` asks for it.
    order = [] if positions is None else [*range(len(positions))] * rounds + [0] * (len(positions) >= REVISIT_FROM)
    return Emulation(
        device=options.driver,
        rate_hz=options.rate_hz,
        grade=options.grade,
        seed=options.seed,
        day=options.day,
        directions=() if positions is None else positions.directions()[order],
        operator=OperatorSettings(
            style=style,
            hold_s=TYPED_HOLD_S if is_typed else options.hold_s,
            initial_still_s=INITIAL_STILL_S,
            begins_in_first_position=style == "placed",
            rotations=options.rotations,  # type: ignore[arg-type]  # checked above
        ),
        imu=_temperature_course(options.temperature),
        sends_temperature=options.temperature is not None,
        faults=parse_faults(options.faults or [], CanFaults if on_bus else Faults),
        run=EmulatorSettings(
            speed=options.speed, wait_for_reader=options.waits_for_reader, duration_s=options.duration_s, link=options.link
        ),
        truth=options.truth,
        form=options.form,
        settings=dict(options.settings),
        bus=options.bus,
        visits=_visits(options.poses) if options.poses else (),
    )


def _temperature_course(text: str | None) -> ImuSettings:
    """Read a temperature, or a ramp from one to another.

    Raises
    ------
    UsageError
        If it is neither, or goes where no instrument works.
    """
    if text is None:
        return ImuSettings()
    low, high = TEMPERATURE_RANGE_DEGC
    parts = text.split(":")
    try:
        degc = [float(part) for part in parts[:2]]
        degc_per_min = float(parts[2]) if len(parts) > 2 else RAMP_DEGC_PER_MIN
    except ValueError:
        degc, degc_per_min = [], math.nan
    is_course = degc and len(parts) <= 3 and all(low <= value <= high for value in degc) and 0 < degc_per_min < math.inf
    if not is_course:
        raise UsageError(sentence("emulate.temperature", text=text, low=low, high=high))
    slope_degc_s = math.copysign(degc_per_min / 60, degc[-1] - degc[0])
    return ImuSettings(temperature_degc=degc[0], temperature_slope_degc_s=slope_degc_s, temperature_end_degc=degc[-1])


def _visits(path: Path) -> Iterable[Visit]:
    """Return the poses of a file, or those that come on standard input while they come, where a wrong one is told."""
    if str(path) != STANDARD_INPUT:
        try:
            visits = [_visit(line) for line in read_small_file(path).decode().splitlines() if line.strip()]
        except (OSError, UnicodeError) as error:
            raise UsageError(sentence("emulate.no_poses", path=path, cause=getattr(error, "strerror", error))) from error
        if not visits:
            raise UsageError(sentence("emulate.empty_poses", path=path))
        return visits
    return _typed_visits()


def _typed_visits() -> Iterator[Visit]:
    # A file of its own: the program could not end while a thread waits for a line of sys.stdin.
    with open(sys.stdin.fileno(), closefd=False) as lines:
        for line in filter(str.strip, lines):
            try:
                yield _visit(line)
            except UsageError as error:
                say(error.message, err=True)


def _visit(line: str) -> Visit:
    """Read a pose: a position, or a turn about an axis of the unit in degrees."""
    if turn := re.fullmatch(r"\s*(roll|pitch|yaw)\s+([+-]?\d{1,3})\s*", line):
        axis = np.eye(3)[("roll", "pitch", "yaw").index(turn[1])]
        return Visit(NO_POSITION, axis, turn_rad=math.radians(int(turn[2])) * axis)
    return Visit(NO_POSITION, named_direction(line.strip()))


def parse_faults(texts: list[str], kind: type[WireFaults] = Faults) -> WireFaults:
    """Read faults of the form NAME=VALUE.

    Raises
    ------
    UsageError
        If a name is unknown on this kind of wire or a value no number.
    """
    known = {field.name for field in fields(kind)}
    values: dict[str, Any] = {}
    for text in texts:
        name, _, value = text.partition("=")
        try:
            number = float(value)
        except ValueError:
            # Refused below together with inf and nan, which float would take.
            number = math.nan
        if name not in known or not math.isfinite(number):
            raise UsageError(sentence("emulate.fault", text=text, known=sorted(known)))
        # A cable can be pulled several times; of every other fault the last one typed stands.
        values[name] = (*values.get(name, ()), number) if name == "disconnect_at_s" else number
    return kind(**values)


def _tell_slow(options: EmulateOptions, reached: float) -> None:
    if options.as_json:
        echo(json.dumps({"event": "slow", "speed": options.speed, "reached": reached}))
    else:
        say(sentence("emulate.slow", speed=options.speed, reached=reached), err=True)


def _slower(options: EmulateOptions, rate_hz: float) -> str:
    """Return the options that keep within ``SAFE_RATE_HZ``: the speed, or the fastest rate that the instrument has."""
    # Rounded down: what is given must be within the limit.
    words = [f"--speed {math.floor(100 * SAFE_RATE_HZ / rate_hz) / 100:g}"]
    rates_hz = STIM300_RATES_HZ if options.driver == "stim300" else ()
    words += [f"--rate-hz {max(slow):g}"] if (slow := [r for r in rates_hz if r * options.speed <= SAFE_RATE_HZ]) else []
    return " or ".join(words)


def _announce(options: EmulateOptions, emulation: Emulation, emulator: EmulatorCore) -> None:
    wire = choose_wire(emulation)
    rate_hz = wire.rate_hz
    kind = "bus" if wire.form is None else "port"
    address = emulator.address if wire.form is None else str(options.link or emulator.address)
    if options.as_json:
        facts = {"event": "started", kind: address, "driver": options.driver, "rate_hz": rate_hz, "speed": options.speed}
        echo(json.dumps(facts | {"settings": wire.settings}))
        return
    form = f" ({wire.form.name})" if wire.form and wire.form.name not in ("", "default") else ""
    echo(beside(f"{options.driver}{form} at {rate_hz:.0f} Hz, {options.speed:g} times real time, on", address))
    # Slower than real time the host needs no other clock.
    clock = [] if options.speed <= 1 else [f"--clock-speed {options.speed:g}"]
    # The right place matters: the scale of the accelerometer is as good as the gravity it is given, which is that of height 0.
    place = f"--latitude {emulation.site.latitude_deg:g} --height 0"
    # A protocol file of the user's own is no driver that another command knows by name.
    which = f"{'--driver' if wire.driver else '--protocol'} {shell_word(options.driver)}"
    # A guide that asks for other positions than the operator turns to would wait for ever.
    known = options.poses or options.positions in (STANDS_STILL, DEFAULT_SCHEME)
    asked = [] if known else [f"--positions {shell_word(options.positions)}"]
    told = [f"--set {shlex.quote(f'{name}={spell(value)}')}" for name, value in wire.settings.items()]
    if options.truth is not None:
        echo(beside("truth in", options.truth))
    echo("read it with:")
    # Folded as a shell reads it, between options alone: broken by a terminal it cannot be copied.
    lines = ["  imufield capture"]
    for option in (f"--{kind} {shell_word(address)}", which, *asked, *told, place, *clock):
        fits = len(f"{lines[-1]} {option} \\") <= WIDTH
        lines[-1:] = [f"{lines[-1]} {option}"] if fits else [lines[-1], f"    {option}"]
    echo(" \\\n".join(lines))
    if rate_hz * options.speed > SAFE_RATE_HZ:
        remedies = _slower(options, rate_hz)
        say(sentence("emulate.fast", rate_hz=rate_hz * options.speed, limit=SAFE_RATE_HZ, remedies=remedies), err=True)
    waits = "it begins when a program opens the port; " if options.waits_for_reader and kind == "port" else ""
    asks = "type poses, e.g. +x or z+135 or roll 30; " if str(options.poses) == STANDARD_INPUT else ""
    say(f"{waits}{asks}Ctrl-C ends it")
