"""A virtual instrument from its options: what it sends, who moves it, its port, and a file with the truth."""

from __future__ import annotations

import json
import math
import threading
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import tomli_w
from numpy.typing import ArrayLike

from imufield.acquire.driver import Driver
from imufield.acquire.protocol.protocol import Protocol, load_protocol
from imufield.acquire.recording.session_record import plain_record, plain_table
from imufield.acquire.registry import load_driver
from imufield.dataclass import asdict, dataclass, field, replace
from imufield.earth import STANDARD_GRAVITY_M_S2
from imufield.errors import UsageError
from imufield.files import typed_write_errors, write_atomically
from imufield.sentences import Sentences
from imufield.simulate.emulator.core import EmulatorCore, EmulatorSettings
from imufield.simulate.emulator.faults import CanFaults, Faults, WireFaults
from imufield.simulate.emulator.serial import Emulator
from imufield.simulate.instruments.aceinna import AceinnaInstrument
from imufield.simulate.instruments.device import Device
from imufield.simulate.instruments.microstrain import MicroStrainInstrument
from imufield.simulate.instruments.protocol_device import InProtocolUnits, ProtocolDevice
from imufield.simulate.instruments.scripted import ScriptedInstrument
from imufield.simulate.instruments.stim300 import Stim300Device, Stim300Identity
from imufield.simulate.instruments.vectornav import VectorNavInstrument
from imufield.simulate.instruments.witmotion import WitMotionInstrument
from imufield.simulate.instruments.xsens import XsensInstrument
from imufield.simulate.truth.grades import REFERENCE_TEMPERATURE_DEGC, draw_truth, find_grade
from imufield.simulate.truth.imu import Imu, ImuSettings
from imufield.simulate.truth.motion import Site
from imufield.simulate.truth.operator import Operator, OperatorSettings, StillInterval, TrueMove, Visit
from imufield.simulate.truth.virtual_imu import SampleSource, VirtualImu
from imufield.simulate.wire.forms import DEFAULT_RATE_HZ, WireForm, choose_form
from imufield.simulate.wire.stim300 import ACCELEROMETER_BITS, Stim300Format
from imufield.version import __version__

sentence = Sentences(__package__)

TRUTH_FORMAT = "imufield-truth"
TRUTH_VERSION = 1

OWN_RATE_HZ = {"stim300": 2000.0}
"""Usual rates of instruments with a device class of their own; those of the others are in their protocols."""
SCRIPTS: Mapping[str, Callable[[float, WireForm], ScriptedInstrument]] = {
    "aceinna_serial": AceinnaInstrument,
    "microstrain_mip": MicroStrainInstrument,
    "vectornav_ascii": VectorNavInstrument,
    "vectornav_binary": VectorNavInstrument,
    "witmotion": WitMotionInstrument,
    "xsens_mtdata2": XsensInstrument,
}
"""What instruments answer, by driver; a STIM300 does so by its device class, the others take no commands."""
DEFAULT_BUS = "slcan"
_OWN_FORM = WireForm("", 0.0, {}, ())
STIM300_RATES_HZ = (125.0, 250.0, 500.0, 1000.0, 2000.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class Emulation:
    """What to emulate."""

    device: str = "stim300"
    """Name of a driver, or path of a protocol file of the user."""
    rate_hz: float | None = None
    """None: the usual one of the instrument, 2000 Hz for a STIM300 and 100 Hz for text."""
    grade: str = "tactical"
    seed: int = 0
    directions: ArrayLike = ()
    """Directions of "up" in the body frame that the operator goes through, shape (m, 3); empty: the unit stays on a table."""
    operator: OperatorSettings = field(default_factory=OperatorSettings)
    site: Site = field(default_factory=Site)
    imu: ImuSettings = field(default_factory=ImuSettings)
    """The rate in it is not used."""
    faults: WireFaults = field(default_factory=Faults)
    run: EmulatorSettings = field(default_factory=EmulatorSettings)
    sends_temperature: bool = False
    """Of a STIM300; others do as their form says."""
    truth: Path | None = None
    """File for the truth, TOML or (by its suffix) JSON."""
    form: str | None = None
    """Which of the forms that the protocol lists to send; None: the first that agrees with the settings."""
    settings: Mapping[str, object] = field(default_factory=dict)
    """Of the protocol."""
    bus: str | None = None
    """Of an instrument on CAN; None: an adapter on a pseudo-terminal."""
    day: int = 0
    """Of the same instrument: on each its noise, drift, operator and faults are others."""
    visits: Iterable[Visit] = ()
    """What the operator does behind ``directions``; may wait for somebody who says it."""


@dataclass(frozen=True, slots=True, kw_only=True)
class WireChoice:
    """How an instrument is run on its wire."""

    protocol: Protocol
    rate_hz: float
    form: WireForm | None
    """None on a CAN bus."""
    settings: dict[str, object]
    """What a reader must be told."""
    driver: type[Driver] | None
    """None for a protocol file of the user."""


def choose_wire(options: Emulation) -> WireChoice:
    """Return what goes on the wire.

    Raises
    ------
    ProtocolError
        If there is no such driver or protocol, or a setting is not allowed.
    UsageError
        If there is no such form.
    """
    driver = None if options.device.endswith(".toml") else load_driver(options.device)

    def load(settings: Mapping[str, object]) -> Protocol:
        return load_protocol(options.device, settings) if driver is None else driver.load_protocol(settings)

    def told_hz(settings: Mapping[str, object]) -> float:
        return load(settings).clock.rate_hz if "rate_hz" in settings else 0.0

    base = load({})
    form: WireForm | None
    if base.can is not None or options.device in OWN_RATE_HZ:
        if options.form is not None:
            raise UsageError(sentence("emulate.one_form", device=options.device, form=options.form))
        form = None if base.can is not None else _OWN_FORM
        told = dict(options.settings)
        rate_hz = options.rate_hz or told_hz(told) or OWN_RATE_HZ.get(options.device, DEFAULT_RATE_HZ)
        # Increments are nothing without their rate, which a reader must be told, too.
        if "increment" in told.values():
            told.setdefault("rate_hz", rate_hz)
        protocol = load(told)
    else:
        form = choose_form(base, options.form, options.settings)
        settings: dict[str, object] = {**form.settings, **options.settings}
        defaults = {name: setting.value for name, setting in base.settings.items()}
        rate_hz = options.rate_hz or told_hz(settings) or form.rate_hz
        # A reader measures the rate; increments need it said.
        if "rate_hz" in defaults and "rate_hz" not in settings:
            settings["rate_hz"] = rate_hz
        protocol = load(settings)
        by_increment = protocol.units.accelerometer_is_increment or protocol.units.gyroscope_is_increment
        # A counter of lines tells the time by the rate alone.
        counts_by_rate = protocol.lines is not None and "counter" in protocol.lines.columns
        told = {
            name: value
            for name, value in settings.items()
            if str(defaults.get(name)) != str(value) and (name != "rate_hz" or by_increment or counts_by_rate)
        }
    return WireChoice(protocol=protocol, rate_hz=rate_hz, form=form, settings=told, driver=driver)


def make_virtual_imu(options: Emulation, rate_hz: float | None = None) -> VirtualImu:
    """Return the instrument of the seed and its operator of the day; ``rate_hz`` is the wire's where options have none."""
    grade = find_grade(options.grade)
    instrument = draw_truth(grade, np.random.default_rng([options.seed, 401]))
    rate_hz = options.rate_hz or rate_hz or OWN_RATE_HZ[options.device]
    seed = session_seed(options)
    operator = Operator(options.directions, seed, options.operator, options.site)
    return VirtualImu(Imu(instrument, seed, replace(options.imu, rate_hz=rate_hz)), operator)


def session_seed(options: Emulation) -> int:
    """Return the seed of what is another on each day."""
    if options.day == 0:
        return options.seed
    return int(np.random.SeedSequence([options.seed, 402, options.day]).generate_state(1, np.uint64)[0])


def make_emulator(options: Emulation) -> EmulatorCore:
    """Return the emulator, not yet started: a ``CanEmulator`` for an instrument on a bus, else an ``Emulator``.

    Raises
    ------
    UsageError
        If a value of the options makes no sense.
    ProtocolError
        If there is no such driver or protocol.
    """
    wire = choose_wire(options)
    virtual = make_virtual_imu(options, wire.rate_hz)
    grade = virtual.imu.instrument.grade
    source: SampleSource = virtual
    if options.device not in OWN_RATE_HZ:
        scale = (grade.accelerometer_scale, grade.gyroscope_scale)
        source = InProtocolUnits(virtual, scale, wire.protocol, wire.rate_hz)
    seed = session_seed(options)
    threading.Thread(target=_lead, args=(virtual.operator, options.visits), daemon=True).start()
    emulator: EmulatorCore
    if wire.form is not None:
        device = make_device(options, wire)
        if options.bus is not None:
            raise UsageError(sentence("emulate.no_bus", device=options.device), bus=options.bus)
        if not isinstance(options.faults, Faults):
            raise UsageError(sentence("emulate.faults_of_frames", device=options.device))
        emulator = Emulator(device, source, options.run, faults=options.faults, seed=seed)
    else:
        # Imported here: python-can takes longer to load than all the rest, and a serial line does not need it.
        from imufield.simulate.emulator.can import CanEmulator

        # The default of the options is no fault at all, on whatever wire.
        faults = CanFaults() if options.faults == Faults() else options.faults
        if not isinstance(faults, CanFaults):
            raise UsageError(sentence("emulate.faults_of_bytes", device=options.device))
        bus = options.bus or DEFAULT_BUS
        emulator = CanEmulator(wire.protocol, source, bus, options.run, faults=faults, seed=seed)
    if options.truth is not None:
        emulator.on_progress = _truth_writer(options, virtual, options.truth)
    return emulator


def _lead(operator: Operator, visits: Iterable[Visit]) -> None:
    for visit in visits:
        operator.show(visit)


def emulate(
    options: Emulation,
    on_start: Callable[[EmulatorCore], None] | None = None,
    on_slow: Callable[[float], None] | None = None,
    on_left: Callable[[], None] = lambda: None,
) -> EmulatorCore:
    """Run a virtual instrument until its time is over; Ctrl-C ends it too and is passed on.

    Parameters
    ----------
    options : Emulation
    on_start : callable, optional
        Called with the running emulator, which knows its address.
    on_slow : callable, optional
        Called once with the speed that is reached where it stays below the one asked for.
    on_left : callable
        Called each time a host has closed the port.

    Returns
    -------
    EmulatorCore
        The stopped one, for its counts.
    """
    with make_emulator(options) as emulator:
        if on_start is not None:
            on_start(emulator)
        was_read = False
        # A wait without limit would not let Ctrl-C through on every system.
        while not emulator.wait(0.5):
            before, was_read = was_read, emulator.is_read
            if before and not was_read:
                on_left()
            if on_slow is not None and emulator.pace.reached is not None:
                on_slow(emulator.pace.reached)
                on_slow = None
    if emulator.failure is not None:
        raise emulator.failure
    return emulator


def truth_document(options: Emulation, source: VirtualImu) -> dict[str, object]:
    """Return the truth as plain values; times are on the sample clock, which is 0 at the first sample.

    ``mean_drift`` is what the slow drift added to the bias on average so far; a calibration sees the sum.
    """
    imu, operator = source.imu, source.operator
    instrument, units = imu.instrument, imu.instrument.grade.units
    drift = imu.mean_drift.tolist()
    return {
        "format": TRUTH_FORMAT,
        "version": TRUTH_VERSION,
        "software": f"imufield {__version__}",
        "device": options.device,
        "grade": options.grade,
        "seed": options.seed,
        "day": options.day,
        "rate_hz": imu.settings.rate_hz,
        "true_rate_hz": 1 / source.interval_s,
        "clock_error_ppm": instrument.clock_error_ppm,
        "triad_delay_s": instrument.triad_delay_s,
        "site": asdict(options.site),
        "accelerometer": {
            "raw_unit": units.accelerometer,
            **plain_record(instrument.accelerometer),
            "mean_drift_m_s2": drift[:3],
            "bias_m_s2_per_degc": instrument.accelerometer_bias_per_degc.tolist(),
            "scale_per_degc": instrument.accelerometer_scale_per_degc.tolist(),
        },
        "gyroscope": {
            "raw_unit": units.gyroscope,
            **plain_record(instrument.gyroscope),
            "mean_drift_rad_s": drift[3:],
            "bias_rad_s_per_degc": instrument.gyroscope_bias_per_degc.tolist(),
            "scale_per_degc": instrument.gyroscope_scale_per_degc.tolist(),
        },
        "reference_temperature_degc": REFERENCE_TEMPERATURE_DEGC,
        "still": [_timed(still, imu) for still in operator.stills],
        "move": [_timed(move, imu) for move in operator.moves],
    }


def _timed(record: StillInterval | TrueMove, imu: Imu) -> dict[str, object]:
    """Return an interval with its times on the sample clock; ``end_s`` is left out while it is not known."""
    end_s = None if math.isinf(record.end_s) else imu.to_sample_clock(record.end_s)
    return plain_table({**asdict(record), "start_s": imu.to_sample_clock(record.start_s), "end_s": end_s})


def _truth_writer(options: Emulation, source: VirtualImu, path: Path) -> Callable[[], None]:
    """Return what writes the truth at the start and whenever the operator has planned further."""
    written: tuple[int, float] | None = None

    def write() -> None:
        nonlocal written
        stills = source.operator.stills
        known = (len(stills), stills[-1].end_s)
        if known != written:
            written = known
            document = truth_document(options, source)
            text = json.dumps(document, indent=1) if path.suffix == ".json" else tomli_w.dumps(document)
            with typed_write_errors(path):
                write_atomically(path, text.encode())

    return write


def make_device(options: Emulation, wire: WireChoice) -> Device:
    """Return the instrument on a serial line, without port or samples.

    Raises
    ------
    UsageError
        If it has not the rate.
    """
    form, rate_hz, device = wire.form or _OWN_FORM, wire.rate_hz, options.device
    if device not in OWN_RATE_HZ:
        script = SCRIPTS.get(device)
        return ProtocolDevice(wire.protocol, form, rate_hz, None if script is None else script(rate_hz, form))
    # Values as the protocol has read them, which a format of the same names takes.
    chosen: dict[str, Any] = {name: wire.protocol.settings[name].value for name in options.settings if name != "rate_hz"}
    if rate_hz not in STIM300_RATES_HZ:
        raise UsageError(sentence("emulate.rate", rate_hz=rate_hz, rates_hz=STIM300_RATES_HZ))
    identity = Stim300Identity.of_seed(options.seed, options.grade)
    # The smallest range that holds the grade's: a step of the wire is as fine as the instrument allows.
    grade_g = round(find_grade(options.grade).accelerometer.range_si / STANDARD_GRAVITY_M_S2, 6)
    range_g = min(range_g for range_g in ACCELEROMETER_BITS if range_g >= grade_g)
    usual = Stim300Format(rate_hz=rate_hz, accelerometer_range_g=range_g, temperature=options.sends_temperature)
    settings = replace(usual, **chosen)
    return Stim300Device(settings, identity)
