"""``imufield import``: files of other programs become a session."""

from __future__ import annotations

import json
import math
import shutil
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from imufield.acquire.background_work import BackgroundWork
from imufield.acquire.formats.can_log_heads import begins_as_can_log
from imufield.acquire.formats.ros_bags import is_bag
from imufield.acquire.formats.table_columns import TIME_UNIT
from imufield.acquire.formats.table_text import read_pieces
from imufield.acquire.formats.tables import NO_POSITIONS, ROWS_PROTOCOL, ImportedTable, read_tables, row_chunks
from imufield.acquire.link.chunk import Chunk
from imufield.acquire.link.host_clock import COUNTS_FROM_1970_S, SystemClock
from imufield.acquire.protocol.protocol import Protocol, load_protocol
from imufield.acquire.recording.part_file import is_part
from imufield.acquire.recording.recorder import Recorder, packed, part_metadata, protocol_tables
from imufield.acquire.recording.session import LOCK_FILE, SETTINGS_FILE, Session, create_session
from imufield.commands.options.acquire_commands import ImportOptions
from imufield.commands.options.configuration import parse_zero
from imufield.commands.terminal.output import echo, say_each
from imufield.dataclass import replace
from imufield.deliver.parameters.printed_numbers import beside
from imufield.errors import Reason, RecordingError, UsageError
from imufield.guide.lead.still_scales import CONTRADICTIONS, find_scales
from imufield.pipeline.still_units import settings_of_stills, with_units_of_stills
from imufield.pipeline.table_samples import refuse_endless
from imufield.samples import Samples, require_possible_degc
from imufield.sentences import Sentence, Sentences, printable, shell_word

if TYPE_CHECKING:
    from imufield.acquire.decoder import Decoder
    from imufield.acquire.driver import Driver

sentence = Sentences(__package__)

DUMP_CHUNK_BYTES = 1 << 16  # Small beside a block of the recorder, large beside a call.


def run_import(options: ImportOptions) -> Session:
    """Import and tell what was assumed.

    Raises
    ------
    ImufieldError
        A file cannot be read or understood.
    """
    session, assumptions = import_session(options)
    if options.as_json:
        echo(json.dumps({"event": "imported", "session": str(session.folder), "assumptions": assumptions}))
        return session
    say_each(assumptions, err=True, indent=2)
    echo(beside("session", session.folder))
    # In a wrong unit, or without gravity, solving would fail.
    if not any(getattr(each, "key", "") in CONTRADICTIONS | NO_POSITIONS for each in assumptions):
        echo(beside("next: ", f"imufield solve {shell_word(session.folder)}"))
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
        return _import_tables(options) if protocol is None else _import_bytes(options, protocol)


def _protocol(options: ImportOptions) -> Protocol | None:
    """Return what the files are to be decoded by, a file before a driver; None for tables.

    Raises
    ------
    UsageError
        If protocol and DBC file are both given, or a mapping without a DBC file, or two rates.
    """
    if options.protocol is not None and options.dbc is not None:
        raise UsageError(sentence("import_files.protocol_and_dbc"))
    if options.mapping and options.dbc is None:
        raise UsageError(sentence("import_files.map_without_dbc"))
    if options.dbc is not None:
        # The package that reads DBC files is slow to import, and most imports are of tables.
        from imufield.acquire.instrument.can_map import protocol_from_dbc

        return protocol_from_dbc(options.dbc, options.mapping, options.settings)
    if options.protocol is not None:
        return load_protocol(options.protocol, _with_rate(options))
    driver = _driver(options)
    return None if driver is None else driver.load_protocol(_with_rate(options))


def _driver(options: ImportOptions) -> type[Driver] | None:
    if options.driver is None:
        return None
    from imufield.acquire.registry import load_driver

    return load_driver(options.driver)


def _with_rate(options: ImportOptions) -> dict[str, object]:
    """Return the settings of a protocol, the rate that was given by an option of its own among them."""
    if options.rate_hz is None:
        return {**options.settings}
    if "rate_hz" in options.settings:
        raise UsageError(sentence("import_files.two_rates", option_hz=options.rate_hz, setting_hz=options.settings["rate_hz"]))
    return {**options.settings, "rate_hz": options.rate_hz}


def _refuse_ignored(options: ImportOptions, protocol: Protocol | None) -> None:
    """Refuse options that would change nothing; raises ``UsageError``."""
    is_log = protocol is not None and protocol.can is not None
    if options.channel is not None and not is_log:
        raise UsageError(sentence("import_files.channel"))
    if options.topic is not None and not (protocol is None and any(is_bag(path) for path in options.files)):
        raise UsageError(sentence("import_files.topic"))
    if options.protocol is not None and options.driver is not None:
        raise UsageError(sentence("import_files.protocol_and_driver", protocol=options.protocol, driver=options.driver))
    if protocol is not None and (options.columns or options.zero or (options.rate_hz and is_log)):
        raise UsageError(sentence("import_files.log_as_table" if is_log else "import_files.dump_as_table"))


def _refuse_own(paths: list[Path]) -> None:
    """Refuse our own recordings, which are to be solved as they are; raises ``UsageError``."""
    for path in paths:
        # Also where one file of a session is named: what it is of is what the person has to solve.
        folder = path if path.is_dir() else path.parent
        if is_part(path) or (folder == path and (path / SETTINGS_FILE).is_file()) or path.name == SETTINGS_FILE:
            raise UsageError(sentence("import_files.own", path=str(path), folder=folder))


def _import_tables(options: ImportOptions) -> tuple[Session, list[str]]:
    for path in options.files:
        # Of a log of a CAN bus nobody said what is on it: its frames alone mean nothing.
        if begins_as_can_log(path):
            raise UsageError(sentence("import_files.unknown_can_log", path=str(path)))
    read = read_tables(
        options.files,
        columns=options.columns,
        rate_hz=options.rate_hz,
        zero=parse_zero(options.zero),
        settings=options.settings,
        topic=options.topic,
    )
    blocks = BackgroundWork(lambda: packed(row_chunks(read.rows, read.status, read.counter)))
    table = with_units_of_stills(read)
    # The unit of time is spent when the rows are made; their protocol does not know it.
    of_rows = {name: value for name, value in options.settings.items() if name != TIME_UNIT}
    label = sentence("import_files.table_label", setting=TIME_UNIT)
    protocol = load_protocol(ROWS_PROTOCOL, {**of_rows, **table.settings}, label=label)
    began = _began(table.begin_s)
    with _whole_or_nothing(_new_session(options, protocol, table, began), protocol, blocks.result) as (session, _):
        pass
    return session, [_said_of_table(table), *table.assumptions, *_said_of(began)]


def _said_of_table(table: ImportedTable) -> Sentence:
    triads = {"accelerometer": table.rows[:, 1:4], "gyroscope": table.rows[:, 4:7]}
    units = {triad: str(table.settings[f"{triad}_unit"]) for triad, values in triads.items() if np.isfinite(values).any()}
    return _imported(len(table.rows), float(table.rows[-1, 0] - table.rows[0, 0]), units)


def _imported(samples: int, duration_s: float, units: dict[str, str]) -> Sentence:
    values = {"duration_s": duration_s, "rate_hz": (samples - 1) / duration_s if duration_s > 0 else math.nan}
    told = [f"{triad} in {unit}" for triad, unit in units.items()]
    return sentence("import_files.imported", samples=samples, units=told, **values)


def _import_bytes(options: ImportOptions, protocol: Protocol) -> tuple[Session, list[str]]:
    """Put the bytes of a dump or the frames of logs into a recording as they are."""
    # With all that decodes and listens to ports, of which a table knows nothing.
    from imufield.acquire.decode.statistics import remarks, without_samples
    from imufield.acquire.decoder import Decoder
    from imufield.acquire.instrument.connected import assumed, with_settings
    from imufield.acquire.instrument.text_columns import other_lines, read_lines

    losses: list[str] = []
    times_s: list[float] = []
    decoder = Decoder(protocol)
    # Decoded before anything is made of them, so that nothing is put aside for files without a sample.
    blocks = _with_possible_temperatures(_samples(options, decoder, losses, times_s), options.files)
    scales = find_scales(blocks, protocol.nominal.raw_zero)
    driver = _driver(options)
    told = with_settings(driver, protocol, decoder.messages())
    if told.settings != protocol.settings:
        # Messages among the samples say how the instrument is set.
        return _import_bytes(options, told)
    counts = decoder.statistics
    if counts.samples <= counts.samples_incomplete:
        first = b"" if protocol.can is not None else next((chunk.data for chunk in _chunks(options, protocol, [])), b"")
        if differs := other_lines(str(options.files[0]), read_lines(first), protocol):
            raise RecordingError(differs, Reason.NO_FRAMES)
        foreign = "import_files.dump_without_samples" if protocol.can is None else "import_files.log_without_samples"
        none = sentence(
            "import_files.frames_without_samples" if protocol.can is None and counts.is_understood else foreign,
            why=without_samples(protocol, [counts]),
            names=options.files,
            protocol=protocol.name,
            bytes=counts.bytes_total,
            frames=counts.frames,
            frames_bad_checksum=counts.frames_bad_checksum,
            kinds=[f"{name}: {count}" for name, count in counts.by_kind.items()],
        )
        raise RecordingError(none, Reason.NO_FRAMES)
    if decoder.time_is_assumed:
        has_setting = "rate_hz" in protocol.settings
        key = "import_files.dump_without_time" if has_setting else "import_files.protocol_without_time"
        raise UsageError(sentence(key, names=options.files, protocol=protocol.name), Reason.UNITS)
    said = f"{counts.samples} samples of {counts.frames} frames, {counts.lost} lost"
    if protocol.can is None:
        said = f"{counts.samples} samples, {counts.bytes_skipped} of {counts.bytes_total} bytes skipped"
    units, said_of_units = settings_of_stills(scales, protocol)
    if units:
        protocol = _protocol(replace(options, settings={**options.settings, **units})) or protocol
    of = {"accelerometer": protocol.units.accelerometer, "gyroscope": protocol.units.gyroscope}
    told_first = (_imported(counts.samples, times_s[-1] - times_s[0], of), *_other_rate(counts.nominal_rate_hz, protocol))
    began = _began(next(_chunks(options, protocol, [])).monotonic_s)
    with _whole_or_nothing(_new_session(options, protocol, None, began), protocol) as (session, recorder):
        for chunk in _chunks(options, protocol, []):  # What is lost was said while they were tried.
            recorder.write_chunk(chunk)
    return session, [*losses, *told_first, said, *remarks([counts]), *assumed(protocol), *said_of_units, *_said_of(began)]


def _other_rate(rate_hz: float | None, protocol: Protocol) -> tuple[Sentence, ...]:
    """Say that the time stamps of a log show another rate than its protocol states, where they do."""
    from imufield.acquire.clock.sample_clock import LARGEST_RATE_ERROR

    setting, stated_hz = protocol.settings.get("rate_hz"), protocol.clock.rate_hz
    is_stated = setting is None or setting.origin != "assumed"
    if not (is_stated and stated_hz and rate_hz) or abs(rate_hz / stated_hz - 1) <= LARGEST_RATE_ERROR:
        return ()
    return (sentence("import_files.other_rate", rate_hz=rate_hz, stated_hz=stated_hz),)


def _began(time_s: float) -> str:
    """Return when a recording began, UTC, ISO 8601, by its first time where that counts from 1970; else an empty text."""
    if not COUNTS_FROM_1970_S < time_s < SystemClock().utc_ns() / 1e9:
        return ""
    return datetime.fromtimestamp(time_s, UTC).strftime("%Y-%m-%dT%H:%M:%SZ")


def _said_of(began: str) -> tuple[Sentence, ...]:
    return (sentence("import_files.began", began=began),) if began else ()


def _samples(options: ImportOptions, decoder: Decoder, losses: list[str], times_s: list[float]) -> Iterator[Samples]:
    """Decode what the files hold, to its end; ``times_s`` receives the first and last time of each block."""

    def blocks() -> Iterator[Samples]:
        for chunk in _chunks(options, decoder.protocol, losses):
            yield decoder.feed(chunk.data, chunk.monotonic_s)
        yield decoder.flush()

    for samples in blocks():
        times_s += samples.time_s[[0, -1]].tolist() if len(samples) else []
        yield samples


def _with_possible_temperatures(blocks: Iterable[Samples], files: list[Path]) -> Iterator[Samples]:
    for samples in blocks:
        require_possible_degc(", ".join(map(str, files)), samples.temperature_degc)
        yield samples


def _chunks(options: ImportOptions, protocol: Protocol, losses: list[str]) -> Iterator[Chunk]:
    """Yield what the files hold: frames arrive when their log says; for bytes there is no arrival time but the order."""
    if protocol.can is None:
        utc_ns = SystemClock().utc_ns()
        for path in options.files:
            for data in read_pieces(path, DUMP_CHUNK_BYTES):
                yield Chunk(data, math.nan, utc_ns)
        return
    from imufield.acquire.formats.can_logs import read_log

    for path in options.files:
        yield from read_log(path, channel=options.channel, losses=losses)


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
        raise UsageError(sentence("import_files.replace_what"))
    if not (folder / SETTINGS_FILE).exists():
        yield
        return
    if (cannot := _stays(folder)) is not None:
        raise UsageError(cannot)
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


def _stays(folder: Path) -> Sentence | None:
    """Return why the session in a folder cannot be replaced: nothing goes that cannot be imported again from its files."""
    earlier = Session.open(folder)
    kind = earlier.record.kind
    if kind != "import":
        return sentence("import_files.no_import", folder=folder, kind=kind)
    from imufield.pipeline.reading_cache import CACHE_FILE  # With what solving needs; few imports replace one.

    own = {SETTINGS_FILE, LOCK_FILE, CACHE_FILE, *(part.name for part in earlier.parts)}
    others = sorted(path.name for path in folder.iterdir() if path.name not in own)
    return sentence("import_files.holds_more", folder=folder, others=others[:3]) if others else None


@contextmanager
def _whole_or_nothing(
    session: Session, protocol: Protocol, packed_first: Callable[[], Sequence[bytes]] = tuple
) -> Iterator[tuple[Session, Recorder]]:
    """Record into a new session and finish it; remove it if it cannot be completed: its files can be imported again.

    Raises
    ------
    RecordingError
        If the disk is full.
    """
    try:
        with Recorder(session.add_part(), part_metadata(protocol, {}), first=packed_first()) as recorder:
            yield session, recorder
    except BaseException as error:
        # The folder was new or empty.
        shutil.rmtree(session.folder, ignore_errors=True)
        if isinstance(error, RecordingError) and error.reason is Reason.DISK_FULL:
            raise RecordingError(sentence("import_files.disk_full", path=str(session.folder)), error.reason) from error
        raise
    session.update(finished=True)


def _new_session(options: ImportOptions, protocol: Protocol, table: ImportedTable | None, began: str) -> Session:
    model = printable(options.model or Path(options.files[0].name.removesuffix(".gz")).stem)
    serial_number = None if options.serial_number is None else printable(options.serial_number)
    metadata: dict[str, object] = {
        "kind": "import",
        "instrument": {"driver": options.driver or protocol.name, "model": model, "serial_number": serial_number},
        **protocol_tables(protocol),
        # What is a default of its own today says nothing about where files of another program were recorded.
        "site": options.site.record(),
        "import": {"files": [str(path) for path in options.files], "began": began or None},
    }
    if table is not None:
        metadata["nominal"] = {"raw_zero": list(table.raw_zero)}
        metadata["notes"] = list(table.assumptions)
    if options.output is not None and not options.replace and (options.output / SETTINGS_FILE).exists():
        key = "import_files.exists" if _stays(options.output) is None else "import_files.exists_and_stays"
        raise RecordingError(sentence(key, folder=str(options.output)), Reason.UNFINISHED)
    return create_session(options.output, options.root, model, metadata)
