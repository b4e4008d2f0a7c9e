"""Options that several commands share, and how options become the values that a command is handed.

A field of an options class is an option where its annotation carries an ``Option``, ``Converted`` or ``Group``; other fields
are set by programs only. Nothing heavy is imported here, because every start of the program reads it, and annotations are not
postponed, because the command line is made from them.
"""

from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Self, TypeVar

from imufield.commands.options import completion
from imufield.commands.options.configuration import parse_settings
from imufield.dataclass import dataclass, fields
from imufield.errors import UsageError
from imufield.limits import BAUD_RANGE, RATE_RANGE_HZ, TARGET_RANGE
from imufield.sentences import Sentences

if TYPE_CHECKING:
    from imufield.acquire.instrument.connected import ConnectOptions
    from imufield.pipeline.site import SiteOptions

sentence = Sentences(__package__)

AChoice = TypeVar("AChoice")

LARGEST_SEED = 2**63 - 1
"""What a parameter file can hold."""
# 30 years of seconds: whatever an option is in, what is larger is a slip, and its square may be no number.
_LARGEST = 1e9


class UnfitValueError(Exception):
    """A value that an option does not take; the words say why."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Option:
    """Marks an option, or an argument.

    Attributes
    ----------
    names : tuple of str
        As they are typed, "--rate-hz"; empty: that of the field.
    is_argument : bool
    check : callable or None
        Returns the value, or raises ``UnfitValueError`` or an error of imufield.
    more : mapping
        What typer is handed beside: help, ``envvar``, ``parser`` and others.
    """

    names: tuple[str, ...] = ()
    is_argument: bool = False
    check: Callable[..., object] | None = None
    more: Mapping[str, object]


@dataclass(frozen=True, slots=True)
class Converted:
    """Marks an option that is typed as one type and handed to the command as another."""

    typed_as: object  # An annotation as those of other options.
    convert: Callable[[Any], object]  # Any, as each option is typed as another type.


@dataclass(frozen=True, slots=True)
class Group:
    """Marks a field that several options make together.

    Attributes
    ----------
    arguments : type
        Dataclass of the options.
    build : callable
        Given an instance of it and the names of the options that were typed, returns the value of the field.
    """

    arguments: type
    build: Callable[[Any, frozenset[str]], object]


def option(
    *names: str,
    low: float | None = None,
    high: float = _LARGEST,
    within: tuple[float, float] | None = None,
    check: Callable[[Any], Any] | None = None,
    **more: Any,
) -> Any:
    """Return the mark of an option; the value of a number is checked against its limits, another by ``check``.

    The limits of typer itself are printed in every help, where those of a seed leave no room for words.
    """
    if low is not None:
        within = low, high
    return Option(names=names, check=check if within is None else _within(*within), more=more)


def argument(**more: Any) -> Any:
    """Return the mark of an argument."""
    return Option(is_argument=True, more=more)


# Of a session's folder, which stands for its parameter file, too.
session_argument = partial(argument, autocompletion=completion.sessions)


def _within(low: float, high: float) -> Callable[[Any], Any]:
    def check(value: Any) -> Any:
        # Written so that NaN is outside.
        if value is not None and not low <= value <= high:
            raise UnfitValueError(sentence("shared.between", value=value, low=low, high=high))
        return value

    return check


def read_number(text: object, kind: type[float] = float) -> float:
    """Return the number that a text is, of another kind a whole one; raises ``UnfitValueError``."""
    try:
        return kind(str(text))
    except ValueError as error:
        key = "shared.no_number" if kind is float else "shared.no_whole_number"
        raise UnfitValueError(sentence(key, text=text)) from error


class TypedNumber(float):
    """A number that remembers the digits it was typed with, 9.810 says more than 9.81, and the sigma in 9.81+-0.0001."""

    text: str
    sigma_text: str

    def __new__(cls, text: object) -> Self:
        """Read a number from an option, a variable or a file; raises ``UnfitValueError``."""
        value, _, sigma = str(text).replace("±", "+-").partition("+-")
        number = super().__new__(cls, read_number(value))
        number.text, number.sigma_text = value.strip(), sigma.strip()
        return number


def _set_option(told: str) -> Converted:
    """Return ``--set`` of a command, with its help."""
    return Converted(Annotated[list[str] | None, option("--set", help=told)], parse_settings)


def _parse_mapping(texts: list[str] | None) -> dict[str, str]:
    # Only who gives --map pays for the room that reads it.
    if not texts:
        return {}
    from imufield.acquire.instrument.can_map import parse_map

    return parse_map(texts)


Port = Annotated[
    str | None,
    option(
        help="Serial port or pyserial URL, e.g. /dev/ttyUSB0, COM3, socket://host:4001.",
        envvar="IMUFIELD_PORT",
        autocompletion=completion.ports,
    ),
]
Bus = Annotated[
    str | None, option(help="CAN bus, INTERFACE:CHANNEL, e.g. socketcan:can0, slcan:/dev/ttyACM0.", envvar="IMUFIELD_BUS")
]
SignalMap = Annotated[
    Mapping[str, str],
    Converted(
        Annotated[list[str] | None, option("--map", help="Which signal of --dbc is which axis, e.g. accelerometer.x=AccLong.")],
        _parse_mapping,
    ),
]
DriverName = Annotated[
    str | None,
    option(
        "--driver",
        help="Instrument family, see `imufield devices`.",
        envvar="IMUFIELD_DRIVER",
        autocompletion=completion.drivers,
    ),
]
Baud = Annotated[
    int | None,
    option(help="Baud rate of the port, or bit rate of the bus.", within=BAUD_RANGE, envvar="IMUFIELD_BAUD"),
]
Settings = Annotated[
    Mapping[str, str],
    _set_option(
        "Setting of the instrument that its data does not state, e.g. accelerometer_range_g=30; "
        "`imufield devices NAME` lists them."
    ),
]
ExportSettings = Annotated[
    Mapping[str, str],
    _set_option("Setting of the export, NAME=VALUE, e.g. instance=1; a wrong NAME lists all."),
]
MethodSettings = Annotated[
    Mapping[str, str],
    _set_option("Setting of --method, NAME=VALUE, e.g. m=20 (swarm size of bsas); a wrong NAME lists all."),
]
TableRateHz = Annotated[
    float | None, option("--rate-hz", help="Sample rate, where the file has no time.", within=RATE_RANGE_HZ)
]
NewestSession = Annotated[Path | None, session_argument(help="Session folder (default: the newest).")]
SessionFolder = Annotated[
    Path | None,
    option("--session", help="Folder of the session (default: a new one).", autocompletion=completion.sessions),
]
TargetBiasUg = Annotated[
    float | None,
    option(
        "--target-bias-ug",
        help="Accuracy wanted for the biases, 1 sigma, micro-g; holds become long enough for it (60 s at most).",
        within=TARGET_RANGE,
    ),
]
TargetScalePpm = Annotated[
    float | None,
    option(
        "--target-scale-ppm",
        help="Accuracy wanted for the scale factors, 1 sigma, ppm; gravity must be known better than that.",
        within=TARGET_RANGE,
    ),
]
RawZero = Annotated[
    str | None, option("--zero", help="Raw zero: one number, three of the accelerometer, or six of both triads.")
]
AsJson = Annotated[bool, option("--json", help="JSON on standard output and nothing else.")]
EventsAsJson = Annotated[bool, option("--json", help="Events as JSON lines on standard output.")]
Plain = Annotated[bool, option("--plain", help="Plain lines instead of pictures.")]
Workers = Annotated[int | None, option(help="Processes (default: all cores).", low=1)]
Scheduler = Annotated[str | None, option(help="Address of a Dask scheduler, e.g. tcp://host:8786.")]
ClockSpeed = Annotated[
    float,
    option(
        help="For emulated instruments only: the --speed at which the emulator runs.",
        envvar="IMUFIELD_CLOCK_SPEED",
        low=1,
        high=1000,
    ),
]


@dataclass(frozen=True, slots=True, kw_only=True)
class PortOrBus:
    """Where an instrument is."""

    port: Port = None
    bus: Bus = None
    baud: Baud = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Connection:
    """Where an instrument is and how it is understood."""

    port: Port = None
    bus: Bus = None
    driver: DriverName = None
    baud: Baud = None
    protocol: Annotated[Path | None, option("--protocol", help="Your own wire format, a TOML file.")] = None
    dbc: Annotated[Path | None, option(help="On a CAN bus: the DBC file of your own instrument.")] = None
    mapping: SignalMap
    settings: Settings
    rate_hz: Annotated[
        float | None,
        option(
            help="Output rate to set, where the driver can; the previous rate is restored at the end.", within=RATE_RANGE_HZ
        ),
    ] = None


def _connect_options(given: PortOrBus | Connection, typed: frozenset[str]) -> "ConnectOptions":
    """Return where and how to connect; a bus or a port that was typed goes before the other as a default.

    Raises
    ------
    UsageError
        Both were typed.
    """
    from imufield.acquire.instrument.connected import ConnectOptions

    port, bus = given.port, given.bus
    if port is not None and bus is not None:
        # Both typed, or both from file and variables: nothing says which of them is meant.
        if ("port" in typed) == ("bus" in typed):
            raise UsageError(sentence("shared.port_and_bus", port=port, bus=bus))
        port, bus = (port, None) if "port" in typed else (None, bus)
    # The fields have the names of those they are handed to; what a probe does not ask for keeps its default.
    values: dict[str, Any] = {entry.name: getattr(given, entry.name) for entry in fields(given)}
    values |= {"port": port, "bus": bus}
    return ConnectOptions(**values)


def one_of(name: str, value: str, choices: tuple[AChoice, ...]) -> AChoice:
    """Return the value of an option that has a few names only.

    Raises
    ------
    UsageError
        If it is none of them.
    """
    # Returned is the choice and not the text, which has its type.
    for choice in choices:
        if choice == value:
            return choice
    raise UsageError(sentence("shared.unknown_choice", name=name, value=value, choices=choices))


@dataclass(frozen=True, slots=True, kw_only=True)
class Place:
    """What gravity follows from."""

    gravity: Annotated[
        float | None,
        option(
            "--gravity",
            help="Local gravity, m/s^2, e.g. 9.8089+-0.0001; without +-, 1 sigma is 0.29 of the last digit, but "
            "0.018 for textbook values (9.8, 9.81, 9.807, 9.80665).",
            envvar="IMUFIELD_GRAVITY_M_S2",
            parser=TypedNumber,
        ),
    ] = None
    latitude: Annotated[
        float | None, option(help="Latitude, decimal degrees, from which WGS-84 gives gravity.", envvar="IMUFIELD_LATITUDE_DEG")
    ] = None
    height: Annotated[float | None, option(help="Height above the ellipsoid, m.", envvar="IMUFIELD_HEIGHT_M")] = None


def _site_options(place: Place, typed: frozenset[str]) -> "SiteOptions":
    """Return the site: what was typed, and apart from it the defaults of file and variables."""
    from imufield.acquire.recording.session_record import SiteRecord
    from imufield.pipeline.site import SiteOptions

    names = frozenset({"gravity", "latitude", "height"})
    return SiteOptions(**_site_values(place, names & typed), usual=SiteRecord(**_site_values(place, names - typed)))


def _site_values(place: Place, names: frozenset[str]) -> "dict[str, Any]":
    """Return the fields of a ``SiteRecord`` that these options say."""
    from imufield.earth import sigma_as_typed

    value = place.gravity if "gravity" in names else None
    return {
        "gravity_m_s2": value,
        "gravity_sigma_m_s2": sigma_as_typed(value.text, value.sigma_text) if isinstance(value, TypedNumber) else None,
        "gravity_sigma_is_given": True if isinstance(value, TypedNumber) and value.sigma_text else None,
        "latitude_deg": place.latitude if "latitude" in names else None,
        "height_m": place.height if "height" in names else None,
    }


def unknown_site() -> "SiteOptions":
    """Return the site of somebody who gave none."""
    from imufield.pipeline.site import SiteOptions

    return SiteOptions()


PortOrBusOptions = Annotated["ConnectOptions", Group(PortOrBus, _connect_options)]
ConnectionOptions = Annotated["ConnectOptions", Group(Connection, _connect_options)]
PlaceOptions = Annotated["SiteOptions", Group(Place, _site_options)]
