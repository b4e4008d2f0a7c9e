"""The virtual instrument as the command runs it: options in, a port, the truth in a file for comparison."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
import tomli_w
from numpy.typing import ArrayLike

from imufield import __version__
from imufield.earth import STANDARD_GRAVITY_M_S2
from imufield.errors import UsageError
from imufield.files import write_atomically
from imufield.simulate.devices import Device, Stim300Device, TextDevice
from imufield.simulate.emulator import Emulator, EmulatorSettings, VirtualImu
from imufield.simulate.encode import ACCELEROMETER_BITS, Stim300Format, TextFormat
from imufield.simulate.faults import Faults
from imufield.simulate.grades import Grade, draw_truth, find_grade
from imufield.simulate.imu import Imu, ImuSettings
from imufield.simulate.motion import Site
from imufield.simulate.operator import Operator, OperatorSettings

TRUTH_FORMAT = "imufield-truth"
TRUTH_VERSION = 1

DeviceName = Literal["stim300", "text"]
_DEFAULT_RATE_HZ = {"stim300": 2000.0, "text": 100.0}
_STIM300_RATES_HZ = (125.0, 250.0, 500.0, 1000.0, 2000.0)


@dataclass(frozen=True, slots=True)
class EmulateOptions:
    """What to emulate."""

    device: DeviceName = "stim300"
    rate_hz: float | None = None
    """None: the device's default, 2000 Hz for a STIM300 and 100 Hz for text."""
    grade: str = "tactical"
    seed: int = 0
    directions: ArrayLike = ()
    """Directions of "up" in the body frame that the operator goes through, shape (m, 3); none: it lies on a table."""
    operator: OperatorSettings = field(default_factory=OperatorSettings)
    site: Site = field(default_factory=Site)
    imu: ImuSettings = field(default_factory=ImuSettings)
    """The rate in it is not used."""
    faults: Faults = field(default_factory=Faults)
    run: EmulatorSettings = field(default_factory=EmulatorSettings)
    stim300: Stim300Format | None = None
    """None: accelerometer, inclinometer, CR LF and the smallest range that holds the grade's."""
    text: TextFormat = field(default_factory=TextFormat)
    truth: Path | None = None
    """File for the truth, TOML or (by its suffix) JSON."""


def make_virtual_imu(options: EmulateOptions) -> VirtualImu:
    """Return the instrument and its operator, drawn from the seed."""
    grade = find_grade(options.grade)
    instrument = draw_truth(grade, np.random.default_rng([options.seed, 401]))
    rate_hz = options.rate_hz or _DEFAULT_RATE_HZ[options.device]
    operator = Operator(options.directions, options.seed, options.operator, options.site)
    return VirtualImu(Imu(instrument, options.seed, replace(options.imu, rate_hz=rate_hz)), operator)


def make_emulator(options: EmulateOptions) -> Emulator:
    """Return the emulator, not yet started; ``write_truth(options, emulator.source)`` tells what is true.

    Raises
    ------
    UsageError
        If a value of the options makes no sense.
    """
    source = make_virtual_imu(options)
    device = _make_device(options, source.imu.instrument.grade, source.imu.settings.rate_hz)
    progress = _TruthKeeper(options, source) if options.truth is not None else None
    return Emulator(device, source, options.run, faults=options.faults, seed=options.seed, on_progress=progress)


def emulate(options: EmulateOptions, on_start: Callable[[Emulator], None] | None = None) -> Emulator:
    """Run a virtual instrument until its time is over; Ctrl-C ends it too and is passed on.

    Parameters
    ----------
    options : EmulateOptions
    on_start : callable, optional
        Called with the running emulator, which knows its port.

    Returns
    -------
    Emulator
        The stopped one, for its counts.
    """
    with make_emulator(options) as emulator:
        if on_start is not None:
            on_start(emulator)
        # A wait without limit would not let Ctrl-C through on every system.
        while not emulator.wait(0.5):
            pass
    if emulator.failure is not None:
        raise emulator.failure
    return emulator


def truth_document(options: EmulateOptions, source: VirtualImu) -> dict[str, Any]:
    """Return the truth as plain values; times are on the sample clock, which is 0 at the first sample.

    ``mean_drift`` is what the slow drift added to the bias on average so far; a calibration sees the sum.
    """
    instrument, settings = source.imu.instrument, source.imu.settings
    drift = source.imu.mean_drift.tolist()
    return {
        "format": TRUTH_FORMAT,
        "version": TRUTH_VERSION,
        "software": f"imufield {__version__}",
        "device": options.device,
        "grade": options.grade,
        "seed": options.seed,
        "rate_hz": settings.rate_hz,
        "true_rate_hz": 1 / source.interval_s,
        "clock_error_ppm": instrument.clock_error_ppm,
        "triad_delay_s": instrument.triad_delay_s,
        "site": asdict(options.site),
        "accelerometer": {
            "raw_unit": instrument.grade.units.accelerometer,
            **_plain(instrument.accelerometer),
            "mean_drift_m_s2": drift[:3],
        },
        "gyroscope": {
            "raw_unit": instrument.grade.units.gyroscope,
            **_plain(instrument.gyroscope),
            "mean_drift_rad_s": drift[3:],
        },
        "still": [_timed(still, source.imu) for still in source.operator.stills],
        "move": [_timed(move, source.imu) for move in source.operator.moves],
    }


def write_truth(options: EmulateOptions, source: VirtualImu) -> None:
    """Write the truth known so far to ``options.truth``."""
    if options.truth is None:
        return
    document = truth_document(options, source)
    text = json.dumps(document, indent=1) if options.truth.suffix == ".json" else tomli_w.dumps(document)
    write_atomically(options.truth, text.encode())


class _TruthKeeper:
    """Writes the truth at the start and whenever the operator has planned further."""

    def __init__(self, options: EmulateOptions, source: VirtualImu) -> None:
        self._options, self._source = options, source
        self._written: tuple[object, ...] = ()

    def __call__(self) -> None:
        stills = self._source.operator.stills
        known = (len(stills), stills[-1].end_s)
        if known != self._written:
            self._written = known
            write_truth(self._options, self._source)


def _make_device(options: EmulateOptions, grade: Grade, rate_hz: float) -> Device:
    if options.device == "text":
        return TextDevice(options.text)
    if rate_hz not in _STIM300_RATES_HZ:
        raise UsageError(
            f"sample rate {rate_hz:g} Hz is not one of a STIM300's; choose 125, 250, 500, 1000 or 2000 Hz", rate_hz=rate_hz
        )
    if options.stim300 is not None:
        return Stim300Device(replace(options.stim300, rate_hz=rate_hz))
    range_g = grade.accelerometer.range_si / STANDARD_GRAVITY_M_S2
    fitting = [held for held in ACCELEROMETER_BITS if held >= round(range_g, 6)]
    return Stim300Device(Stim300Format(rate_hz=rate_hz, accelerometer_range_g=min(fitting)))


def _plain(record: Any) -> dict[str, Any]:
    values = asdict(record)
    return {name: value.tolist() if isinstance(value, np.ndarray) else value for name, value in values.items()}


def _timed(record: Any, imu: Imu) -> dict[str, Any]:
    """Return an interval with its times on the sample clock; ``end_s`` is left out while it is not known."""
    values = _plain(record)
    values["start_s"] = imu.to_sample_clock(record.start_s)
    values["end_s"] = imu.to_sample_clock(record.end_s)
    if math.isinf(record.end_s):
        del values["end_s"]
    return values
