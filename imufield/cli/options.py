"""Options that several commands share, and where a value of them came from."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Self

import typer

if TYPE_CHECKING:
    from imufield.commands.terminal.connection import ConnectOptions
    from imufield.pipeline.site import SiteOptions


def within(low: float, high: float = math.inf) -> Callable[[Any], Any]:
    """Return a check of an option's value.

    The limits of typer itself are printed in every help, where those of a seed leave no room for words.
    """

    def check(value: Any) -> Any:
        # Written so that NaN is outside.
        if value is not None and not low <= value <= high:
            limits = f"between {low} and {high}" if high < math.inf else f"{low} or more"
            raise typer.BadParameter(f"{value!r} is out of range, it must be {limits}")
        return value

    return check


Port = Annotated[
    str | None,
    typer.Option(help="Serial port or pyserial URL, e.g. /dev/ttyUSB0, COM3, socket://host:4001.", envvar="IMUFIELD_PORT"),
]
Bus = Annotated[
    str | None,
    typer.Option(help="CAN bus, INTERFACE:CHANNEL, e.g. socketcan:can0, slcan:/dev/ttyACM0.", envvar="IMUFIELD_BUS"),
]
DbcFile = Annotated[Path | None, typer.Option(help="On a CAN bus: the DBC file of your own instrument.", readable=False)]
SignalMap = Annotated[
    list[str] | None, typer.Option("--map", help="Which signal of --dbc is which axis, e.g. accelerometer.x=AccLong.")
]
DriverName = Annotated[
    str | None, typer.Option("--driver", help="Instrument family, see `imufield devices`.", envvar="IMUFIELD_DRIVER")
]
Baud = Annotated[
    int | None, typer.Option(help="Baud rate of the port, or bit rate of the bus.", callback=within(50), envvar="IMUFIELD_BAUD")
]
ProtocolFile = Annotated[Path | None, typer.Option("--protocol", help="Your own wire format, a TOML file.", readable=False)]
Settings = Annotated[
    list[str] | None, typer.Option("--set", help="What the wire does not tell, e.g. accelerometer_range_g=30.")
]
RateHz = Annotated[
    float | None,
    typer.Option(
        help="Set the output rate of the instrument, where its driver can; put back at the end.", callback=within(0.1)
    ),
]
TableRateHz = Annotated[
    float | None, typer.Option("--rate-hz", help="Sample rate of a table without a time column.", callback=within(1e-3))
]
SessionFolder = Annotated[
    Path | None, typer.Option("--session", help="Folder of the session (default: a new one).", readable=False)
]
LARGEST_SEED = 2**63 - 1
"""What a parameter file can hold."""
AsJson = Annotated[bool, typer.Option("--json", help="JSON on standard output and nothing else.")]


class TypedNumber(float):
    """A number that remembers the digits it was typed with: 9.810 says more than 9.81."""

    text: str

    def __new__(cls, text: object) -> Self:
        """Read a number from an option, a variable or a file; raises ``typer.BadParameter``."""
        try:
            number = super().__new__(cls, str(text))
        except ValueError as error:
            raise typer.BadParameter(f"{text!r} is not a number; write it with a decimal point, e.g. 9.80665") from error
        number.text = str(text)
        return number


GravityValue = Annotated[
    float | None,
    typer.Option(
        "--gravity",
        help="Local gravity, m/s^2; as uncertain as its last digit.",
        envvar="IMUFIELD_GRAVITY_M_S2",
        parser=TypedNumber,
        metavar="FLOAT",
    ),
]
Latitude = Annotated[
    float | None, typer.Option(help="Latitude, decimal degrees: gravity by WGS-84.", envvar="IMUFIELD_LATITUDE_DEG")
]
Height = Annotated[float | None, typer.Option(help="Height above the ellipsoid, m.", envvar="IMUFIELD_HEIGHT_M")]
Workers = Annotated[int | None, typer.Option(help="Processes (default: all cores).", callback=within(1))]
Scheduler = Annotated[str | None, typer.Option(help="Address of a Dask scheduler, e.g. tcp://host:8786.")]
ClockSpeed = Annotated[
    float,
    typer.Option(
        help="Times real time the instrument runs: only for an emulated one.",
        envvar="IMUFIELD_CLOCK_SPEED",
        hidden=True,
        callback=within(1, 1000),
    ),
]


def connect_options(
    *,
    context: typer.Context,
    port: str | None,
    bus: str | None,
    driver: str | None,
    baud: int | None,
    protocol: Path | None,
    dbc: Path | None,
    mapping: list[str] | None,
    settings: list[str] | None,
    rate_hz: float | None = None,
) -> ConnectOptions:
    """Return where and how to connect; a bus or a port that was typed goes before the other as a default.

    Raises
    ------
    UsageError
        Both were typed, or an option is not of the form NAME=VALUE.
    """
    from imufield.commands.configuration import parse_settings
    from imufield.commands.terminal.connection import ConnectOptions, parse_mapping
    from imufield.errors import UsageError

    if port is not None and bus is not None:
        is_port, is_bus = (is_typed(context, name) for name in ("port", "bus"))
        if is_port == is_bus:
            raise UsageError(f"--port {port} and --bus {bus} contradict each other; give one of them")
        port, bus = (port, None) if is_port else (None, bus)
    return ConnectOptions(
        port=port,
        driver=driver,
        baud=baud,
        protocol=protocol,
        settings=parse_settings(settings),
        bus=bus,
        dbc=dbc,
        mapping=parse_mapping(mapping),
        rate_hz=rate_hz,
    )


def is_typed(context: typer.Context, name: str) -> bool:
    """Tell whether an option was typed, and is no default of file or variables."""
    return str(getattr(context.get_parameter_source(name), "name", "")) == "COMMANDLINE"


def site(context: typer.Context, gravity: float | None, latitude: float | None, height: float | None) -> SiteOptions:
    """Return the site: what was typed; without that the defaults of file and variables, which a session's own site beats."""
    from imufield.earth import sigma_of_digits
    from imufield.pipeline.site import SiteOptions

    values = {"gravity": gravity, "latitude": latitude, "height": height}
    typed = {name: value for name, value in values.items() if is_typed(context, name)}
    if "gravity" in typed or "latitude" in typed:
        gravity, latitude, height = typed.get("gravity"), typed.get("latitude"), typed.get("height")
    sigma_m_s2 = sigma_of_digits(gravity.text) if isinstance(gravity, TypedNumber) else None
    is_default = not typed
    return SiteOptions(
        gravity_m_s2=gravity, latitude_deg=latitude, height_m=height, is_default=is_default, gravity_sigma_m_s2=sigma_m_s2
    )
