"""Options of the commands that carry the numbers to where they are used, and prove them."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

from imufield.commands.options.shared import (
    LARGEST_SEED,
    AsJson,
    NewestSession,
    PlaceOptions,
    Settings,
    TableRateHz,
    argument,
    option,
    unknown_site,
)
from imufield.files import DEFAULT_ROOT

ParameterFile = Annotated[Path, argument(help="Parameter file.")]


@dataclass(frozen=True, slots=True, kw_only=True)
class ExportOptions:
    """Write the parameters in another program's format, and say what it cannot hold.

    Example: imufield export my-session/parameters.toml --to c -o calibration.h
    """

    parameters: ParameterFile
    to: Annotated[str | None, option(help="Target, e.g. c, px4, vectornav (default: list them).")] = None
    settings: Settings = field(default_factory=dict)
    output: Annotated[Path | None, option("-o", "--output", help="File or folder (default: the usual names here).")] = None
    as_json: AsJson = False


@dataclass(frozen=True, slots=True, kw_only=True)
class ApplyOptions:
    """Correct a recording with the parameters.

    Example: imufield apply my-session/parameters.toml my-session -o corrected.csv
    """

    parameters: ParameterFile
    source: Annotated[Path, argument(help="Session folder, or a table (CSV).")]
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

    Example: imufield verify parameters.toml rest-of-5-hours --require nav-nmi-per-h=1
    """

    parameters: Annotated[Path, argument(help="Parameter file under test.")]
    session: Annotated[Path | None, argument(help="Session they have not seen (default: the newest).")] = None
    preset: Annotated[Path | None, option(help="Parameter file to compare with (default: no correction).")] = None
    hold_out: Annotated[int | None, option(help="Solve without so many positions at a time and check those.", low=1)] = None
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
    plot: Annotated[Path | None, option(help="Draw instruments over time, SVG, a file each.")] = None
    as_json: AsJson = False
