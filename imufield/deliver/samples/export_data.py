"""Samples for other programs: one row each, flagged ones included, numbers exact to the last bit.

Raw units (in ``session.toml``), what is not available is left empty.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from imufield.acquire.protocol.protocol import Protocol
from imufield.deliver.samples.export_csv import float_texts, write_csv
from imufield.deliver.samples.export_ros2 import write_ros2
from imufield.deliver.samples.export_tables import write_hdf5, write_parquet
from imufield.deliver.samples.overview import overview
from imufield.errors import RecordingError
from imufield.files import make_beside, typed_write_errors, usual_mode
from imufield.samples import FloatArray, Samples, concatenate

_ROWS_IN_A_BLOCK = 1 << 16  # 5 MB: a good size for the pieces of a Parquet file.


@dataclass(frozen=True, slots=True)
class Format:
    """A format of exported samples."""

    suffix: str
    title: str
    write: Callable[[Iterable[Samples], Path, Mapping[str, str]], int]
    """Writes blocks to a new file, with facts for its head; returns the number of samples."""
    lacks: str = ""
    """What it has no place for, in words."""


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
            rows = FORMATS[to].write(in_large_blocks(blocks), Path(name), facts or {})
            Path(name).chmod(usual_mode(path))
            # The last step: whoever watches the folder never sees half a file.
            Path(name).replace(path)
        finally:
            with suppress(FileNotFoundError):
                Path(name).unlink()
    return rows


def in_large_blocks(blocks: Iterable[Samples], rows: int = _ROWS_IN_A_BLOCK) -> Iterator[Samples]:
    """Join small blocks to some of at least ``rows``, so that each is worth a compressed piece of a file."""
    pending: list[Samples] = []
    for block in blocks:
        pending.append(block)
        if sum(map(len, pending)) >= rows:
            yield concatenate(pending)
            pending = []
    if pending:
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
    rows = zip(*(float_texts(column) for column in columns.values()), strict=True)
    path.write_text("".join(",".join(row) + "\n" for row in (columns, *rows)), encoding="ascii", newline="")
    return samples


OUTLINE = "outline"
_LACKING = "messages of ROS hold no temperature, counter, losses or status"
FORMATS = {
    "csv": Format("csv", "text, one line for each sample", write_csv),
    "parquet": Format("parquet", "Parquet (extra `parquet`)", write_parquet),
    "hdf5": Format("h5", "HDF5, one dataset for each column (extra `hdf5`)", write_hdf5),
    "ros2": Format("mcap", "sensor_msgs/msg/Imu for ROS 2, Foxglove, PlotJuggler", write_ros2, _LACKING),
    "overview": Format("overview.csv", "text, least, mean and largest values of blocks, for plots of hours", _write_overview),
    OUTLINE: Format("outline.csv", "as overview, of some seconds of a long recording: a first picture", _write_overview),
}
