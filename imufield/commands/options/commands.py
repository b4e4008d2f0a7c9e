"""The options of each command: to get samples, to turn them into numbers, to carry the numbers to where they are used."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal, get_args

from imufield.commands.configuration import parse_zero
from imufield.commands.options import completion
from imufield.commands.options.shared import (
    LARGEST_SEED,
    AsJson,
    ClockSpeed,
    ConnectionOptions,
    DriverName,
    EventsAsJson,
    MethodSettings,
    NewestSession,
    PlaceOptions,
    Plain,
    Port,
    PortOrBusOptions,
    Scheduler,
    SessionFolder,
    Settings,
    SignalMap,
    TableRateHz,
    TargetBiasUg,
    TargetScalePpm,
    Workers,
    argument,
    option,
    session_argument,
    unknown_site,
)
from imufield.errors import UsageError
from imufield.files import DEFAULT_ROOT
from imufield.limits import BAUD_RANGE, HOLD_RANGE_S, RATE_RANGE_HZ
from imufield.sentences import Sentences

if TYPE_CHECKING:
    from imufield.pipeline.calibration import SolveSettings

sentence = Sentences(__package__)

ViewName = Literal["auto", "plain", "json"]
ParameterFile = Annotated[Path, session_argument(help="Parameter file.")]
# Signs are part of the name: `--cable=-x` needs its equals sign, or the parser takes -x for an option.
SIDES = ("+x", "-x", "+y", "-y", "+z", "-z")


def _check_side(text: str | None) -> str | None:
    if text is not None and text not in SIDES:
        raise UsageError(sentence("commands.cable", text=text, sides=SIDES))
    return text


@dataclass(frozen=True, slots=True, kw_only=True)
class DemoOptions:
    """Run the whole chain with no hardware: virtual IMU and operator, capture, solve.

    Example: imufield demo
    """

    seed: Annotated[int, option(help="Seed of the simulated instrument and operator.", low=0, high=LARGEST_SEED)] = 2
    speed: Annotated[float, option(help="Speed relative to real time, e.g. 8 is eight times as fast.", low=1)] = (
        8.0  # What a small machine keeps up with.
    )
    plain: Plain = False
    root: Path = DEFAULT_ROOT


@dataclass(frozen=True, slots=True, kw_only=True)
class DevicesOptions:
    """List serial ports, CAN interfaces and the instruments that have a driver, or show one of them.

    Example: imufield devices

    Example: imufield devices stim300
    """

    name: Annotated[
        str | None,
        argument(help="Instrument to show, with its settings and wiring.", autocompletion=completion.drivers),
    ] = None
    as_json: AsJson = False


@dataclass(frozen=True, slots=True, kw_only=True)
class InitOptions:
    """Write imufield.toml, the defaults of this folder: place, instrument, port and accuracy, asked for at a terminal.

    Example: imufield init

    Example: imufield init --latitude 48.1 --height 520 --driver stim300
    """

    site: PlaceOptions = field(default_factory=unknown_site)
    driver: DriverName = None
    port: Port = None
    target_bias_ug: TargetBiasUg = None
    target_scale_ppm: TargetScalePpm = None
    root: Path = DEFAULT_ROOT


@dataclass(frozen=True, slots=True, kw_only=True)
class ProbeOptions:
    """Listen and say what instrument is on a port (default: on every port) or a CAN bus, and how to read it.

    Example: imufield probe --port /dev/ttyUSB0

    Example: imufield probe --bus socketcan:can0
    """

    connect: PortOrBusOptions
    # Off: an unknown device at the port may take a question for a command.
    ask: Annotated[bool, option("--ask", help="Ask the instrument who it is: the only thing that is sent.")] = False
    as_json: AsJson = False
    clock_speed: ClockSpeed = 1.0


@dataclass(frozen=True, slots=True, kw_only=True)
class CaptureOptions:
    """Record a guided session: the screen leads you through 24 positions, without a key press.

    Example: imufield capture --port /dev/ttyUSB0 --latitude 48.1 --height 520
    """

    connect: ConnectionOptions
    positions: Annotated[str | None, option(help="Scheme: paper24, paper36, corners24, all26, faces6 or a TOML list.")] = None
    hold_s: Annotated[float | None, option(help="Seconds to hold each position.", within=HOLD_RANGE_S)] = None
    session: SessionFolder = None
    resume: Annotated[bool, option("--resume", help="Go on with an unfinished session.")] = False
    site: PlaceOptions = field(default_factory=unknown_site)
    plain: Plain = False
    as_json: EventsAsJson = False
    target_bias_ug: TargetBiasUg = None
    target_scale_ppm: TargetScalePpm = None
    preset: Annotated[
        Path | None, option(help="Previous parameter file; comparison with its scale reveals a wrong latitude or gravity.")
    ] = None
    rotations: Annotated[
        str | None, option(help="Whole turns for the gyroscope: rolled (edge over edge) or table (against a stop).")
    ] = None
    quiet: Annotated[bool, option("--quiet", help="No sound.")] = False
    speak: Annotated[bool, option("--speak", help="Say it aloud, where a speech program is installed.")] = False
    big: Annotated[bool, option("--big", help="Big letters, to be read from three metres.")] = False
    cable: Annotated[
        str | None, option(help="Side of the unit where the cable leaves, for the pictures: +x ... -z.", check=_check_side)
    ] = None
    clock_speed: ClockSpeed = 1.0
    root: Path = DEFAULT_ROOT

    @property
    def view(self) -> ViewName:
        """What shows the events; "auto" is pictures where there is a terminal."""
        return "json" if self.as_json else "plain" if self.plain else "auto"


@dataclass(frozen=True, slots=True, kw_only=True)
class SessionsOptions:
    """List sessions, the newest first: when, how complete, the verdict, the instrument.

    Example: imufield sessions --find "stim300 usable"
    """

    folder: Annotated[Path, argument(help="Folder of sessions.")] = DEFAULT_ROOT
    find: Annotated[str | None, option(help="Only those that show all these words, e.g. 2026-03 or unfinished.")] = None
    as_json: AsJson = False


@dataclass(frozen=True, slots=True, kw_only=True)
class RecordOptions:
    """Record without a guide, e.g. hours of standstill.

    Example: imufield record --port /dev/ttyUSB0 --duration-s 3600

    Example: imufield record --bus socketcan:can0 --driver aceinna_can
    """

    connect: ConnectionOptions
    session: SessionFolder = None
    site: PlaceOptions = field(default_factory=unknown_site)
    duration_s: Annotated[float | None, option(help="Stop after so many seconds (default: Ctrl-C).", low=0.1)] = None
    as_json: AsJson = False
    clock_speed: ClockSpeed = 1.0
    root: Path = DEFAULT_ROOT


@dataclass(frozen=True, slots=True, kw_only=True)
class ImportOptions:
    """Turn files of another program into a session: tables, MATLAB, HDF5, Parquet, ROS, CAN logs, raw bytes.

    Example: imufield import acc.txt.gz gyro.txt.gz --zero 32768 -o my-session

    Example: imufield import drive.blf --driver aceinna_can
    """

    files: Annotated[list[Path], argument(help="Files of one recording; several are joined by time.")]
    output: Annotated[Path | None, option("-o", "--output", help="Folder of the new session.")] = None
    driver: DriverName = None
    # A name or a file: shipped protocols have names.
    protocol: Annotated[str | None, option(help="For a raw byte dump: protocol name or TOML file.")] = None
    dbc: Annotated[Path | None, option(help="For a log of a CAN bus: DBC file.")] = None
    mapping: SignalMap = field(default_factory=dict)
    channel: Annotated[str | None, option(help="For a log of several CAN buses: which, e.g. can0.")] = None
    topic: Annotated[str | None, option(help="For a recording of ROS: which topic, e.g. /imu/data.")] = None
    settings: Settings = field(default_factory=dict)
    columns: Annotated[str | None, option(help="Columns of a table, e.g. time,ax,ay,az,gx,gy,gz.")] = None
    rate_hz: TableRateHz = None
    zero: Annotated[str | None, option(help="Raw output at zero input, one or three numbers (mid-scale).")] = None
    site: PlaceOptions = field(default_factory=unknown_site)
    replace: Annotated[
        bool, option("--replace", help="Overwrite an earlier import in the folder --output, if it has not been solved.")
    ] = False
    as_json: AsJson = False
    root: Path = DEFAULT_ROOT


@dataclass(frozen=True, slots=True, kw_only=True)
class ReplayOptions:
    """Run a recorded session through the guide again, or send its data to a port or bus.

    Example: imufield replay imufield-sessions/20260301T101500Z-stim300
    """

    session: NewestSession = None
    to_pty: Annotated[bool, option("--to-pty", help="Replay the bytes to a virtual serial port.")] = False
    bus: Annotated[str | None, option(help="Replay the frames to a CAN bus, e.g. socketcan:vcan0.")] = None
    bit_rate: Annotated[
        int | None, option("--baud", help="Bit rate, for CAN adapters that set it when opened.", within=BAUD_RANGE)
    ] = None
    speed: Annotated[
        float, option(help="Speed of --to-pty and --bus relative to real time; 0 is as fast as possible.", low=0)
    ] = 1.0
    as_json: EventsAsJson = False


@dataclass(frozen=True, slots=True, kw_only=True)
class EmulateOptions:
    """Pretend to be an instrument on a virtual serial port or a CAN bus.

    Example: imufield emulate xsens_mtdata2 --form fp16.32 --wait --link /tmp/imu
    """

    driver: Annotated[
        str,
        argument(
            help="Instrument family, see `imufield devices`, or your protocol file (.toml).", autocompletion=completion.drivers
        ),
    ]
    form: Annotated[str | None, option(help="What it sends, e.g. RAWIMUX; a wrong name lists all.")] = None
    settings: Settings = field(default_factory=dict)
    bus: Annotated[str | None, option(help="CAN bus, e.g. udp_multicast:239.0.0.1 (default: slcan on a port).")] = None
    rate_hz: Annotated[
        float | None, option(help="Sample rate (default: the instrument's usual one).", low=1, high=RATE_RANGE_HZ[1])
    ] = None
    speed: Annotated[float, option(help="Speed relative to real time, e.g. 8 is eight times as fast.", low=0.1)] = 1.0
    grade: Annotated[str, option(help="navigation, tactical, industrial or mems.")] = "tactical"
    seed: Annotated[int, option(help="Seed of instrument, operator and faults.", low=0, high=LARGEST_SEED)] = 1
    day: Annotated[int, option(help="Another day of the instrument: other noise, tilts, faults.", low=0, high=LARGEST_SEED)] = 0
    positions: Annotated[str, option(help="Scheme the operator works through; `none`: it lies still.")] = "paper24"
    rounds: Annotated[
        int | None,
        option(
            help="How many times the operator goes through all positions (default: 20; 1 with --rotations).", low=1, high=1000
        ),
    ] = None
    poses: Annotated[
        Path | None,
        option(
            help="File of poses to use instead of --positions, one per line, e.g. z+135 or roll 30; `-` reads the keyboard."
        ),
    ] = None
    style: Annotated[str, option(help="placed (on a surface) or held (in the hand).")] = "placed"
    rotations: Annotated[str | None, option(help="Whole turns after the positions: rolled or table.")] = None
    hold_s: Annotated[float, option(help="Seconds the virtual operator holds each position.", within=HOLD_RANGE_S)] = 14.0
    wait: Annotated[
        bool | None,
        option("--wait/--no-wait", help="Begin when a program opens the port (default without --json, --duration-s)."),
    ] = None
    link: Annotated[Path | None, option(help="Make a symbolic link to the port here.")] = None
    truth: Annotated[Path | None, option(help="Write the true parameters and stills to this file.")] = None
    duration_s: Annotated[float | None, option(help="Stop after so many seconds of sample time.", low=0.1)] = None
    faults: Annotated[list[str] | None, option("--fault", help="E.g. bit_flip_probability=1e-4; may be repeated.")] = None
    as_json: AsJson = False

    @property
    def waits_for_reader(self) -> bool:
        """A person starts the reader a minute later; a script says what it wants."""
        return not self.as_json and self.duration_s is None if self.wait is None else self.wait


@dataclass(frozen=True, slots=True, kw_only=True)
class SolveOptions:
    """Solve a session: parameters with uncertainty, and a verdict. Several are solved in parallel, with a table of verdicts.

    Example: imufield solve --latitude 48.1 --height 520
    """

    sessions: Annotated[
        list[Path] | None, session_argument(metavar="[SESSION]...", help="Session folders (default: the newest).")
    ] = None
    observations: Annotated[Path | None, option(help="CSV of position means instead of a session.")] = None
    site: PlaceOptions = field(default_factory=unknown_site)
    model: Annotated[
        str,
        option(
            help="Accelerometer model: linear, quadratic, extended (cubic and cross terms), or auto, which "
            "chooses linear or quadratic by a test."
        ),
    ] = "auto"
    gauge: Annotated[
        str | None,
        option(
            help="How the body axes are fixed in the sensor: lower (default), upper, symmetric or preset; see docs/glossary.md."
        ),
    ] = None
    preset: Annotated[
        Path | None, option(help="Previous parameter file: compared with, and kept for what this session cannot show.")
    ] = None
    zero: Annotated[str | None, option(help="Raw output at zero input, one or three numbers.")] = None
    without: Annotated[list[str] | None, option(help="Name of a position to leave out; may be repeated.")] = None
    clock_sigma_ppm: Annotated[
        float | None, option(help="How well the sample period is known, 1 sigma, ppm (default: by kind of clock).", low=0)
    ] = None
    method: Annotated[str, option(help="least-squares, bsas, ide and others, see docs/study.md.")] = "least-squares"
    method_settings: MethodSettings = field(default_factory=dict)
    polish: Annotated[bool, option(help="Refine the result of any other --method by least squares.")] = True
    cross_check: Annotated[bool, option("--cross-check", help="Solve by bsas, ide and least squares, compare.")] = False
    gyroscope_model: Annotated[str, option("--gyro-model", help="auto, basic or g-sensitive.")] = "auto"
    grade: Annotated[
        str | None,
        option(
            help="Instrument class, whose typical errors widen sigma where data cannot show them: navigation, "
            "tactical, industrial or mems."
        ),
    ] = None
    seed: Annotated[int, option(help="Seed of everything random.", low=0, high=LARGEST_SEED)] = 0
    workers: Workers = None
    scheduler: Scheduler = None
    output: Annotated[Path | None, option("-o", "--output", help="Where to write the parameter file.")] = None
    as_json: AsJson = False

    def settings(self) -> "SolveSettings":
        """Return how the user wants it calibrated.

        Raises
        ------
        UsageError
            If a choice or a setting is none of those there are, or ``zero`` is neither one number nor three.
        ParameterFileError
            If the preset cannot be read.
        """
        # Here, because this module is read at every start, for a help too.
        import numpy as np

        from imufield.calibrate.gyroscope.model_choice import GyroscopeModel
        from imufield.calibrate.model.grades import GRADES
        from imufield.calibrate.model.result import Gauge, ModelChoice
        from imufield.calibrate.solvers.registry import load_solver
        from imufield.deliver.parameters.file import load
        from imufield.pipeline.calibration import SolveSettings, one_of

        zero = parse_zero(self.zero)
        # Refused before a long session is read.
        load_solver(self.method, self.method_settings)
        return SolveSettings(
            model=one_of("model", self.model, get_args(ModelChoice)),
            gauge=None if self.gauge is None else one_of("gauge", self.gauge, get_args(Gauge)),
            method=self.method,
            method_settings=self.method_settings,
            polish=self.polish,
            cross_check=self.cross_check,
            gyroscope_model=one_of("gyro-model", self.gyroscope_model, get_args(GyroscopeModel)),
            preset=None if self.preset is None else load(self.preset),
            raw_zero=None if zero is None else np.array(zero),
            grade=None if self.grade is None else one_of("grade", self.grade, tuple(GRADES)),
            seed=self.seed,
            without=tuple(self.without or ()),
            clock_sigma=None if self.clock_sigma_ppm is None else 1e-6 * self.clock_sigma_ppm,
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class NoiseOptions:
    """Measure the noise of hours of standstill by Allan deviation.

    Example: imufield noise my-standstill --plot allan.png
    """

    session: NewestSession = None
    to: Annotated[str, option(help="Form of --output: kalibr, openvins, vins or ros2.")] = "kalibr"
    output: Annotated[Path | None, option("-o", "--output", help="YAML for a navigation filter.")] = None
    plot: Annotated[Path | None, option(help="Draw the Allan deviation into this file (needs matplotlib).")] = None
    parameters: Annotated[Path | None, option(help="Parameter file to write the table `noise` into.")] = None
    as_json: AsJson = False


@dataclass(frozen=True, slots=True, kw_only=True)
class StudyOptions:
    """Reproduce a table or figure of the papers, paper's and our figures side by side.

    BAS is beetle antennae search, BSAS the swarm of it (with m beetles); IDE is improved differential evolution.

    The studies answers-* simulate one disturbance each and count how often verdict and warnings are right (docs/answers.md).

    Example: imufield study

    Example: imufield study bsas-table3 --quick
    """

    name: Annotated[
        str | None, argument(help="A study, a paper (bsas, ide), all of the papers, or answers (default: list them).")
    ] = None
    quick: Annotated[bool, option("--quick", help="Few runs, to see that it works.")] = False
    seed: Annotated[int, option(help="Seed of all runs.", low=0, high=LARGEST_SEED)] = 0
    workers: Workers = None
    scheduler: Scheduler = None
    output: Annotated[Path | None, option("-o", "--output", help="Folder for CSV files and plots.")] = None
    document: Annotated[Path | None, option(help="Write all as one Markdown document.")] = None


@dataclass(frozen=True, slots=True, kw_only=True)
class ExportOptions:
    """Write the parameters in another program's format, and say what it cannot hold.

    Example: imufield export my-session/parameters.toml --to c -o calibration.h
    """

    parameters: Annotated[Path | None, session_argument(help="Parameter file.")] = None
    to: Annotated[
        str | None, option(help="Target, e.g. c, px4, vectornav (default: list them).", autocompletion=completion.targets)
    ] = None
    settings: Settings = field(default_factory=dict)
    output: Annotated[Path | None, option("-o", "--output", help="File or folder (default: the usual names here).")] = None
    as_json: AsJson = False


@dataclass(frozen=True, slots=True, kw_only=True)
class ApplyOptions:
    """Correct a recording with the parameters.

    Example: imufield apply my-session/parameters.toml my-session -o corrected.csv
    """

    parameters: ParameterFile
    source: Annotated[Path, session_argument(help="Session folder, or a table (CSV).")]
    output: Annotated[Path, option("-o", "--output", help="CSV to write.")]
    rate_hz: TableRateHz = None


@dataclass(frozen=True, slots=True, kw_only=True)
class ExportDataOptions:
    """Write the decoded samples of a session for other programs.

    Example: imufield export-data my-session --to csv -o samples.csv
    """

    session: NewestSession = None
    to: Annotated[str, option(help="csv, parquet, hdf5 or ros2 (MCAP).")] = "csv"
    output: Annotated[Path | None, option("-o", "--output", help="File to write (default: SESSION/samples.*).")] = None


@dataclass(frozen=True, slots=True, kw_only=True)
class VerifyOptions:
    """Prove parameters on data they have not seen: held-out positions, and hours of static navigation.

    Example: imufield verify parameters.toml standstill-5h --require nav-nmi-per-h=1
    """

    parameters: Annotated[Path, session_argument(help="Parameter file under test.")]
    session: Annotated[Path | None, session_argument(help="Session they have not seen (default: the newest).")] = None
    preset: Annotated[Path | None, option(help="Parameter file to compare with (default: no correction).")] = None
    hold_out: Annotated[
        int | None,
        option(
            help="Positions left out of each solve and then predicted (default: 4); only for the session the "
            "parameters came from.",
            low=1,
        ),
    ] = None
    turned: Annotated[bool, option("--turned", help="The instrument was turned over after the alignment.")] = False
    align_s: Annotated[float, option(help="Seconds of rest at the start to align with.", low=1)] = 600.0
    # From -360, as headings are written from 0 to 360 or from -180 to 180.
    heading_deg: Annotated[
        float | None,
        option("--heading", help="Known heading of the body x axis, degrees clockwise from north.", low=-360, high=360),
    ] = None
    heading_sigma_deg: Annotated[float, option("--heading-sigma", help="1 sigma of that heading, degrees.", low=0, high=30)] = (
        0.0
    )
    site: PlaceOptions = field(default_factory=unknown_site)
    require: Annotated[str | None, option(help="Limits, e.g. residual-ug=50,nav-nmi-per-h=1.")] = None
    turn_on_ug: Annotated[float | None, option(help="Turn-on bias of the accelerometer, 1 sigma.", low=0)] = None
    turn_on_deg_per_h: Annotated[float | None, option(help="Turn-on bias of the gyroscope, 1 sigma.", low=0)] = None
    seed: Annotated[int, option(help="Seed of the forecast.", low=0, high=LARGEST_SEED)] = 0
    output: Annotated[Path | None, option("-o", "--output", help="Where to keep the results for the report.")] = None
    as_json: AsJson = False


@dataclass(frozen=True, slots=True, kw_only=True)
class ReportOptions:
    """Write the report of a session, one page that needs no network, and a calibration record of one sheet.

    Example: imufield report my-session --operator "J. Doe"
    """

    session: NewestSession = None
    parameters: Annotated[Path | None, option(help="Parameter file (default: SESSION/parameters.toml).")] = None
    preset: Annotated[Path | None, option(help="Parameter file in force before, to compare with.")] = None
    operator: Annotated[str, option(help="Who calibrated, for the record.")] = ""
    output: Annotated[Path | None, option("-o", "--output", help="Page (default: SESSION/report.html).")] = None
    record: Annotated[Path | None, option(help="Calibration record (default: SESSION/calibration-record.html).")] = None
    pdf: Annotated[bool, option("--pdf", help="Write both as PDF, too, beside them (takes some seconds).")] = False


@dataclass(frozen=True, slots=True, kw_only=True)
class HistoryOptions:
    """Show how the parameters of each instrument changed from calibration to calibration, in units of sigma.

    Example: imufield history calibrations --serial 1234 --plot drift.svg
    """

    folder: Annotated[Path, argument(help="Folder of parameter files, searched below too.")] = DEFAULT_ROOT
    serial_number: Annotated[str | None, option("--serial", help="Only this serial number.")] = None
    at: Annotated[str | None, option(help="Print only the file calibrated closest to this date, e.g. 2026-03-04.")] = None
    # A year, as calibrations are usually dated.
    stale_days: Annotated[float, option(help="Age at which a calibration is old.", low=0)] = 365.0
    csv: Annotated[Path | None, option(help="Write every number of every calibration to this file.")] = None
    plot: Annotated[
        Path | None, option(help="Plot the change of the parameters over time as SVG, one file per instrument.")
    ] = None
    as_json: AsJson = False
