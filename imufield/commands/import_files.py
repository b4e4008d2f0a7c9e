"""``imufield import``: files of other programs become a session."""

from __future__ import annotations

import json
import math
import shlex
import shutil
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import typer

from imufield.acquire.decode.statistics import remarks
from imufield.acquire.decoder import Decoder
from imufield.acquire.formats.ros_bags import is_bag
from imufield.acquire.formats.table_columns import TIME_UNIT
from imufield.acquire.formats.table_text import read_pieces
from imufield.acquire.formats.tables import ROWS_PROTOCOL, ImportedTable, read_tables, write_rows
from imufield.acquire.instrument.connected import assumed
from imufield.acquire.link.host_clock import SystemClock
from imufield.acquire.link.serial import Chunk
from imufield.acquire.protocol.protocol import Protocol, load_protocol
from imufield.acquire.recording.part_file import is_part
from imufield.acquire.recording.recorder import Recorder
from imufield.acquire.recording.session import LOCK_FILE, SETTINGS_FILE, Session, create_session
from imufield.acquire.recording.session_record import SettingRecord
from imufield.acquire.registry import load_driver
from imufield.commands.options.acquire import ImportOptions
from imufield.commands.terminal.output import say
from imufield.deliver.parameters.numbers import beside
from imufield.errors import Reason, RecordingError, UsageError
from imufield.pipeline.chain import part_metadata
from imufield.pipeline.table_samples import refuse_endless

DUMP_CHUNK_BYTES = 1 << 16  # Small beside a block of the recorder, large beside a call.


def run_import(options: ImportOptions) -> Session:
    """Import and tell what was assumed.

    Raises
    ------
    ImufieldError
        A file cannot be read or understood.
    """
    session, sentences = import_session(options)
    if options.as_json:
        typer.echo(json.dumps({"event": "imported", "session": str(session.folder), "assumptions": sentences}))
        return session
    for sentence in sentences:
        say(sentence, err=True, indent=2)
    typer.echo(beside("session", session.folder))
    typer.echo(beside("next: ", f"imufield solve {shlex.quote(str(session.folder))}"))
    return session


def import_session(options: ImportOptions) -> tuple[Session, list[str]]:
    """Return the new session and what was assumed, in sentences; raises as ``run_import``."""
    refuse_endless(options.files)
    _refuse_own(options.files)
    options.site.gravity()
    protocol = _protocol(options)
    _refuse_ignored(options, protocol)
    # All that can be refused without the data is refused by now: an earlier import is put aside for good reasons only.
    with _in_place_of_earlier(options):
        if protocol is None:
            _refuse_can_log(options)
            return _import_tables(options)
        return _import_dump(options, protocol) if protocol.can is None else _import_can(options, protocol)


def _protocol(options: ImportOptions) -> Protocol | None:
    """Return what the files are to be decoded by, a file before a driver; None for tables.

    Raises
    ------
    UsageError
        If protocol and DBC file are both given, or a mapping without a DBC file.
    """
    if options.protocol is not None and options.dbc is not None:
        raise UsageError("--protocol and --dbc contradict each other; give one of them")
    if options.mapping and options.dbc is None:
        raise UsageError("--map names signals of a DBC file; give the file with --dbc")
    if options.dbc is not None:
        # The package that reads DBC files is slow to import, and most imports are of tables.
        from imufield.acquire.instrument.can_map import protocol_from_dbc

        return protocol_from_dbc(options.dbc, options.mapping, options.settings)
    if options.protocol is not None:
        return load_protocol(options.protocol, options.settings)
    return None if options.driver is None else load_driver(options.driver).load_protocol(options.settings)


def _refuse_ignored(options: ImportOptions, protocol: Protocol | None) -> None:
    """Refuse options that would change nothing.

    Raises
    ------
    UsageError
        If there is one.
    """
    if options.channel is not None and (protocol is None or protocol.can is None):
        raise UsageError("--channel is for logs of several CAN buses; leave it out")
    if options.topic is not None and not (protocol is None and any(is_bag(path) for path in options.files)):
        raise UsageError("--topic is for recordings of ROS; leave it out")
    if options.protocol is not None and options.driver is not None:
        raise UsageError(f"--protocol {options.protocol} and --driver {options.driver} contradict each other; give one of them")


def _refuse_own(paths: Sequence[Path]) -> None:
    """Refuse our own recordings, which are to be solved as they are.

    Raises
    ------
    UsageError
        If there is one.
    """
    for path in paths:
        # Also where one file of a session is named: what it is of is what the person has to solve.
        folder = path if path.is_dir() else path.parent
        if is_part(path) or (folder == path and (path / SETTINGS_FILE).is_file()) or path.name == SETTINGS_FILE:
            raise UsageError(
                f"{path} is of a session of imufield, which needs no import: `imufield solve {shlex.quote(str(folder))}` "
                "takes it as it is",
                path=str(path),
            )


def _refuse_can_log(options: ImportOptions) -> None:
    """Refuse a log of a CAN bus of which nobody says what is on it: its frames alone mean nothing."""
    from imufield.acquire.formats.can_logs import begins_as_can_log

    for path in options.files:
        if begins_as_can_log(path):
            raise UsageError(
                f"{path} is a log of a CAN bus; say what is on it with --driver, or with --dbc and --map", path=str(path)
            )


def _import_can(options: ImportOptions, protocol: Protocol) -> tuple[Session, list[str]]:
    """Put the frames of logs into a recording; they arrive when the logs say."""
    from imufield.acquire.formats.can_logs import import_log

    if options.columns or options.rate_hz or options.zero:
        raise UsageError("--columns, --rate-hz and --zero are for tables; a log of a CAN bus has its --set")
    sentences = _try_can(options, protocol)
    with _whole_or_nothing(_new_session(options, protocol, None), protocol) as (session, recorder):
        for path in options.files:
            # What is lost was said while the logs were tried.
            import_log(path, recorder, channel=options.channel, losses=[])
    return session, sentences


def _try_can(options: ImportOptions, protocol: Protocol) -> list[str]:
    """Decode before anything is made of the logs; return what there is to say of them. Raises as ``_try_dump``."""
    from imufield.acquire.formats.can_logs import read_log

    losses: list[str] = []
    decoder = Decoder(protocol)
    for path in options.files:
        for chunk in read_log(path, channel=options.channel, losses=losses):
            decoder.feed(chunk.data, chunk.monotonic_s)
    decoder.flush()
    counts = decoder.statistics
    if not counts.samples:
        kinds = ", ".join(f"{name}: {count}" for name, count in counts.by_kind.items())
        raise RecordingError(
            f"{', '.join(map(str, options.files))}: {counts.frames} frames hold no sample of {protocol.name} ({kinds}); give "
            "the --driver or the --map that fits",
            Reason.NO_FRAMES,
            frames=counts.frames,
        )
    said = f"{counts.samples} samples of {counts.frames} frames, {counts.lost} lost"
    return [*losses, said, *remarks([counts]), *assumed(protocol)]


def _import_tables(options: ImportOptions) -> tuple[Session, list[str]]:
    table = read_tables(
        options.files,
        columns=options.columns,
        rate_hz=options.rate_hz,
        zero=options.zero,
        settings=options.settings,
        topic=options.topic,
    )
    # The unit of time is spent when the rows are made; their protocol does not know it.
    of_rows = {name: value for name, value in (options.settings or {}).items() if name != TIME_UNIT}
    protocol = load_protocol(ROWS_PROTOCOL, {**of_rows, **table.settings})
    with _whole_or_nothing(_new_session(options, protocol, table), protocol) as (session, recorder):
        write_rows(recorder, table.rows, table.status, table.counter)
    return session, list(table.assumptions)


def _import_dump(options: ImportOptions, protocol: Protocol) -> tuple[Session, list[str]]:
    """Put the bytes of a dump into a recording as they are; there is no arrival time but the order."""
    if options.columns or options.rate_hz or options.zero:
        raise UsageError("--columns, --rate-hz and --zero are for tables; a byte dump has its --protocol and --set")
    sentences = _try_dump(options.files, protocol)
    utc_ns = SystemClock().utc_ns()
    with _whole_or_nothing(_new_session(options, protocol, None), protocol) as (session, recorder):
        for path in options.files:
            for data in read_pieces(path, DUMP_CHUNK_BYTES):
                recorder.write_chunk(Chunk(data, math.nan, utc_ns))
    return session, sentences


def _try_dump(files: list[Path], protocol: Protocol) -> list[str]:
    """Decode before anything is made of the files; return what there is to say of them.

    Raises
    ------
    RecordingError
        If there is not a single sample in them, or one cannot be read.
    """
    decoder = Decoder(protocol)
    for path in files:
        for data in read_pieces(path, DUMP_CHUNK_BYTES):
            decoder.feed(data)
    decoder.flush()
    counts = decoder.statistics
    names = ", ".join(map(str, files))
    if not counts.samples:
        raise RecordingError(
            f"{names}: {counts.bytes_total} bytes hold no sample of {protocol.name} ({counts.frames_bad_checksum} frames with "
            "a bad checksum); give the --protocol they were recorded with",
            Reason.NO_FRAMES,
            bytes=counts.bytes_total,
        )
    said = f"{counts.samples} samples, {counts.bytes_skipped} of {counts.bytes_total} bytes skipped"
    return [said, *remarks([counts]), *assumed(protocol)]


@contextmanager
def _in_place_of_earlier(options: ImportOptions) -> Iterator[None]:
    """Put an earlier import aside, and remove it when the new one is whole.

    Raises
    ------
    UsageError
        If ``replace`` says nothing, or what is there is no import or holds more than one.
    """
    folder = options.output
    if not options.replace:
        yield
        return
    if folder is None:
        raise UsageError("--replace needs the folder of the earlier import; give it with --output")
    if not (folder / SETTINGS_FILE).exists():
        yield
        return
    earlier = Session.open(folder)
    kind = earlier.record.kind
    # Nothing goes that cannot be imported again from its files.
    if kind != "import":
        raise UsageError(f"--replace goes for imports alone, and {folder} is a {kind}; choose a new folder")
    own = {SETTINGS_FILE, LOCK_FILE, *(part.name for part in earlier.parts)}
    others = sorted(path.name for path in folder.iterdir() if path.name not in own)
    if others:
        raise UsageError(f"{folder} holds {', '.join(others[:3])} besides the import; move that away, or choose a new folder")
    # In the same folder, so that it can be renamed back; hidden from what looks for sessions.
    aside = folder.with_name(f".{folder.name}.replaced")
    shutil.rmtree(aside, ignore_errors=True)
    folder.rename(aside)
    try:
        yield
    except BaseException:
        aside.rename(folder)
        raise
    shutil.rmtree(aside, ignore_errors=True)


@contextmanager
def _whole_or_nothing(session: Session, protocol: Protocol) -> Iterator[tuple[Session, Recorder]]:
    """Record into a new session and finish it; remove it if it cannot be completed: its files can be imported again.

    Raises
    ------
    RecordingError
        If the disk is full.
    """
    try:
        with Recorder(session.add_part(), part_metadata(protocol, {})) as recorder:
            yield session, recorder
    except BaseException as error:
        # The folder was new or empty.
        shutil.rmtree(session.folder, ignore_errors=True)
        if isinstance(error, RecordingError) and error.reason is Reason.DISK_FULL:
            raise RecordingError(
                f"{session.folder} cannot hold the import, the disk or its quota is full: free some space, or give another "
                "place with --output, and import again.",
                Reason.DISK_FULL,
                path=str(session.folder),
            ) from error
        raise
    session.update(finished=True)


def _new_session(options: ImportOptions, protocol: Protocol, table: ImportedTable | None) -> Session:
    metadata: dict[str, object] = {
        "kind": "import",
        "instrument": {"driver": options.driver or protocol.name, "model": options.files[0].name.split(".")[0]},
        "protocol": {"name": protocol.name, "sha256": protocol.sha256, "text": protocol.text},
        "settings": {name: SettingRecord(setting.value, setting.origin) for name, setting in protocol.settings.items()},
        "units": {"accelerometer": protocol.units.accelerometer, "gyroscope": protocol.units.gyroscope},
        # What is a default of its own today says nothing about where files of another program were recorded.
        "site": {} if options.site.is_default else options.site.record(),
        "import": {"files": [str(path) for path in options.files]},
    }
    if table is not None:
        metadata["nominal"] = {"raw_zero": list(table.raw_zero)}
        metadata["notes"] = list(table.assumptions)
    model = options.files[0].name.split(".")[0]
    if options.output is not None and not options.replace and (options.output / SETTINGS_FILE).exists():
        raise RecordingError(
            f"{options.output} holds a session already and nothing is overwritten: choose a new folder, or give "
            "--replace if it is an import to be done again.",
            Reason.UNFINISHED,
            folder=str(options.output),
        )
    return create_session(options.output, options.root, model, metadata)
