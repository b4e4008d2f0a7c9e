"""Parameters of instruments over time, from a folder of parameter files and an index of them.

The index holds what was read of each file and its size and time of change, so that a thousand files are read once. It lies
with the user and not beside the files: who hands those over could write anything into it. It can be deleted at any time.
What the history says: ``changes``.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Collection
from contextlib import suppress
from dataclasses import asdict, dataclass, field, fields
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from imufield.deliver.family import Shared
from imufield.deliver.parameters.file import Parameters, load_found
from imufield.deliver.parameters.gauge_free import GaugeFree, Number
from imufield.errors import ImufieldError, ParameterFileError, Reason, UsageError
from imufield.files import Origin, open_to_read, write_atomically
from imufield.progress import one_by_one
from imufield.samples import FloatArray
from imufield.sentences import Sentences

sentence = Sentences(__package__)

INDEX_VERSION = 10  # Of the index alone, which is made anew when it changes.
_BEHIND_HEAD = "\t"  # Which JSON writes as an escape: what stands before it tells whether a row is wanted.
_ROW_LIMIT_BYTES = 1 << 16  # Four times the row of a model with every term.
_INDEX_LIMIT_BYTES = 1 << 28  # Of some 50,000 files.
STALE_DAYS = 365.0  # The usual interval of calibration; --stale-days says another.
_SAME_GRAVITY_M_S2 = 1e-7  # Rounding of the figures in a file: a larger difference is another value.
# Of the fields that an index holds.
_TYPES: dict[object, type | tuple[type, ...]] = {
    "str": str,
    "bool": bool,
    "float": (int, float),
}


@dataclass(frozen=True, slots=True, kw_only=True)
class Entry:
    """One parameter file."""

    path: str
    """Relative to the folder."""
    instrument: str
    serial_number: str
    created: str
    """When the session was recorded; when it was solved where nobody knows."""
    verdict: str
    session: str
    """SHA-256 of what was solved."""
    raw_unit: str
    gravity_m_s2: float
    gravity_source: str
    grade: str
    """Empty where the file does not say it."""
    gyroscope_noise_rad_s_per_root_hz: float
    """Infinite where it is not known."""
    numbers: tuple[Number, ...]
    setup: str
    """Positions and model: sessions that share them share what the model leaves out."""
    error: tuple[float, ...]
    """Covariances of ``GaugeFree``: the upper triangle, row by row."""
    scatter: tuple[float, ...]
    edited: bool = False
    """Whether somebody changed the file by hand."""

    @classmethod
    def of(cls, path: str, parameters: Parameters) -> Entry:
        """Return the entry of a loaded file; raises as ``Parameters.gauge_free``."""
        context, calibration = parameters.context, parameters.calibration
        positions = parameters.document["position"]
        found = parameters.gauge_free()
        names = " ".join(sorted(position["name"] for position in positions))
        # A drift shows in the number of parameters.
        model = f"{calibration.model} {calibration.quality.parameters_fitted}"
        noise = np.inf if context.noise is None else context.noise.gyroscope_density_rad_s_per_sqrt_hz
        return cls(
            path=path,
            instrument=context.instrument.model or context.instrument.driver,
            serial_number=context.instrument.serial_number,
            created=context.measured,
            verdict=calibration.quality.verdict,
            session=context.session.sha256,
            raw_unit=calibration.accelerometer_raw_unit,
            gravity_m_s2=calibration.gravity.gravity_m_s2,
            gravity_source=calibration.gravity.source,
            grade=context.instrument.stated_grade,
            gyroscope_noise_rad_s_per_root_hz=float(np.max(np.nan_to_num(noise, nan=np.inf))),
            numbers=found.numbers,
            setup=f"{model} {names}",
            error=_triangle(found.error),
            scatter=_triangle(found.scatter),
            edited=parameters.edited,
        )

    @classmethod
    def from_index(cls, values: dict[str, object]) -> Entry:
        """Return the entry that an index holds; ValueError or TypeError where it is none of ours."""
        numbers = values["numbers"]
        if not isinstance(numbers, list):
            raise TypeError("numbers")
        triangles = {key: tuple(map(float, values[key])) for key in ("error", "scatter")}  # type: ignore[call-overload]
        made = {"numbers": tuple(Number(**number) for number in numbers), **triangles}
        entry = cls(**values | made)  # type: ignore[arg-type]  # checked next
        records: tuple[Entry | Number, ...] = (entry, *entry.numbers)
        for record in records:
            for each in fields(record):
                if not isinstance(getattr(record, each.name), _TYPES.get(each.type, object)):
                    raise TypeError(each.name)
        # What is no date, or half a matrix, is none of ours, either.
        _ = entry.time
        size = len(entry.numbers) * (len(entry.numbers) + 1) // 2
        if (len(entry.error), len(entry.scatter)) != (size, size):
            raise ValueError("error")
        return entry

    @property
    def time(self) -> datetime:
        """When it was calibrated."""
        return datetime.strptime(self.created, "%Y-%m-%dT%H:%M:%SZ").replace(tzinfo=UTC)

    @property
    def gauge_free(self) -> GaugeFree:
        """The numbers, and how their errors hang together."""
        return GaugeFree(self.numbers, *(_square(triangle, len(self.numbers)) for triangle in (self.error, self.scatter)))

    def shared_with(self, other: Entry) -> Shared:
        """Return what both sessions have in common."""
        known = "assumed" not in (self.gravity_source, other.gravity_source)
        same = abs(self.gravity_m_s2 - other.gravity_m_s2) < _SAME_GRAVITY_M_S2
        return Shared(gravity=known and same, setup=self.setup == other.setup)


def _triangle(square: FloatArray) -> tuple[float, ...]:
    return tuple(float(f"{value:.6g}") for value in square[np.triu_indices(len(square))])


def _square(triangle: tuple[float, ...], size: int) -> FloatArray:
    upper = np.zeros((size, size))
    upper[np.triu_indices(size)] = triangle
    return np.asarray(upper + np.triu(upper, 1).T)


@dataclass(frozen=True, slots=True)
class _Row:
    """What the index holds of a TOML file."""

    size: int
    changed_ns: int
    fault: str  # Why it is no entry; empty where it was never meant to be one.
    serial_number: str
    entry: Entry | str | None
    """As the text of the index where it is of an instrument that nobody asked for: to read thousands of them takes seconds."""


@dataclass(frozen=True, slots=True)
class InstrumentHistory:
    """All calibrations of one instrument, the oldest first."""

    instrument: str
    serial_number: str
    entries: tuple[Entry, ...]

    @property
    def title(self) -> str:
        """Model and serial number."""
        return " ".join(filter(None, (self.instrument, self.serial_number))) or "unknown instrument"

    def age_days(self, now: datetime) -> float:
        """Return the age of the newest calibration."""
        return (now - self.entries[-1].time).total_seconds() / 86400

    def nearest(self, at: datetime) -> Entry:
        """Return the calibration closest in time, before or after; of several of one time the one that counts as newest."""
        return min(reversed(self.entries), key=lambda entry: abs((entry.time - at).total_seconds()))


@dataclass(frozen=True, slots=True)
class History:
    """What a folder holds."""

    folder: Path
    instruments: tuple[InstrumentHistory, ...]
    faults: tuple[str, ...] = field(default=())
    """A sentence for each file that could not be read."""
    read: int = 0
    """Files read in this run; the others were in the index."""


def find(folder: Path | str, serial_number: str, at: datetime | None = None) -> Parameters:
    """Return the parameters of an instrument that were calibrated closest to a time.

    Parameters
    ----------
    folder : Path or str
        Of parameter files, searched below too.
    serial_number : str
    at : datetime, optional
        When the data were taken, UTC where it has no time zone; None: now.

    Raises
    ------
    ParameterFileError
        If there is no parameter file of that instrument, or it cannot be used.
    """
    history = read_history(Path(folder), serial_number)
    entry = one_instrument(history).nearest(as_utc(at or datetime.now(UTC)))
    return load_found(history.folder / entry.path, Origin.FOUND)


def one_instrument(history: History) -> InstrumentHistory:
    """Return the only instrument of a history.

    Raises
    ------
    UsageError
        If there are several.
    """
    only, *others = history.instruments
    if others:
        names = [instrument.serial_number or instrument.title for instrument in history.instruments]
        raise UsageError(sentence("history.several", folder=history.folder, found=len(names), names=names))
    return only


def as_utc(time: datetime) -> datetime:
    """Return the time with its zone, UTC where it has none."""
    return time if time.tzinfo is not None else time.replace(tzinfo=UTC)


def read_history(folder: Path, serial_number: str | None = None) -> History:
    """Return the history of a folder and everything below it, reading files that are new or changed.

    Raises
    ------
    ParameterFileError
        If there is no such folder, or nothing in it is a parameter file.
    """
    if not folder.is_dir():
        raise ParameterFileError(sentence("history.no_folder", folder=str(folder)), Reason.FOREIGN)
    rows, unread, read = _read_files(folder, serial_number)
    faults = (*(row.fault for row in rows if row.fault), *unread)
    entries = [row.entry for row in rows if isinstance(row.entry, Entry)]
    chosen = [entry for entry in entries if serial_number in (None, entry.serial_number)]
    if not chosen:
        key = "history.none" if serial_number is None else "history.none_of_serial"
        said = {"serial_number": serial_number, "found": sum(row.entry is not None for row in rows)}
        first = sentence("history.first_fault", fault=faults[0]) if faults else ""
        raise ParameterFileError(sentence(key, folder=str(folder), first_fault=first, **said), Reason.FOREIGN)
    return History(folder, _by_instrument(chosen), faults, read)


def index_file(folder: Path) -> Path:
    """Return where the index of a folder is kept."""
    import platformdirs  # Only here.

    name = hashlib.sha256(os.fsencode(folder.resolve())).hexdigest()
    return platformdirs.user_cache_path("imufield") / "history" / f"{name[:32]}.jsonl"


def _read_index(folder: Path, names: Collection[str], serial_number: str | None) -> dict[str, _Row]:
    """Return what was read before of the files with these names; nothing where the file is no index of ours."""
    rows: dict[str, _Row] = {}
    unsound = (OSError, ValueError, TypeError, KeyError, AttributeError, RecursionError)
    with suppress(*unsound), open_to_read(index_file(folder), Origin.INSIDE) as file:
        if json.loads(file.readline(_ROW_LIMIT_BYTES)) != {"version": INDEX_VERSION}:
            return {}
        # Row by row: an index that was damaged takes no more memory than the files of its folder.
        while file.tell() < _INDEX_LIMIT_BYTES and (line := file.readline(_ROW_LIMIT_BYTES)):
            head, _, text = line.decode("ascii").partition(_BEHIND_HEAD)
            name, size, changed_ns, fault, serial = json.loads(head)
            if name in names:
                entry: Entry | str | None = text.rstrip() or None
                if isinstance(entry, str) and serial_number in (None, serial):
                    entry = Entry.from_index(json.loads(entry))
                rows[name] = _Row(size, changed_ns, str(fault), str(serial), entry)
    return rows


def _write_index(folder: Path, rows: dict[str, _Row]) -> None:
    # ASCII, so that names of any bytes come back as they were.
    lines = [json.dumps({"version": INDEX_VERSION}) + "\n"]
    for name, row in rows.items():
        text = json.dumps(asdict(row.entry)) if isinstance(row.entry, Entry) else row.entry or ""
        lines.append(json.dumps((name, row.size, row.changed_ns, row.fault, row.serial_number)) + _BEHIND_HEAD + text + "\n")
    # Where it cannot be written, all files are read again the next time.
    with suppress(OSError):
        path = index_file(folder)
        path.parent.mkdir(parents=True, exist_ok=True)
        write_atomically(path, "".join(lines).encode("ascii"))


def _read_files(folder: Path, serial_number: str | None) -> tuple[list[_Row], list[str], int]:
    """Return what all TOML files say, sentences about what cannot be looked at, and the number of files read now."""
    rows: dict[str, _Row] = {}
    unread: list[str] = []
    read = 0

    def leave_out(error: OSError) -> None:
        unread.append(sentence("history.unreadable", path=error.filename, cause=error.strerror))

    walk = os.walk(folder, onerror=leave_out)
    found = sorted(Path(below, name) for below, _, names in walk for name in names if name.endswith(".toml"))
    paths = {path.relative_to(folder).as_posix(): path for path in found}
    before = _read_index(folder, paths, serial_number)
    for name, path in one_by_one("reading", paths.items()):
        try:
            state = path.stat()
        except FileNotFoundError:
            continue  # it went away meanwhile
        except OSError as error:
            leave_out(error)
            continue
        row = before.get(name)
        if row is None or (row.size, row.changed_ns) != (state.st_size, state.st_mtime_ns):
            read += 1
            fault, entry = _read_file(name, path)
            row = _Row(state.st_size, state.st_mtime_ns, fault, "" if entry is None else entry.serial_number, entry)
        rows[name] = row
    # An index of nothing is not left behind.
    if rows and rows != before:
        _write_index(folder, rows)
    return list(rows.values()), unread, read


def _read_file(name: str, path: Path) -> tuple[str, Entry | None]:
    """Return what is wrong with a file, and what it holds."""
    try:
        parameters = load_found(path, Origin.FOUND)
        # Solved from several sessions, it is none of its own: they are in the history themselves.
        return "", None if parameters.context.together is not None else Entry.of(name, parameters)
    except ImufieldError as error:
        # Session files and configurations are TOML too, and nobody's fault.
        return "" if error.reason is Reason.FOREIGN else error.message, None


def _by_instrument(entries: list[Entry]) -> tuple[InstrumentHistory, ...]:
    """Group by instrument; of one recording solved several times the newest solution counts.

    What stands behind the first word of a model (firmware, options) may change between two calibrations; a serial number
    alone is not enough, because makers count from one as well.
    """
    groups: dict[tuple[str, str], dict[str, Entry]] = {}
    for entry in sorted(entries, key=lambda entry: (entry.created, entry.path)):
        key = (entry.instrument.split(" ")[0] if entry.serial_number else entry.instrument, entry.serial_number)
        groups.setdefault(key, {})[entry.session or entry.path] = entry
    ordered = [sorted(group.values(), key=lambda entry: (entry.created, entry.path)) for _, group in sorted(groups.items())]
    return tuple(InstrumentHistory(group[-1].instrument, group[-1].serial_number, tuple(group)) for group in ordered)
