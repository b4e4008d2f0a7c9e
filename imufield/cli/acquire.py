"""Arguments of the commands that get samples: from hardware, from files, from a virtual instrument."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from imufield.cli.options import (
    LARGEST_SEED,
    AsJson,
    Baud,
    Bus,
    ClockSpeed,
    DbcFile,
    DriverName,
    GravityValue,
    Height,
    Latitude,
    Port,
    ProtocolFile,
    RateHz,
    SessionFolder,
    Settings,
    SignalMap,
    TableRateHz,
    connect_options,
    site,
    within,
)


def demo(
    seed: Annotated[
        int, typer.Option(help="Seed of the simulated instrument and operator.", callback=within(0, LARGEST_SEED))
    ] = 2,
    speed: Annotated[float, typer.Option(help="Times real time.", callback=within(1))] = 8.0,
    plain: Annotated[bool, typer.Option("--plain", help="Plain lines instead of pictures.")] = False,
) -> None:
    """Run the whole chain with no hardware: virtual IMU and operator, capture, solve.

    Example: imufield demo
    """
    from imufield.commands.demo import run_demo

    run_demo(seed=seed, speed=speed, plain=plain)


def devices(as_json: AsJson = False) -> None:
    """List serial ports, CAN interfaces and the instruments that have a driver.

    Example: imufield devices
    """
    from imufield.commands.devices import list_devices

    list_devices(as_json=as_json)


def probe(
    *,
    context: typer.Context,
    port: Port = None,
    bus: Bus = None,
    baud: Baud = None,
    ask: Annotated[bool, typer.Option("--ask", help="Ask the instrument who it is: the only thing that is sent.")] = False,
    as_json: AsJson = False,
    clock_speed: ClockSpeed = 1.0,
) -> None:
    """Listen and say what instrument is on a port (default: on every port) or a CAN bus, and how to read it.

    Example: imufield probe --port /dev/ttyUSB0

    Example: imufield probe --bus socketcan:can0
    """
    from imufield.commands.probe import run_probe, run_probe_bus
    from imufield.commands.terminal.connection import host_clock

    options = connect_options(
        context=context, port=port, bus=bus, driver=None, baud=baud, protocol=None, dbc=None, mapping=None, settings=None
    )
    if options.bus is not None:
        run_probe_bus(options, host_clock(clock_speed), ask=ask, as_json=as_json)
        return
    run_probe(options.port, baud, host_clock(clock_speed), ask=ask, as_json=as_json)


def capture(
    *,
    context: typer.Context,
    port: Port = None,
    bus: Bus = None,
    driver: DriverName = None,
    baud: Baud = None,
    protocol: ProtocolFile = None,
    dbc: DbcFile = None,
    mapping: SignalMap = None,
    settings: Settings = None,
    rate_hz: RateHz = None,
    positions: Annotated[str | None, typer.Option(help="Scheme: paper24, paper36, corners24, faces6 or a TOML list.")] = None,
    hold_s: Annotated[float | None, typer.Option(help="Seconds to hold each position.", callback=within(1, 600))] = None,
    session: SessionFolder = None,
    resume: Annotated[bool, typer.Option("--resume", help="Go on with an unfinished session.")] = False,
    gravity: GravityValue = None,
    latitude: Latitude = None,
    height: Height = None,
    plain: Annotated[bool, typer.Option("--plain", help="Plain lines instead of pictures.")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Events as JSON lines on standard output.")] = False,
    target_bias_ug: Annotated[
        float | None,
        typer.Option("--target-bias-ug", help="Hold and go on until biases are known so well, 1 sigma.", callback=within(0.1)),
    ] = None,
    target_scale_ppm: Annotated[
        float | None, typer.Option("--target-scale-ppm", help="The same for scale factors.", callback=within(0.1))
    ] = None,
    preset: Annotated[
        Path | None,
        typer.Option(help="Parameter file in force before: shows a wrong gravity.", readable=False),
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
    from imufield.commands.terminal.connection import host_clock
    from imufield.commands.terminal.views import Manner, parse_side

    options = CaptureOptions(
        connect=connect_options(
            context=context,
            port=port,
            bus=bus,
            driver=driver,
            baud=baud,
            protocol=protocol,
            dbc=dbc,
            mapping=mapping,
            settings=settings,
            rate_hz=rate_hz,
        ),
        positions=positions,
        hold_s=hold_s,
        session=session,
        resume=resume,
        site=site(context, gravity, latitude, height),
        view="json" if as_json else "plain" if plain else "auto",
        target_bias_ug=target_bias_ug,
        target_scale_ppm=target_scale_ppm,
        preset=preset,
        rotations=rotations,
        manner=Manner(quiet, speak, big, parse_side(cable)),
    )
    run_capture(options, host_clock(clock_speed))


def record(
    *,
    context: typer.Context,
    port: Port = None,
    bus: Bus = None,
    driver: DriverName = None,
    baud: Baud = None,
    protocol: ProtocolFile = None,
    dbc: DbcFile = None,
    mapping: SignalMap = None,
    settings: Settings = None,
    rate_hz: RateHz = None,
    session: SessionFolder = None,
    gravity: GravityValue = None,
    latitude: Latitude = None,
    height: Height = None,
    duration_s: Annotated[
        float | None, typer.Option(help="Stop after so many seconds (default: Ctrl-C).", callback=within(0.1))
    ] = None,
    as_json: AsJson = False,
    clock_speed: ClockSpeed = 1.0,
) -> None:
    """Record without a guide, e.g. hours of standstill.

    Example: imufield record --port /dev/ttyUSB0 --duration-s 3600

    Example: imufield record --bus socketcan:can0 --driver aceinna_can
    """
    from imufield.commands.record import RecordOptions, run_record
    from imufield.commands.terminal.connection import host_clock

    connect = connect_options(
        context=context,
        port=port,
        bus=bus,
        driver=driver,
        baud=baud,
        protocol=protocol,
        dbc=dbc,
        mapping=mapping,
        settings=settings,
        rate_hz=rate_hz,
    )
    options = RecordOptions(
        connect=connect,
        session=session,
        duration_s=duration_s,
        as_json=as_json,
        site=site(context, gravity, latitude, height),
    )
    run_record(options, host_clock(clock_speed))


def import_files(
    *,
    context: typer.Context,
    files: Annotated[list[Path], typer.Argument(help="Files of one recording; several are joined by time.", readable=False)],
    output: Annotated[Path | None, typer.Option("-o", "--output", help="Folder of the new session.", readable=False)] = None,
    driver: DriverName = None,
    protocol: Annotated[str | None, typer.Option(help="For a raw byte dump: protocol name or TOML file.")] = None,
    dbc: Annotated[Path | None, typer.Option(help="For a log of a CAN bus: DBC file.", readable=False)] = None,
    mapping: SignalMap = None,
    channel: Annotated[str | None, typer.Option(help="For a log of several CAN buses: which, e.g. can0.")] = None,
    topic: Annotated[str | None, typer.Option(help="For a recording of ROS: which topic, e.g. /imu/data.")] = None,
    settings: Settings = None,
    columns: Annotated[str | None, typer.Option(help="Columns of a table, e.g. time,ax,ay,az,gx,gy,gz.")] = None,
    rate_hz: TableRateHz = None,
    zero: Annotated[str | None, typer.Option(help="Raw output at zero input, one or three numbers (mid-scale).")] = None,
    gravity: GravityValue = None,
    latitude: Latitude = None,
    height: Height = None,
    replace: Annotated[
        bool, typer.Option("--replace", help="Put it in the place of an earlier import that is not solved yet.")
    ] = False,
    as_json: AsJson = False,
) -> None:
    """Turn files of another program into a session: tables, MATLAB, HDF5, Parquet, ROS, CAN logs, raw bytes.

    Example: imufield import acc.txt.gz gyro.txt.gz --zero 32768 -o my-session

    Example: imufield import drive.blf --driver aceinna_can
    """
    from imufield.commands.configuration import parse_settings
    from imufield.commands.import_files import ImportOptions, run_import
    from imufield.commands.terminal.connection import parse_mapping

    options = ImportOptions(
        files=files,
        output=output,
        protocol=protocol,
        settings=parse_settings(settings),
        columns=columns,
        rate_hz=rate_hz,
        zero=zero,
        as_json=as_json,
        driver=driver,
        dbc=dbc,
        mapping=parse_mapping(mapping),
        channel=channel,
        topic=topic,
        site=site(context, gravity, latitude, height),
        replace=replace,
    )
    run_import(options)


def replay(
    *,
    session: Annotated[Path | None, typer.Argument(help="Session folder (default: the newest).", readable=False)] = None,
    to_pty: Annotated[bool, typer.Option("--to-pty", help="Replay the bytes to a virtual serial port.")] = False,
    bus: Annotated[str | None, typer.Option(help="Replay the frames to a CAN bus, e.g. socketcan:vcan0.")] = None,
    baud: Annotated[
        int | None, typer.Option(help="Bit rate of the bus, where it is set on opening.", callback=within(50))
    ] = None,
    speed: Annotated[
        float, typer.Option(help="Times real time for --to-pty and --bus; 0 is as fast as possible.", callback=within(0))
    ] = 1.0,
    as_json: Annotated[bool, typer.Option("--json", help="Events as JSON lines on standard output.")] = False,
) -> None:
    """Run a recorded session through the same chain again, or to a port or bus for other programs.

    Example: imufield replay imufield-sessions/20260301T101500Z-stim300
    """
    from imufield.commands.replay import ReplayOptions, run_replay

    run_replay(ReplayOptions(session=session, to_pty=to_pty, bus=bus, bit_rate=baud, speed=speed, as_json=as_json))


def emulate(
    *,
    driver: Annotated[str, typer.Argument(help="Instrument family, see `imufield devices`, or your protocol file (.toml).")],
    form: Annotated[str | None, typer.Option(help="What it sends, e.g. RAWIMUX; a wrong name lists all.")] = None,
    settings: Settings = None,
    bus: Annotated[str | None, typer.Option(help="CAN bus, e.g. udp_multicast:239.0.0.1 (default: slcan on a port).")] = None,
    rate_hz: Annotated[
        float | None, typer.Option(help="Sample rate (default: the instrument's usual one).", callback=within(1))
    ] = None,
    speed: Annotated[float, typer.Option(help="Times real time.", callback=within(0.1))] = 1.0,
    grade: Annotated[str, typer.Option(help="navigation, tactical, industrial or mems.")] = "tactical",
    seed: Annotated[int, typer.Option(help="Seed of instrument, operator and faults.", callback=within(0, LARGEST_SEED))] = 1,
    day: Annotated[
        int, typer.Option(help="Another day of the instrument: other noise, tilts, faults.", callback=within(0, LARGEST_SEED))
    ] = 0,
    positions: Annotated[str, typer.Option(help="Scheme the operator works through; `none`: it lies still.")] = "paper24",
    rounds: Annotated[
        int | None,
        typer.Option(help="How often: what a reader missed comes up again (20; 1 before turns).", callback=within(1, 1000)),
    ] = None,
    style: Annotated[str, typer.Option(help="placed (on a surface) or held (in the hand).")] = "placed",
    rotations: Annotated[str | None, typer.Option(help="Whole turns after the positions: rolled or table.")] = None,
    hold_s: Annotated[float, typer.Option(help="Seconds the virtual operator holds each position.", callback=within(1))] = 14.0,
    wait: Annotated[
        bool | None,
        typer.Option("--wait/--no-wait", help="Begin when a program opens the port (default without --json, --duration-s)."),
    ] = None,
    link: Annotated[Path | None, typer.Option(help="Make a symbolic link to the port here.", readable=False)] = None,
    truth: Annotated[
        Path | None, typer.Option(help="Write the true parameters and stills to this file.", readable=False)
    ] = None,
    duration_s: Annotated[
        float | None, typer.Option(help="Stop after so many seconds of sample time.", callback=within(0.1))
    ] = None,
    fault: Annotated[list[str] | None, typer.Option(help="E.g. bit_flip_probability=1e-4; may be repeated.")] = None,
    as_json: AsJson = False,
) -> None:
    """Pretend to be an instrument on a virtual serial port or a CAN bus.

    Example: imufield emulate xsens_mtdata2 --form fp16.32 --wait --link /tmp/imu
    """
    from imufield.commands.configuration import parse_settings
    from imufield.commands.emulate import EmulateOptions, run_emulate

    options = EmulateOptions(
        driver=driver,
        rate_hz=rate_hz,
        speed=speed,
        grade=grade,
        seed=seed,
        day=day,
        positions=positions,
        hold_s=hold_s,
        link=link,
        truth=truth,
        duration_s=duration_s,
        faults=fault or [],
        # A person starts the reader a minute later; a script says what it wants.
        wait_for_reader=not as_json and duration_s is None if wait is None else wait,
        style=style,
        rotations=rotations,
        as_json=as_json,
        form=form,
        settings=parse_settings(settings),
        bus=bus,
        rounds=rounds,
    )
    run_emulate(options)
