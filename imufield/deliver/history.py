"""Parameters of instruments over time, from a folder of parameter files and an index of them, ``history_index``.

What the history says: ``judged_history``, and in words ``history_words``.
"""

from __future__ import annotations

import json
import os
from collections import Counter
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path
from types import NoneType

import numpy as np

from imufield.dataclass import dataclass, fields, replace
from imufield.deliver.history_index import Index, Row, State, UnsoundIndexError, with_index
from imufield.deliver.pair_test import Shared
from imufield.deliver.parameters.file import Parameters, load_found
from imufield.deliver.parameters.gauge_free import GaugeFree, LinearFit, Number, linear_places
from imufield.earth import SAME_GRAVITY_M_S2
from imufield.errors import ImufieldError, ParameterFileError, Reason, UsageError
from imufield.files import Origin
from imufield.progress import task
from imufield.samples import FloatArray
from imufield.sentences import Sentences, shortened

sentence = Sentences(__package__)

_AT_ONCE = 5_000  # Files that are read before they are written to the index: 30 MB, and some 20 s that an interrupt loses.
_FILES_A_WORKER = 200  # A process takes as long to start as a hundred files to read.
STALE_DAYS = 365.0  # The usual interval of calibration; --stale-days says another.
# Of the fields that an index holds.
_TYPES: dict[object, type | tuple[type, ...]] = {
    "str": str,
    "bool": bool,
    "float": (int, float),
    "float | None": (int, float, NoneType),
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
    session_name: str
    gravity_m_s2: float
    gravity_source: str
    grade: str
    """Empty where the file does not say it."""
    gyroscope_noise_rad_s_per_root_hz: float
    """Infinite where it is not known."""
    numbers: tuple[Number, ...]
    setup: str
    """Model and sides that were up, in no order: sessions that share them share what the model leaves out."""
    error: tuple[float, ...]
    """Covariances of ``GaugeFree``: the upper triangle, row by row."""
    scatter: tuple[float, ...]
    edited: bool = False
    """Whether somebody changed the file by hand."""
    linear: tuple[float, ...] = ()
    """Of ``LinearFit``: degrees of freedom, change, and the upper triangle of scatter; empty where there is none."""
    temperature_degc: float | None = None
    """Mean over the session; None where it is not known."""
    recorded: str = ""
    """When the recording began; empty where nobody knows."""
    solved: str = ""
    """When this solution was made."""

    @classmethod
    def of(cls, path: str, parameters: Parameters) -> Entry:
        """Return the entry of a loaded file; raises as ``Parameters.gauge_free``."""
        context, calibration = parameters.context, parameters.calibration
        found = parameters.gauge_free()
        temperature_degc = float(np.mean(context.session.temperature_degc))
        linear, parameters_fitted = found.linear, calibration.quality.parameters_fitted
        noise = np.inf if context.noise is None else context.noise.gyroscope_density_rad_s_per_sqrt_hz
        return cls(
            path=path,
            instrument=context.instrument.model or context.instrument.driver,
            serial_number=context.instrument.serial_number,
            created=context.measured,
            verdict=calibration.quality.verdict,
            session=context.session.sha256,
            session_name=context.session.name,
            gravity_m_s2=calibration.gravity.gravity_m_s2,
            gravity_source=calibration.gravity.source,
            grade=context.instrument.stated_grade,
            gyroscope_noise_rad_s_per_root_hz=float(np.max(np.nan_to_num(noise, nan=np.inf))),
            numbers=found.numbers,
            # A drift shows in the number of parameters.
            setup=f"{calibration.model} {parameters_fitted} {_sides(parameters)}",
            error=_triangle(found.error),
            scatter=_triangle(found.scatter),
            edited=parameters.edited,
            linear=() if linear is None else (linear.freedom, *linear.change.tolist(), *_triangle(linear.scatter)),
            temperature_degc=temperature_degc if np.isfinite(temperature_degc) else None,
            recorded=context.session.recorded,
            solved=context.created,
        )

    @property
    def text(self) -> str:
        """As an index holds it."""
        return json.dumps(self, default=lambda record: {each.name: getattr(record, each.name) for each in fields(record)})

    @classmethod
    def from_text(cls, text: str) -> Entry:
        """Return the entry that an index holds; raises UnsoundIndexError where it is none of ours."""
        try:
            return cls._from_values(json.loads(text))
        except (ValueError, TypeError, KeyError, AttributeError, RecursionError) as error:
            raise UnsoundIndexError(str(error)) from error

    @classmethod
    def _from_values(cls, values: dict[str, object]) -> Entry:
        numbers = values["numbers"]
        if not isinstance(numbers, list):
            raise TypeError("numbers")
        triangles = {key: tuple(map(float, values[key])) for key in ("error", "scatter", "linear")}  # type: ignore[call-overload]
        made = {"numbers": tuple(Number(**number) for number in numbers), **triangles}
        entry = cls(**values | made)  # type: ignore[arg-type]  # checked next
        records: tuple[Entry | Number, ...] = (entry, *entry.numbers)
        for record in records:
            for each in fields(record):
                if not isinstance(getattr(record, each.name), _TYPES.get(each.type, object)):
                    raise TypeError(each.name)
        # What is no date, or half a matrix, is none of ours, either.
        _ = entry.time
        size = _half(len(entry.numbers))
        own = len(linear_places(entry.numbers))
        if (len(entry.error), len(entry.scatter)) != (size, size) or len(entry.linear) not in (0, 1 + own + _half(own)):
            raise ValueError("error")
        return entry

    @property
    def time(self) -> datetime:
        """When it was calibrated."""
        return datetime.strptime(self.created, "%Y-%m-%dT%H:%M:%SZ").replace(tzinfo=UTC)

    @property
    def gauge_free(self) -> GaugeFree:
        """The numbers, and how their errors are correlated."""
        error, scatter = (_square(triangle, len(self.numbers)) for triangle in (self.error, self.scatter))
        linear, count = None, len(linear_places(self.numbers))
        if self.linear:
            freedom, *rest = self.linear
            linear = LinearFit(change=np.array(rest[:count]), scatter=_square(rest[count:], count), freedom=freedom)
        return GaugeFree(self.numbers, error, scatter, linear)

    @property
    def linear_setup(self) -> str:
        """The setup in the linear model."""
        if not self.linear:
            return self.setup
        _, parameters, sides = self.setup.split(" ", 2)
        own = self.numbers[linear_places(self.numbers)[0]]
        # What the residuals gain is what is fitted no more.
        return f"linear {int(parameters) - round(self.linear[0] - own.scatter_freedom)} {sides}"

    def in_linear_model(self) -> Entry:
        """Return the same as the linear model has it."""
        found = self.gauge_free.in_linear_model()
        error, scatter = _triangle(found.error), _triangle(found.scatter)
        return replace(self, numbers=found.numbers, setup=self.linear_setup, error=error, scatter=scatter, linear=())

    def shared_with(self, other: Entry) -> Shared:
        """Return what both sessions have in common."""
        known = "assumed" not in (self.gravity_source, other.gravity_source)
        same = abs(self.gravity_m_s2 - other.gravity_m_s2) < SAME_GRAVITY_M_S2
        return Shared(gravity=known and same, setup=self.setup == other.setup)


def _sides(parameters: Parameters) -> str:
    """Return which sides of a cube, edges and corners among them, were up: as planned, or as measured where nothing was."""
    used, rows = parameters.calibration.accelerometer, [row for row in parameters.document["position"] if row["used"]]
    planned, raw = (np.array([row[key] for row in rows], dtype=np.float64).reshape(-1, 3) for key in ("direction", "mean_raw"))
    up = np.where(np.isfinite(planned), planned, (raw - used.offset) / used.scale)
    # Placements differ by some 5 degrees; from here to another side it is 16 at least.
    largest = np.abs(up).max(axis=1, keepdims=True)
    sides = np.rint(up / np.where(largest > 0, largest, 1.0)).astype(np.int64)
    return str(sorted(sides.tolist()))


def _triangle(square: FloatArray) -> tuple[float, ...]:
    return tuple(float(f"{value:.6g}") for value in square[np.triu_indices(len(square))])


def _half(size: int) -> int:
    """Return how many values an upper triangle has."""
    return size * (size + 1) // 2


def _square(triangle: Sequence[float], size: int) -> FloatArray:
    upper = np.zeros((size, size))
    upper[np.triu_indices(size)] = triangle
    return np.asarray(upper + np.triu(upper, 1).T)


@dataclass(frozen=True, slots=True)
class InstrumentHistory:
    """All calibrations of one instrument, the oldest first."""

    instrument: str
    serial_number: str
    entries: tuple[Entry, ...]
    not_listed: int = 0
    """Files of the same sessions, of which newer solutions count."""

    @property
    def title(self) -> str:
        """Model and serial number."""
        return " ".join(map(shortened, filter(None, (self.instrument, self.serial_number)))) or "unknown instrument"

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
    faults: tuple[str, ...] = ()
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


def read_history(folder: Path, serial_number: str | None = None, workers: int = 1) -> History:
    """Return the history of a folder and everything below it, reading files that are new or changed.

    ``workers`` is how many processes read where files are many; a script that starts processes must be made for it.

    Raises
    ------
    ParameterFileError
        If there is no such folder, or nothing in it is a parameter file.
    """
    if not folder.is_dir():
        key = "history.not_a_folder" if folder.exists() else "history.no_folder"
        raise ParameterFileError(sentence(key, folder=str(folder)), Reason.FOREIGN)
    states, unread = _states(folder)

    def read_index(index: Index) -> tuple[list[Entry], dict[str, str], int, int]:
        read = _read_new(index, folder, states, workers)
        return [Entry.from_text(text) for text in index.entries(serial_number)], index.faults(), len(index), read

    # An index of nothing is not left behind.
    entries, faulty, found, read = with_index(folder, read_index) if states else ([], {}, 0, 0)
    faults = (*(faulty[name] for name in sorted(faulty, key=lambda name: name.split("/"))), *unread)
    if not entries:
        key = "history.none" if serial_number is None else "history.none_of_serial"
        first = sentence("history.first_fault", count=len(faults), fault=faults[0]) if faults else ""
        told = {"folder": str(folder), "serial_number": serial_number, "found": found, "first_fault": first}
        raise ParameterFileError(sentence(key, **told), Reason.FOREIGN)
    return History(folder, _by_instrument(entries), faults, read)


def _states(folder: Path) -> tuple[dict[str, State], list[str]]:
    """Return the state of every TOML file by its name relative to the folder, and sentences about what cannot be looked at."""
    states: dict[str, State] = {}
    unread: list[str] = []

    def leave_out(error: OSError) -> None:
        unread.append(sentence("history.unreadable", path=error.filename, cause=error.strerror))

    for below, _, names in os.walk(folder, onerror=leave_out):
        place = Path(below).relative_to(folder).as_posix()
        before = "" if place == "." else f"{place}/"
        for name in (name for name in names if name.endswith(".toml")):
            try:
                state = os.stat(f"{below}/{name}")  # noqa: PTH116  # a Path takes longer than to look at the file
            except FileNotFoundError:
                continue  # it went away meanwhile
            except OSError as error:
                leave_out(error)
                continue
            states[before + name] = f"{state.st_size} {state.st_mtime_ns}"
    return states, unread


def _read_new(index: Index, folder: Path, states: dict[str, State], workers: int) -> int:
    """Bring the index up to date; return how many files were read."""
    new = list(index.unread(states))
    if not new:
        return 0
    from imufield.campaign import run_campaign  # late: mostly nothing is new, and processes take time to import

    # What is wrong with a file is said with its path, later perhaps from another folder.
    folder = folder.resolve()
    with task("reading", len(new)) as reading:

        def count(_: Row) -> None:
            reading.done += 1

        for first in range(0, len(new), _AT_ONCE):
            names = new[first : first + _AT_ONCE]
            places = [(name, folder / name) for name in names]
            share = min(workers, 1 + len(names) // _FILES_A_WORKER)
            rows = run_campaign(_read_file, places, seed=0, workers=share, on_result=count)
            index.put((name, states[name], row) for name, row in zip(names, rows, strict=True))
    return len(new)


def _read_file(place: tuple[str, Path], _: np.random.Generator) -> Row:
    """Return what a file holds; nothing is drawn."""
    name, path = place
    try:
        parameters = load_found(path, Origin.FOUND)
        # Solved from several sessions, it is none of its own: they are in the history themselves.
        entry = None if parameters.context.together is not None else Entry.of(name, parameters)
    except ImufieldError as error:
        # Session files and configurations are TOML too, and nobody's fault.
        return Row("" if error.reason is Reason.FOREIGN else error.message, "", None)
    return Row("", "", None) if entry is None else Row("", entry.serial_number, entry.text)


def _by_instrument(entries: list[Entry]) -> tuple[InstrumentHistory, ...]:
    """Group by instrument; of one session solved several times the newest solution counts.

    What stands behind the first word of a model (firmware, options) may change between two calibrations; a serial number
    alone is not enough, because makers count from one as well.
    """
    groups: dict[tuple[str, str], dict[str, Entry]] = {}
    files = Counter[tuple[str, str]]()
    for entry in sorted(entries, key=_age):
        key = (entry.instrument.split(" ")[0] if entry.serial_number else entry.instrument, entry.serial_number)
        groups.setdefault(key, {})[entry.session or entry.path] = entry
        files[key] += 1
    histories = []
    for key, group in sorted(groups.items()):
        sessions = {_session_of(entry): entry for entry in sorted(group.values(), key=_age)}
        ordered = sorted(sessions.values(), key=_age)
        newest, not_listed = ordered[-1], files[key] - len(ordered)
        histories.append(InstrumentHistory(newest.instrument, newest.serial_number, tuple(ordered), not_listed))
    return tuple(histories)


def _age(entry: Entry) -> tuple[str, ...]:
    return entry.created, entry.solved, entry.path


def _session_of(entry: Entry) -> tuple[str, ...]:
    """Return what the results of one session have in common: a retake changes the hash, not begin, name and folder."""
    # Of instruments without a number, two may have begun in one second.
    if entry.recorded and entry.serial_number:
        return entry.recorded, entry.session_name, str(Path(entry.path).parent)
    return (entry.session or entry.path,)
