"""The command line: arguments in, exit codes out. What each command does is in ``imufield.commands``.

Nothing heavy is imported here: each command imports its own room, so that a prompt comes back at once.
"""

from __future__ import annotations

import contextlib
import errno
import os
import signal
import sys
from collections.abc import Iterator
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, Annotated, Any, TextIO

import typer

from imufield import __version__
from imufield.errors import ImufieldError, RecordingError

if TYPE_CHECKING:
    from imufield.commands.site import SiteOptions

EXIT_INTERRUPTED = 130
"""What typer leaves with after Ctrl-C; SIGTERM and SIGHUP take the same way."""

app = typer.Typer(
    name="imufield",
    help="Calibrate an IMU in the field: no turntable, 24 hand-held positions, a parameter file for your INS.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode="rich",
)

Port = Annotated[
    str | None,
    typer.Option(help="Serial port or pyserial URL, e.g. /dev/ttyUSB0, COM3, socket://host:4001.", envvar="IMUFIELD_PORT"),
]
DriverName = Annotated[
    str | None, typer.Option("--driver", help="Instrument family, see `imufield devices`.", envvar="IMUFIELD_DRIVER")
]
Baud = Annotated[int | None, typer.Option(help="Bit rate of the port.", min=50, envvar="IMUFIELD_BAUD")]
ProtocolFile = Annotated[Path | None, typer.Option("--protocol", help="Your own wire format, a TOML file.")]
Settings = Annotated[
    list[str] | None, typer.Option("--set", help="What the wire does not tell, e.g. accelerometer_range_g=30.")
]
SessionFolder = Annotated[Path | None, typer.Option("--session", help="Folder of the session (default: a new one).")]
AsJson = Annotated[bool, typer.Option("--json", help="JSON on standard output and nothing else.")]
GravityValue = Annotated[
    float | None, typer.Option("--gravity", help="Local gravity, m/s^2, measured.", envvar="IMUFIELD_GRAVITY_M_S2")
]
Latitude = Annotated[
    float | None, typer.Option(help="Latitude, decimal degrees: gravity by WGS-84.", envvar="IMUFIELD_LATITUDE_DEG")
]
Height = Annotated[float | None, typer.Option(help="Height above the ellipsoid, m.", envvar="IMUFIELD_HEIGHT_M")]
ClockSpeed = Annotated[
    float,
    typer.Option(
        help="Times real time the instrument runs: only for an emulated one.",
        envvar="IMUFIELD_CLOCK_SPEED",
        hidden=True,
        min=1,
        max=1000,
    ),
]


def _print_version(asked: bool) -> None:
    if asked:
        typer.echo(f"imufield {__version__}")
        raise typer.Exit


@app.callback()
def root(
    context: typer.Context,
    version: Annotated[  # noqa: ARG001  (answered by its callback, before a command is asked for)
        bool, typer.Option("--version", help="Print the version.", is_eager=True, callback=_print_version)
    ] = False,
) -> None:
    """Calibrate an IMU in the field: no turntable, 24 hand-held positions, a parameter file for your INS."""
    from imufield.commands.configuration import default_map

    context.default_map = default_map()


def _site(context: typer.Context, gravity: float | None, latitude: float | None, height: float | None) -> SiteOptions:
    """Return the site: what was typed; without that the defaults of file and variables, which a session's own site beats."""
    from imufield.commands.site import SiteOptions

    values = {"gravity": gravity, "latitude": latitude, "height": height}
    sources = {name: context.get_parameter_source(name) for name in values}
    typed = {name: value for name, value in values.items() if str(getattr(sources[name], "name", "")) == "COMMANDLINE"}
    if "gravity" in typed or "latitude" in typed:
        return SiteOptions(typed.get("gravity"), typed.get("latitude"), typed.get("height"))
    return SiteOptions(gravity, latitude, height, is_default="height" not in typed)


@app.command()
def demo(
    seed: Annotated[int, typer.Option(help="Seed of the simulated instrument and operator.", min=0)] = 1,
    speed: Annotated[float, typer.Option(help="Times real time.", min=1)] = 8.0,
    plain: Annotated[bool, typer.Option("--plain", help="Plain lines instead of pictures.")] = False,
) -> None:
    """Run the whole chain with no hardware: virtual IMU and operator, capture, solve.

    Example: imufield demo
    """
    from imufield.commands.demo import run_demo

    run_demo(seed=seed, speed=speed, plain=plain)


@app.command()
def devices(as_json: AsJson = False) -> None:
    """List serial ports and the instruments that have a driver.

    Example: imufield devices
    """
    from imufield.commands.devices import list_devices

    list_devices(as_json=as_json)


@app.command()
def capture(
    context: typer.Context,
    port: Port = None,
    driver: DriverName = None,
    baud: Baud = None,
    protocol: ProtocolFile = None,
    settings: Settings = None,
    positions: Annotated[str | None, typer.Option(help="Scheme: paper24, paper36, corners24, faces6 or a TOML list.")] = None,
    hold_s: Annotated[float | None, typer.Option(help="Seconds to hold each position.", min=1, max=600)] = None,
    session: SessionFolder = None,
    resume: Annotated[bool, typer.Option("--resume", help="Go on with an unfinished session.")] = False,
    gravity: GravityValue = None,
    latitude: Latitude = None,
    height: Height = None,
    plain: Annotated[bool, typer.Option("--plain", help="Plain lines instead of pictures.")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Events as JSON lines on standard output.")] = False,
    target_bias_ug: Annotated[
        float | None, typer.Option("--target-bias-ug", help="Hold and go on until biases are known so well, 1 sigma.", min=0.1)
    ] = None,
    target_scale_ppm: Annotated[
        float | None, typer.Option("--target-scale-ppm", help="The same for scale factors.", min=0.1)
    ] = None,
    rotations: Annotated[
        str | None, typer.Option(help="Whole turns for the gyroscope: rolled (edge over edge) or table (against a stop).")
    ] = None,
    quiet: Annotated[bool, typer.Option("--quiet", help="No sound.")] = False,
    speak: Annotated[bool, typer.Option("--speak", help="Say it aloud, where a speech program is installed.")] = False,
    big: Annotated[bool, typer.Option("--big", help="Big letters, to be read from three metres.")] = False,
    cable: Annotated[
        str | None, typer.Option(help="Side of the unit where the cable leaves, for the pictures: +x ... -z.")
    ] = None,
    clock_speed: ClockSpeed = 1.0,
) -> None:
    """Record a guided session: the screen leads you through 24 positions, hands-free.

    Example: imufield capture --port /dev/ttyUSB0 --latitude 48.1 --height 520
    """
    from imufield.commands.capture import CaptureOptions, run_capture
    from imufield.commands.configuration import parse_settings
    from imufield.commands.connect import ConnectOptions, host_clock
    from imufield.commands.views import Manner, parse_side

    options = CaptureOptions(
        connect=ConnectOptions(port, driver, baud, protocol, parse_settings(settings)),
        positions=positions,
        hold_s=hold_s,
        session=session,
        resume=resume,
        site=_site(context, gravity, latitude, height),
        view="json" if as_json else "plain" if plain else "auto",
        target_bias_ug=target_bias_ug,
        target_scale_ppm=target_scale_ppm,
        rotations=rotations,
        manner=Manner(quiet, speak, big, parse_side(cable)),
    )
    run_capture(options, host_clock(clock_speed))


@app.command()
def record(
    port: Port = None,
    driver: DriverName = None,
    baud: Baud = None,
    protocol: ProtocolFile = None,
    settings: Settings = None,
    session: SessionFolder = None,
    duration_s: Annotated[float | None, typer.Option(help="Stop after so many seconds (default: Ctrl-C).", min=0.1)] = None,
    as_json: AsJson = False,
    clock_speed: ClockSpeed = 1.0,
) -> None:
    """Record without a guide, e.g. hours of standstill.

    Example: imufield record --port /dev/ttyUSB0 --duration-s 3600
    """
    from imufield.commands.configuration import parse_settings
    from imufield.commands.connect import ConnectOptions, host_clock
    from imufield.commands.record import RecordOptions, run_record

    connect = ConnectOptions(port, driver, baud, protocol, parse_settings(settings))
    run_record(RecordOptions(connect, session, duration_s, as_json), host_clock(clock_speed))


@app.command(name="import")
def import_files(
    files: Annotated[list[Path], typer.Argument(help="Files of one recording; several are joined by time.")],
    output: Annotated[Path | None, typer.Option("-o", "--output", help="Folder of the new session.")] = None,
    driver: DriverName = None,
    protocol: Annotated[str | None, typer.Option(help="For a raw byte dump: protocol name or TOML file.")] = None,
    settings: Settings = None,
    columns: Annotated[str | None, typer.Option(help="Columns of a table, e.g. time,ax,ay,az,gx,gy,gz.")] = None,
    rate_hz: Annotated[float | None, typer.Option(help="Sample rate of a table without a time column.", min=1e-3)] = None,
    zero: Annotated[str | None, typer.Option(help="Raw output at zero input, one or three numbers (mid-scale).")] = None,
    as_json: AsJson = False,
) -> None:
    """Turn files of another program into a session.

    Example: imufield import acc.txt.gz gyro.txt.gz --zero 32768 -o my-session
    """
    from imufield.commands.configuration import parse_settings
    from imufield.commands.import_files import ImportOptions, run_import

    options = ImportOptions(files, output, protocol or driver, parse_settings(settings), columns, rate_hz, zero, as_json)
    run_import(options)


@app.command()
def replay(
    session: Annotated[Path | None, typer.Argument(help="Session folder (default: the newest).")] = None,
    to_pty: Annotated[bool, typer.Option("--to-pty", help="Replay the bytes to a virtual serial port.")] = False,
    speed: Annotated[float, typer.Option(help="Times real time for --to-pty; 0 is as fast as possible.", min=0)] = 1.0,
    as_json: Annotated[bool, typer.Option("--json", help="Events as JSON lines on standard output.")] = False,
) -> None:
    """Run a recorded session through the same chain again, or to a port for other programs.

    Example: imufield replay imufield-sessions/20260301T101500Z-stim300
    """
    from imufield.commands.replay import run_replay

    run_replay(session, to_pty=to_pty, speed=speed, as_json=as_json)


@app.command()
def solve(
    context: typer.Context,
    session: Annotated[Path | None, typer.Argument(help="Session folder (default: the newest).")] = None,
    observations: Annotated[Path | None, typer.Option(help="CSV of position means instead of a session.")] = None,
    gravity: GravityValue = None,
    latitude: Latitude = None,
    height: Height = None,
    model: Annotated[str, typer.Option(help="auto, linear or quadratic.")] = "auto",
    gauge: Annotated[str | None, typer.Option(help="preset, lower, upper or symmetric.")] = None,
    preset: Annotated[Path | None, typer.Option(help="Parameter file in force before.")] = None,
    zero: Annotated[str | None, typer.Option(help="Raw output at zero input, one or three numbers.")] = None,
    method: Annotated[str, typer.Option(help="least-squares, bsas, ide and others, see docs/study.md.")] = "least-squares",
    polish: Annotated[bool, typer.Option(help="Finish another method by least squares.")] = True,
    cross_check: Annotated[bool, typer.Option("--cross-check", help="Solve by bsas, ide and least squares, compare.")] = False,
    gyro_model: Annotated[str, typer.Option(help="auto, basic or g-sensitive.")] = "auto",
    seed: Annotated[int, typer.Option(help="Seed of everything random.", min=0)] = 0,
    output: Annotated[Path | None, typer.Option("-o", "--output", help="Where to write the parameter file.")] = None,
    as_json: AsJson = False,
) -> None:
    """Solve a session: parameters with uncertainty, and a verdict in words.

    Example: imufield solve --latitude 48.1 --height 520
    """
    from imufield.commands.solve import SolveOptions, run_solve

    options = SolveOptions(
        session=session,
        observations=observations,
        site=_site(context, gravity, latitude, height),
        model=model,
        gauge=gauge,
        preset=preset,
        zero=zero,
        method=method,
        polish=polish,
        cross_check=cross_check,
        gyroscope_model=gyro_model,
        seed=seed,
        output=output,
        as_json=as_json,
    )
    run_solve(options)


@app.command()
def export(
    parameters: Annotated[Path, typer.Argument(help="Parameter file.")],
    to: Annotated[str | None, typer.Option(help="Target, e.g. c, px4, vectornav (default: list them).")] = None,
    settings: Settings = None,
    output: Annotated[
        Path | None, typer.Option("-o", "--output", help="File or folder (default: the usual names here).")
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Write the parameters in another program's format, and say what it cannot hold.

    Example: imufield export my-session/parameters.toml --to c -o calibration.h
    """
    from imufield.commands.export import run_export

    run_export(parameters, to, settings, output, as_json=as_json)


@app.command()
def apply(
    parameters: Annotated[Path, typer.Argument(help="Parameter file.")],
    source: Annotated[Path, typer.Argument(help="Session folder, or a table (CSV).")],
    output: Annotated[Path, typer.Option("-o", "--output", help="CSV to write.")],
) -> None:
    """Correct a recording with the parameters.

    Example: imufield apply my-session/parameters.toml my-session -o corrected.csv
    """
    from imufield.commands.apply import run_apply

    run_apply(parameters, source, output)


@app.command()
def noise(
    session: Annotated[Path | None, typer.Argument(help="Session folder (default: the newest).")] = None,
    to: Annotated[str, typer.Option(help="Form of --output: kalibr, openvins or vins.")] = "kalibr",
    output: Annotated[Path | None, typer.Option("-o", "--output", help="YAML for a navigation filter.")] = None,
    plot: Annotated[Path | None, typer.Option(help="Draw the Allan deviation into this file (needs matplotlib).")] = None,
    parameters: Annotated[Path | None, typer.Option(help="Parameter file to write the table `noise` into.")] = None,
    as_json: AsJson = False,
) -> None:
    """Measure the noise of hours of standstill by Allan deviation.

    Example: imufield noise my-standstill --plot allan.png
    """
    from imufield.commands.noise import NoiseOptions, run_noise

    run_noise(NoiseOptions(session, to, output, plot, parameters, as_json))


@app.command()
def study(
    name: Annotated[str, typer.Argument(help="A study, e.g. bsas-table3, or bsas, ide, all.")],
    quick: Annotated[bool, typer.Option("--quick", help="Few runs, to see that it works.")] = False,
    seed: Annotated[int, typer.Option(help="Seed of all runs.", min=0)] = 1,
    workers: Annotated[int | None, typer.Option(help="Processes (default: all cores).", min=1)] = None,
    scheduler: Annotated[str | None, typer.Option(help="Address of a Dask scheduler.")] = None,
    output: Annotated[Path | None, typer.Option("-o", "--output", help="Folder for CSV files and plots.")] = None,
    document: Annotated[Path | None, typer.Option(help="Write all as one Markdown document.")] = None,
) -> None:
    """Reproduce a table or figure of the papers, paper's and our figures side by side.

    Example: imufield study bsas-table3 --quick
    """
    from imufield.commands.study import run_study_command

    run_study_command(name, quick=quick, seed=seed, workers=workers, scheduler=scheduler, output=output, document=document)


@app.command(name="export-data")
def export_data(
    session: Annotated[Path | None, typer.Argument(help="Session folder (default: the newest).")] = None,
    to: Annotated[str, typer.Option(help="csv.")] = "csv",
    output: Annotated[Path | None, typer.Option("-o", "--output", help="File to write (default: SESSION/samples.csv).")] = None,
) -> None:
    """Write the decoded samples of a session for other programs.

    Example: imufield export-data my-session --to csv -o samples.csv
    """
    from imufield.commands.export_data import run_export_data

    run_export_data(session, to, output)


@app.command()
def verify(
    context: typer.Context,
    parameters: Annotated[Path, typer.Argument(help="Parameter file under test.")],
    session: Annotated[Path | None, typer.Argument(help="Session they have not seen (default: the newest).")] = None,
    preset: Annotated[Path | None, typer.Option(help="Parameter file to compare with (default: no correction).")] = None,
    hold_out: Annotated[
        int | None, typer.Option(help="Solve without so many positions at a time and check those.", min=1)
    ] = None,
    turned: Annotated[bool, typer.Option("--turned", help="The instrument was turned over after the alignment.")] = False,
    align_s: Annotated[float, typer.Option(help="Seconds of rest at the start to align with.", min=1)] = 600.0,
    gravity: GravityValue = None,
    latitude: Latitude = None,
    height: Height = None,
    require: Annotated[str | None, typer.Option(help="Limits, e.g. residual-ug=50,nav-nmi-per-h=1.")] = None,
    turn_on_ug: Annotated[float | None, typer.Option(help="Turn-on bias of the accelerometer, 1 sigma.", min=0)] = None,
    turn_on_deg_per_h: Annotated[float | None, typer.Option(help="Turn-on bias of the gyroscope, 1 sigma.", min=0)] = None,
    seed: Annotated[int, typer.Option(help="Seed of the forecast.", min=0)] = 0,
    output: Annotated[Path | None, typer.Option("-o", "--output", help="Where to keep the results for the report.")] = None,
    as_json: AsJson = False,
) -> None:
    """Prove parameters on data they have not seen: held-out positions, and hours of static navigation.

    Example: imufield verify parameters.toml rest-of-5-hours --require nav-nmi-per-h=1
    """
    from imufield.commands.verify import VerifyOptions, run_verify

    options = VerifyOptions(
        parameters,
        session,
        preset,
        hold_out,
        turned,
        align_s,
        _site(context, gravity, latitude, height),
        require,
        turn_on_ug,
        turn_on_deg_per_h,
        seed,
        output,
        as_json,
    )
    run_verify(options)


@app.command()
def report(
    session: Annotated[Path | None, typer.Argument(help="Session folder (default: the newest).")] = None,
    parameters: Annotated[Path | None, typer.Option(help="Parameter file (default: SESSION/parameters.toml).")] = None,
    preset: Annotated[Path | None, typer.Option(help="Parameter file in force before, to compare with.")] = None,
    operator: Annotated[str, typer.Option(help="Who calibrated, for the record.")] = "",
    output: Annotated[Path | None, typer.Option("-o", "--output", help="Page (default: SESSION/report.html).")] = None,
    record: Annotated[Path | None, typer.Option(help="Calibration record (default: SESSION/calibration-record.html).")] = None,
) -> None:
    """Write the report of a session, one page that needs no network, and a calibration record of one sheet.

    Example: imufield report my-session --operator "J. Doe"
    """
    from imufield.commands.report import ReportOptions, run_report

    run_report(ReportOptions(session, parameters, preset, output, record, operator))


@app.command()
def history(
    folder: Annotated[Path, typer.Argument(help="Folder of parameter files, searched below too.")] = Path("imufield-sessions"),
    serial: Annotated[str | None, typer.Option(help="Only this serial number.")] = None,
    stale_days: Annotated[float, typer.Option(help="Age at which a calibration is old.", min=0)] = 365.0,
    csv: Annotated[Path | None, typer.Option(help="Write every number of every calibration to this file.")] = None,
    plot: Annotated[Path | None, typer.Option(help="Draw one instrument over time, SVG.")] = None,
    as_json: AsJson = False,
) -> None:
    """Show how the parameters of each instrument changed from calibration to calibration, in units of sigma.

    Example: imufield history calibrations --serial 1234 --plot drift.svg
    """
    from imufield.commands.history import HistoryOptions, run_history

    run_history(HistoryOptions(folder, serial, stale_days, csv, plot, as_json))


@app.command()
def emulate(
    driver: Annotated[str, typer.Argument(help="Instrument family, see `imufield devices`.")],
    rate_hz: Annotated[float | None, typer.Option(help="Sample rate (default: the instrument's usual one).", min=1)] = None,
    speed: Annotated[float, typer.Option(help="Times real time.", min=0.1)] = 1.0,
    grade: Annotated[str, typer.Option(help="navigation, tactical, industrial or mems.")] = "tactical",
    seed: Annotated[int, typer.Option(help="Seed of instrument, operator and faults.", min=0)] = 1,
    positions: Annotated[str, typer.Option(help="Scheme the operator works through; `none`: it lies still.")] = "paper24",
    style: Annotated[str, typer.Option(help="placed (on a surface) or held (in the hand).")] = "placed",
    hold_s: Annotated[float, typer.Option(help="Seconds the virtual operator holds each position.", min=1)] = 14.0,
    wait: Annotated[bool, typer.Option("--wait", help="Power on when a program opens the port.")] = False,
    link: Annotated[Path | None, typer.Option(help="Make a symbolic link to the port here.")] = None,
    truth: Annotated[Path | None, typer.Option(help="Write the true parameters and stills to this file.")] = None,
    duration_s: Annotated[float | None, typer.Option(help="Stop after so many seconds of sample time.", min=0.1)] = None,
    fault: Annotated[list[str] | None, typer.Option(help="E.g. bit_flip_probability=1e-4; may be repeated.")] = None,
    as_json: AsJson = False,
) -> None:
    """Pretend to be an instrument on a virtual serial port.

    Example: imufield emulate stim300 --wait --link /tmp/imu
    """
    from imufield.commands.emulate import EmulateOptions, run_emulate

    options = EmulateOptions(
        driver, rate_hz, speed, grade, seed, positions, hold_s, link, truth, duration_s, fault or [], wait, style, as_json
    )
    run_emulate(options)


class Interrupted(KeyboardInterrupt):
    """SIGTERM or SIGHUP, handled as Ctrl-C is."""


def _raise_interrupted(signal_number: int, frame: FrameType | None) -> None:  # noqa: ARG001  (signature of a handler)
    raise Interrupted(signal.Signals(signal_number).name)


@contextlib.contextmanager
def _signals_as_interrupts() -> Iterator[None]:
    """Turn SIGTERM and SIGHUP into the exception of Ctrl-C, so that every path closes its files."""
    numbers = [getattr(signal, name) for name in ("SIGTERM", "SIGHUP") if hasattr(signal, name)]
    previous: list[tuple[int, Any]] = [(number, signal.signal(number, _raise_interrupted)) for number in numbers]
    try:
        yield
    finally:
        for number, handler in previous:
            signal.signal(number, handler)


def main() -> None:
    """Run the command line and leave with the exit code of DESIGN section 6."""
    # The matrices are small: threads of the linear algebra would double the processor time and gain nothing.
    for library in ("OPENBLAS", "MKL", "OMP"):
        os.environ.setdefault(f"{library}_NUM_THREADS", "1")
    sys.exit(run(sys.argv[1:]))


def run(arguments: list[str]) -> int:
    """Run one command and return its exit code; a defect of ours leaves its traceback (code 1)."""
    try:
        return _run(arguments)
    except OSError as error:
        # Files and ports have errors of their own kind: what comes here is about standard output.
        if error.errno in (errno.ENOSPC, errno.EFBIG, errno.EDQUOT):
            _forget(sys.stdout)
            _complain(f"standard output cannot be written ({error.strerror}); free some space, or send it elsewhere")
            return RecordingError.exit_code
        # The reader of our output went away (`imufield ... | head`), or the terminal was closed: there is nobody to tell.
        closed = error.errno == errno.EIO and _was_interrupted(error)
        if not (closed or isinstance(error, BrokenPipeError)):
            raise
        _forget(sys.stdout)
        _forget(sys.stderr)
        return EXIT_INTERRUPTED


def _forget(stream: TextIO) -> None:
    """Let nothing more be said there, by the interpreter on its way out either."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())


def _complain(message: str) -> None:
    typer.secho(f"imufield: {message.rstrip('.')}.", fg="red", err=True)


def _run(arguments: list[str]) -> int:
    try:
        with _signals_as_interrupts():
            app(arguments, prog_name="imufield")
    except ImufieldError as error:
        _complain(error.message)
        return error.exit_code
    except SystemExit as leave:
        if isinstance(leave.__context__, BrokenPipeError):
            # typer leaves with 1 then, which is kept for defects.
            raise leave.__context__ from None
        if leave.code == EXIT_INTERRUPTED or isinstance(leave.__context__, typer.Abort):
            typer.secho("imufield: interrupted; what was recorded is on disk.", err=True)
            return EXIT_INTERRUPTED
        return leave.code if isinstance(leave.code, int) else 0
    return 0


def _was_interrupted(error: BaseException) -> bool:
    """Whether an error came up while an interrupt was on its way out."""
    cause: BaseException | None = error
    while cause is not None and not isinstance(cause, KeyboardInterrupt | typer.Abort):
        cause = cause.__context__
    return cause is not None
