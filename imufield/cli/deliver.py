"""Arguments of the commands that carry the numbers to where they are used, and prove them."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from imufield.cli.options import LARGEST_SEED, AsJson, GravityValue, Height, Latitude, Settings, TableRateHz, site, within


def export(
    *,
    parameters: Annotated[Path, typer.Argument(help="Parameter file.", readable=False)],
    to: Annotated[str | None, typer.Option(help="Target, e.g. c, px4, vectornav (default: list them).")] = None,
    settings: Settings = None,
    output: Annotated[
        Path | None, typer.Option("-o", "--output", help="File or folder (default: the usual names here).", readable=False)
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Write the parameters in another program's format, and say what it cannot hold.

    Example: imufield export my-session/parameters.toml --to c -o calibration.h
    """
    from imufield.commands.export import run_export

    run_export(parameters, to, settings, output, as_json=as_json)


def apply(
    parameters: Annotated[Path, typer.Argument(help="Parameter file.", readable=False)],
    source: Annotated[Path, typer.Argument(help="Session folder, or a table (CSV).", readable=False)],
    output: Annotated[Path, typer.Option("-o", "--output", help="CSV to write.", readable=False)],
    rate_hz: TableRateHz = None,
) -> None:
    """Correct a recording with the parameters.

    Example: imufield apply my-session/parameters.toml my-session -o corrected.csv
    """
    from imufield.commands.apply import run_apply

    run_apply(parameters, source, output, rate_hz)


def export_data(
    session: Annotated[Path | None, typer.Argument(help="Session folder (default: the newest).", readable=False)] = None,
    to: Annotated[str, typer.Option(help="csv, parquet, hdf5 or ros2 (MCAP).")] = "csv",
    output: Annotated[
        Path | None, typer.Option("-o", "--output", help="File to write (default: SESSION/samples.*).", readable=False)
    ] = None,
) -> None:
    """Write the decoded samples of a session for other programs.

    Example: imufield export-data my-session --to csv -o samples.csv
    """
    from imufield.commands.export_data import run_export_data

    run_export_data(session, to, output)


def verify(
    *,
    context: typer.Context,
    parameters: Annotated[Path, typer.Argument(help="Parameter file under test.", readable=False)],
    session: Annotated[
        Path | None, typer.Argument(help="Session they have not seen (default: the newest).", readable=False)
    ] = None,
    preset: Annotated[
        Path | None, typer.Option(help="Parameter file to compare with (default: no correction).", readable=False)
    ] = None,
    hold_out: Annotated[
        int | None, typer.Option(help="Solve without so many positions at a time and check those.", callback=within(1))
    ] = None,
    turned: Annotated[bool, typer.Option("--turned", help="The instrument was turned over after the alignment.")] = False,
    align_s: Annotated[float, typer.Option(help="Seconds of rest at the start to align with.", callback=within(1))] = 600.0,
    heading: Annotated[
        float | None,
        typer.Option(help="Known heading of the body x axis, degrees clockwise from north.", callback=within(-360, 360)),
    ] = None,
    heading_sigma: Annotated[float, typer.Option(help="1 sigma of that heading, degrees.", callback=within(0, 30))] = 0.0,
    gravity: GravityValue = None,
    latitude: Latitude = None,
    height: Height = None,
    require: Annotated[str | None, typer.Option(help="Limits, e.g. residual-ug=50,nav-nmi-per-h=1.")] = None,
    turn_on_ug: Annotated[
        float | None, typer.Option(help="Turn-on bias of the accelerometer, 1 sigma.", callback=within(0))
    ] = None,
    turn_on_deg_per_h: Annotated[
        float | None, typer.Option(help="Turn-on bias of the gyroscope, 1 sigma.", callback=within(0))
    ] = None,
    seed: Annotated[int, typer.Option(help="Seed of the forecast.", callback=within(0, LARGEST_SEED))] = 0,
    output: Annotated[
        Path | None, typer.Option("-o", "--output", help="Where to keep the results for the report.", readable=False)
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Prove parameters on data they have not seen: held-out positions, and hours of static navigation.

    Example: imufield verify parameters.toml rest-of-5-hours --require nav-nmi-per-h=1
    """
    from imufield.commands.verify import VerifyOptions, run_verify

    options = VerifyOptions(
        parameters=parameters,
        session=session,
        preset=preset,
        hold_out=hold_out,
        turned=turned,
        align_s=align_s,
        heading_deg=heading,
        heading_sigma_deg=heading_sigma,
        site=site(context, gravity, latitude, height),
        require=require,
        turn_on_ug=turn_on_ug,
        turn_on_deg_per_h=turn_on_deg_per_h,
        seed=seed,
        output=output,
        as_json=as_json,
    )
    run_verify(options)


def report(
    *,
    session: Annotated[Path | None, typer.Argument(help="Session folder (default: the newest).", readable=False)] = None,
    parameters: Annotated[
        Path | None, typer.Option(help="Parameter file (default: SESSION/parameters.toml).", readable=False)
    ] = None,
    preset: Annotated[
        Path | None, typer.Option(help="Parameter file in force before, to compare with.", readable=False)
    ] = None,
    operator: Annotated[str, typer.Option(help="Who calibrated, for the record.")] = "",
    output: Annotated[
        Path | None, typer.Option("-o", "--output", help="Page (default: SESSION/report.html).", readable=False)
    ] = None,
    record: Annotated[
        Path | None, typer.Option(help="Calibration record (default: SESSION/calibration-record.html).", readable=False)
    ] = None,
) -> None:
    """Write the report of a session, one page that needs no network, and a calibration record of one sheet.

    Example: imufield report my-session --operator "J. Doe"
    """
    from imufield.commands.report import ReportOptions, run_report

    options = ReportOptions(
        session=session, parameters=parameters, preset=preset, output=output, record=record, operator=operator
    )
    run_report(options)


def history(
    *,
    folder: Annotated[Path, typer.Argument(help="Folder of parameter files, searched below too.", readable=False)] = Path(
        "imufield-sessions"
    ),
    serial: Annotated[str | None, typer.Option(help="Only this serial number.")] = None,
    at: Annotated[
        str | None, typer.Option(help="Print only the file calibrated closest to this date, e.g. 2026-03-04.")
    ] = None,
    stale_days: Annotated[float, typer.Option(help="Age at which a calibration is old.", callback=within(0))] = 365.0,
    csv: Annotated[
        Path | None, typer.Option(help="Write every number of every calibration to this file.", readable=False)
    ] = None,
    plot: Annotated[Path | None, typer.Option(help="Draw instruments over time, SVG, a file each.", readable=False)] = None,
    as_json: AsJson = False,
) -> None:
    """Show how the parameters of each instrument changed from calibration to calibration, in units of sigma.

    Example: imufield history calibrations --serial 1234 --plot drift.svg
    """
    from imufield.commands.history import HistoryOptions, run_history

    options = HistoryOptions(
        folder=folder, serial_number=serial, at=at, stale_days=stale_days, csv=csv, plot=plot, as_json=as_json
    )
    run_history(options)
