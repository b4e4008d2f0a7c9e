"""Samples for other programs: one row each, flagged ones included, numbers exact to the last bit.

Raw units (in ``session.toml``), what is not available is left empty.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import suppress
from pathlib import Path

from imufield.acquire.protocol.protocol import Protocol
from imufield.dataclass import dataclass
from imufield.deliver.samples.export_csv import ROWS, write_csv
from imufield.deliver.samples.export_ros2 import write_ros2
from imufield.deliver.samples.export_tables import write_hdf5, write_parquet
from imufield.deliver.samples.number_text import float_column, table_text
from imufield.deliver.samples.overview import overview
from imufield.errors import RecordingError
from imufield.files import make_beside, typed_write_errors, usual_mode
from imufield.samples import FloatArray, Samples, concatenate

_TEXT_ENDS = ("txt", "dat", "log")  # Of names of text, whatever stands in it.


@dataclass(frozen=True, slots=True, kw_only=True)
class Format:
    """A format of exported samples."""

    suffix: str
    title: str
    write: Callable[[Iterable[Samples], Path, Mapping[str, str]], int]
    """Writes blocks to a new file, with facts for its head; returns the number of samples."""
    lacks: str = ""
    """What it has no place for, in words."""
    rows: int = 1 << 16
    """Of a block; 5 MB are a good size for the pieces of a Parquet file."""


def format_of(path: Path | None) -> str:
    """Return the format that the end of a file's name tells, the longest that fits; CSV where it tells none.

    An unknown end is returned as it is, and then refused: CSV under the name of a spreadsheet helps nobody.
    """
    name = "" if path is None else path.name.lower()
    fitting = [to for to, form in FORMATS.items() if name.endswith((f".{form.suffix}", f".{to}"))]
    end = Path(name).suffix.removeprefix(".")
    other = "csv" if end in _TEXT_ENDS or not any(map(str.isalpha, end)) else end
    return max(fitting, key=lambda to: len(FORMATS[to].suffix), default=other)


def export_samples(blocks: Iterable[Samples], path: str | Path, to: str = "csv", facts: Mapping[str, str] | None = None) -> int:
    """Write a file of samples; it takes its name when it is complete.

    Parameters
    ----------
    blocks : iterable of Samples
        In time order; only a few are in memory at a time.
    path : Path
        Replaced if it exists.
    to : str
        One of ``FORMATS``.
    facts : mapping, optional
        What the file should say of its numbers, where its format can.

    Returns
    -------
    int
        Samples written.

    Raises
    ------
    RecordingError
        The file cannot be written; whatever stood under its name before is untouched.
    UsageError
        The package for the format is not installed, or it cannot hold these samples.
    """
    path = Path(path)
    with typed_write_errors(path, RecordingError):
        descriptor, name = make_beside(path)
        os.close(descriptor)
        try:
            rows = FORMATS[to].write(in_equal_blocks(blocks, FORMATS[to].rows), Path(name), facts or {})
            Path(name).chmod(usual_mode(path))
            # The last step: whoever watches the folder never sees half a file.
            Path(name).replace(path)
        finally:
            with suppress(FileNotFoundError):
                Path(name).unlink()
    return rows


def in_equal_blocks(blocks: Iterable[Samples], rows: int) -> Iterator[Samples]:
    """Join and divide blocks, so that each has ``rows``, and the last what is left."""
    pending: list[Samples] = []
    for block in blocks:
        pending.append(block)
        if sum(map(len, pending)) >= rows:
            joined = concatenate(pending)
            whole = len(joined) - len(joined) % rows
            yield from (joined[start : start + rows] for start in range(0, whole, rows))
            pending = [joined[whole:]]
    if any(map(len, pending)):
        yield concatenate(pending)


def facts_of(protocol: Protocol, raw_zero: FloatArray) -> dict[str, str]:
    """Return what our own import reads again from files that can hold it."""
    units = protocol.units
    facts = {
        "imufield_accelerometer_unit": units.accelerometer,
        "imufield_gyroscope_unit": units.gyroscope,
        "imufield_raw_zero": ",".join(repr(float(zero)) for zero in raw_zero),
    }
    if units.interval_s is not None:
        facts |= {"imufield_increments": "true", "imufield_rate_hz": repr(1 / units.interval_s)}
    return facts


def export_csv(blocks: Iterable[Samples], path: str | Path) -> int:
    """Write a CSV file; as ``export_samples``."""
    return export_samples(blocks, path, "csv")


def _write_overview(blocks: Iterable[Samples], path: Path, facts: Mapping[str, str]) -> int:  # noqa: ARG001  (the same)
    columns, samples = overview(blocks)
    path.write_bytes((",".join(columns) + "\n").encode() + table_text([*map(float_column, columns.values())]))
    return samples


OUTLINE = "outline"
_LACKING = "messages of ROS hold no temperature, counter, losses or status"
FORMATS = {
    "csv": Format(suffix="csv", title="text, one line for each sample", write=write_csv, rows=ROWS),
    "parquet": Format(suffix="parquet", title="Parquet (extra `parquet`)", write=write_parquet),
    "hdf5": Format(suffix="h5", title="HDF5, one dataset for each column (extra `hdf5`)", write=write_hdf5),
    "ros2": Format(
        suffix="mcap", title="sensor_msgs/msg/Imu for ROS 2, Foxglove, PlotJuggler", write=write_ros2, lacks=_LACKING
    ),
    "overview": Format(
        suffix="overview.csv", title="text, minimum, mean and maximum of each interval, for plots", write=_write_overview
    ),
    OUTLINE: Format(
        suffix="outline.csv", title="like overview, from a few seconds of each minute; faster", write=_write_overview
    ),
}
