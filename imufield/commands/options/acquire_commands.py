"""Options of commands that get samples: ``capture``, ``plan``, ``record``, ``import``, ``replay``, ``emulate`` and others."""

from pathlib import Path
from typing import Annotated, Literal

from imufield.commands.options import completion
from imufield.commands.options.shared import (
    LARGEST_SEED,
    AsJson,
    ClockSpeed,
    ConnectionOptions,
    DriverName,
    EventsAsJson,
    NewestSession,
    PlaceOptions,
    Plain,
    Port,
    PortOrBusOptions,
    RawZero,
    SessionFolder,
    Settings,
    SignalMap,
    TableRateHz,
    TargetBiasUg,
    TargetScalePpm,
    argument,
    option,
    unknown_site,
)
from imufield.dataclass import dataclass, field
from imufield.errors import UsageError
from imufield.files import DEFAULT_ROOT
from imufield.limits import BAUD_RANGE, HOLD_RANGE_S, PORT_RANGE, RATE_RANGE_HZ, TARGET_RANGE
from imufield.sentences import Sentences

sentence = Sentences(__package__)

SchemeName = Annotated[
    str | None,
    option("--positions", help="Scheme: paper24, paper36, corners24, all26, faces6 or a TOML list (default: paper24)."),
]
HoldS = Annotated[
    float | None,
    option(
        "--hold-s",
        help="Seconds to hold each position (default: 3 to 10 s, until the mean is known to 10 micro-g; "
        "with a target 3 to 60 s).",
        within=HOLD_RANGE_S,
    ),
]
WebPort = Annotated[int | None, option(help="Port of the page (default: 8777 or the next free one).", within=PORT_RANGE)]
ViewName = Literal["auto", "plain", "json"]
VIRTUAL_SEED = 16
"""Of the default virtual instrument: with one of twenty, a test at 95 % fails by chance, and a first use ends with it."""
# Signs are part of the name: `--cable=-x` needs its equals sign, or the parser takes -x for an option.
SIDES = ("+x", "-x", "+y", "-y", "+z", "-z")


def _check_side(text: str | None) -> str | None:
    if text is not None and text not in SIDES:
        raise UsageError(sentence("samples.cable", text=text, sides=SIDES))
    return text


@dataclass(frozen=True, slots=True, kw_only=True)
class DemoOptions:
    """The options of ``demo``.

    Example: imufield demo

    Example: imufield demo --temperature
    """

    seed: Annotated[int, option(help="Seed of the simulated instrument and operator.", low=0, high=LARGEST_SEED)] = VIRTUAL_SEED
    speed: Annotated[float, option(help="Speed relative to real time, e.g. 8 is eight times as fast.", low=1)] = (
        8.0  # What a small machine keeps up with.
    )
    temperature: Annotated[
        bool,
        option(
            "--temperature",
            help="Simulate sessions at -10, 20 and 50 degC, solve them into one file, and compare it with one session.",
        ),
    ] = False
    plain: Plain = False
    root: Path = DEFAULT_ROOT


@dataclass(frozen=True, slots=True, kw_only=True)
class DevicesOptions:
    """The options of ``devices``.

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
    """The options of ``init``.

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
    """The options of ``probe``.

    Example: imufield probe --port /dev/ttyUSB0

    Example: imufield probe --bus socketcan:can0
    """

    connect: PortOrBusOptions
    # Off: an unknown device at the port may take a question for a command.
    ask: Annotated[bool, option("--ask", help="Query the instrument's identity; without this option nothing is sent.")] = False
    as_json: AsJson = False
    clock_speed: ClockSpeed = 1.0


@dataclass(frozen=True, slots=True, kw_only=True)
class CaptureOptions:
    """The options of ``capture``.

    Example: imufield capture --port /dev/ttyUSB0 --latitude 48.1 --height 520
    """

    connect: ConnectionOptions
    positions: SchemeName = None
    hold_s: HoldS = None
    session: SessionFolder = None
    resume: Annotated[bool, option("--resume", help="Continue an unfinished session.")] = False
    retake: Annotated[
        list[str] | None,
        option(
            help="With --resume: measure this position again, even if the session is finished; "
            "--retake may be given several times."
        ),
    ] = None
    site: PlaceOptions = field(default_factory=unknown_site)
    plain: Plain = False
    as_json: EventsAsJson = False
    target_bias_ug: TargetBiasUg = None
    target_scale_ppm: TargetScalePpm = None
    preset: Annotated[
        Path | None, option(help="Previous parameter file; comparison with its scale reveals a wrong latitude or gravity.")
    ] = None
    rotations: Annotated[
        str | None,
        option(
            help="Whole turns for the gyroscope: rolled (edge over edge), or table (flat on the table; each turn starts "
            "and ends with a side against a fixed stop)."
        ),
    ] = None
    quiet: Annotated[bool, option("--quiet", help="No sound.")] = False
    speak: Annotated[bool, option("--speak", help="Speak the instructions aloud, where a speech program is installed.")] = False
    big: Annotated[bool, option("--big", help="Big letters, to be read from three metres.")] = False
    cable: Annotated[
        str | None, option(help="Side of the unit where the cable leaves, for the pictures: +x ... -z.", check=_check_side)
    ] = None
    web: Annotated[bool, option("--web", help="Show the guide in a browser on this machine, too.")] = False
    web_lan: Annotated[
        str | None, option(help="Show the guide on phones, too; give this machine's address in their network, or auto.")
    ] = None
    web_port: WebPort = None
    clock_speed: ClockSpeed = 1.0
    root: Path = DEFAULT_ROOT

    @property
    def view(self) -> ViewName:
        """What shows the events; "auto" is pictures where there is a terminal."""
        return "json" if self.as_json else "plain" if self.plain else "auto"


@dataclass(frozen=True, slots=True, kw_only=True)
class PlanOptions:
    """The options of ``plan``.

    Example: imufield plan --target-bias-ug 150 --grade tactical
    """

    positions: SchemeName = None
    hold_s: HoldS = None
    target_bias_ug: TargetBiasUg = None
    target_scale_ppm: TargetScalePpm = None
    site: PlaceOptions = field(default_factory=unknown_site)
    driver: DriverName = None
    grade: Annotated[
        str | None,
        option(
            help="Instrument grade, whose noise is assumed: navigation, tactical, industrial or mems (default: by "
            "--noise-ug, else as driver states, else mems)."
        ),
    ] = None
    noise_ug: Annotated[
        float | None,
        option(
            help="Noise of the accelerometer, micro-g per root Hz: from its data sheet, or from `imufield probe`.",
            within=TARGET_RANGE,
        ),
    ] = None
    as_json: AsJson = False


@dataclass(frozen=True, slots=True, kw_only=True)
class SessionsOptions:
    """The options of ``sessions``.

    Example: imufield sessions --find "stim300 usable"
    """

    folder: Annotated[Path, argument(help="Folder of sessions.")] = DEFAULT_ROOT
    find: Annotated[str | None, option(help="Only those that show all these words, e.g. 2026-03 or unfinished.")] = None
    as_json: AsJson = False


@dataclass(frozen=True, slots=True, kw_only=True)
class WebOptions:
    """The options of ``web``.

    Example: imufield web
    """

    folder: Annotated[Path, argument(help="Folder of sessions.")] = DEFAULT_ROOT
    web_port: WebPort = None


@dataclass(frozen=True, slots=True, kw_only=True)
class RecordOptions:
    """The options of ``record``.

    Example: imufield record --port /dev/ttyUSB0 --duration-s 3600

    Example: imufield record --port /dev/ttyUSB0 --ramp

    Example: imufield record --bus socketcan:can0 --driver aceinna_can
    """

    connect: ConnectionOptions
    session: SessionFolder = None
    site: PlaceOptions = field(default_factory=unknown_site)
    duration_s: Annotated[float | None, option(help="Stop after this many seconds (default: until Ctrl-C).", low=0.1)] = None
    ramp: Annotated[
        bool, option("--ramp", help="Guide a temperature ramp in one pose; show temperature, its rate and the range covered.")
    ] = False
    as_json: AsJson = False
    clock_speed: ClockSpeed = 1.0
    root: Path = DEFAULT_ROOT


@dataclass(frozen=True, slots=True, kw_only=True)
class ImportOptions:
    """The options of ``import``.

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
    zero: RawZero = None
    model: Annotated[
        str | None,
        option(help="Model of the instrument, for history with --serial (default: the name of the first file)."),
    ] = None
    serial_number: Annotated[str | None, option("--serial", help="Serial number of the instrument.")] = None
    site: PlaceOptions = field(default_factory=unknown_site)
    replace: Annotated[
        bool, option("--replace", help="Overwrite an earlier import in the folder --output, if it has not been solved.")
    ] = False
    as_json: AsJson = False
    root: Path = DEFAULT_ROOT


@dataclass(frozen=True, slots=True, kw_only=True)
class ReplayOptions:
    """The options of ``replay``.

    Example: imufield replay imufield-sessions/20260301T101500Z-stim300
    """

    session: NewestSession = None
    to_pty: Annotated[bool, option("--to-pty", help="Replay the bytes to a virtual serial port.")] = False
    bus: Annotated[str | None, option(help="Replay the frames to a CAN bus, e.g. socketcan:vcan0.")] = None
    bit_rate: Annotated[
        int | None, option("--baud", help="Bit rate, for CAN adapters that set it when opened.", within=BAUD_RANGE)
    ] = None
    speed: Annotated[
        float, option(help="Speed of --web, --to-pty and --bus relative to real time; 0 is as fast as possible.", low=0)
    ] = 1.0
    web: Annotated[bool, option("--web", help="Show the guide in a browser on this machine, at --speed.")] = False
    as_json: EventsAsJson = False


@dataclass(frozen=True, slots=True, kw_only=True)
class EmulateOptions:
    """The options of ``emulate``.

    Example: imufield emulate xsens_mtdata2 --form fp16.32 --wait --link /tmp/imu
    """

    driver: Annotated[
        str,
        argument(
            help="Instrument family, see `imufield devices`, or your protocol file (.toml).", autocompletion=completion.drivers
        ),
    ]
    form: Annotated[str | None, option(help="Format of the data, e.g. RAWIMUX; a wrong name lists all.")] = None
    settings: Settings = field(default_factory=dict)
    bus: Annotated[
        str | None,
        option(
            help="Bus of a CAN instrument, e.g. udp_multicast:239.0.0.1 (default: an slcan adapter on a virtual serial port)."
        ),
    ] = None
    rate_hz: Annotated[
        float | None, option(help="Sample rate (default: the instrument's usual one).", low=1, high=RATE_RANGE_HZ[1])
    ] = None
    speed: Annotated[float, option(help="Speed relative to real time, e.g. 8 is eight times as fast.", low=0.1)] = 1.0
    grade: Annotated[str, option(help="Instrument grade: navigation, tactical, industrial or mems.")] = "tactical"
    seed: Annotated[int, option(help="Seed of instrument, operator and faults.", low=0, high=LARGEST_SEED)] = VIRTUAL_SEED
    day: Annotated[
        int,
        option(
            help="Number of the day: on another day the instrument is the same, but noise, tilts and faults differ.",
            low=0,
            high=LARGEST_SEED,
        ),
    ] = 0
    positions: Annotated[str, option(help="Scheme the operator works through; `none`: the instrument lies still.")] = "paper24"
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
    style: Annotated[str, option(help="How it is kept still: placed (on a surface) or held (in the hand).")] = "placed"
    rotations: Annotated[
        str | None,
        option(help="Whole turns after the positions: rolled (edge over edge) or table (flat on the table)."),
    ] = None
    hold_s: Annotated[float, option(help="Seconds the virtual operator holds each position.", within=HOLD_RANGE_S)] = 14.0
    temperature: Annotated[
        str | None,
        option(
            help="Temperature of the instrument, degC, e.g. -10 (default: 25); or a ramp FROM:TO or FROM:TO:RATE, RATE in "
            "degC/min (default: 1)."
        ),
    ] = None
    wait: Annotated[
        bool | None,
        option(
            "--wait/--no-wait", help="Begin when a program opens the port (default, unless --json or --duration-s is given)."
        ),
    ] = None
    link: Annotated[Path | None, option(help="Make a symbolic link to the port at this path.")] = None
    truth: Annotated[Path | None, option(help="Write the true parameters and still intervals to this file.")] = None
    duration_s: Annotated[float | None, option(help="Stop after this many seconds of sample time.", low=0.1)] = None
    faults: Annotated[
        list[str] | None,
        option("--fault", help="Fault to simulate, NAME=NUMBER, e.g. bit_flip_probability=1e-4; may be repeated."),
    ] = None
    as_json: AsJson = False

    @property
    def waits_for_reader(self) -> bool:
        """A person starts the reader a minute later; a script says what it wants."""
        return not self.as_json and self.duration_s is None if self.wait is None else self.wait
