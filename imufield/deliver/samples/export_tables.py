"""Samples as Parquet and HDF5, block by block; what the numbers are stands beside them as attributes of the file."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from imufield.errors import missing_package
from imufield.samples import NO_COUNTER, SAMPLE_COLUMNS, Samples

Columns = dict[str, NDArray[np.float64] | NDArray[np.int64] | NDArray[np.uint32]]
_HDF5_CHUNK_ROWS = 8192  # 64 KiB of float64: worth compressing, and below the chunk cache of 1 MiB.


def columns_of(samples: Samples) -> Columns:
    """Return the columns of an export by name; NaN and ``NO_COUNTER`` where there is no value."""
    values = [samples.time_s, *samples.accelerometer.T, *samples.gyroscope.T, samples.temperature_degc]
    names = SAMPLE_COLUMNS[: len(values)]
    columns: Columns = {name: np.ascontiguousarray(value) for name, value in zip(names, values, strict=True)}
    return {**columns, "counter": samples.counter, "status": samples.status}


def write_parquet(blocks: Iterable[Samples], path: Path, facts: Mapping[str, str]) -> int:
    """Write a Parquet file, null where there is no value; return the number of rows.

    Raises
    ------
    UsageError
        pyarrow is not installed.
    """
    try:
        import pyarrow as pa
        import pyarrow.parquet as parquet
    except ImportError as error:
        raise missing_package("--to parquet", "pyarrow", "parquet") from error
    kinds = {"counter": pa.int64(), "status": pa.uint32()}
    fields = [(name, kinds.get(name, pa.float64())) for name in SAMPLE_COLUMNS]
    schema = pa.schema(fields, metadata=dict(facts))
    rows = 0
    with parquet.ParquetWriter(path, schema, compression="zstd") as writer:
        for block in blocks:
            columns = columns_of(block)
            missing = {name: np.isnan(values) for name, values in columns.items() if values.dtype.kind == "f"}
            missing["counter"] = block.counter == NO_COUNTER
            arrays = [pa.array(values, mask=missing.get(name)) for name, values in columns.items()]
            writer.write_table(pa.Table.from_arrays(arrays, schema=schema))
            rows += len(block)
    return rows


def write_hdf5(blocks: Iterable[Samples], path: Path, facts: Mapping[str, str]) -> int:
    """Write an HDF5 file of one dataset for each column; return the number of rows.

    Raises
    ------
    UsageError
        h5py is not installed.
    """
    try:
        import h5py
    except ImportError as error:
        raise missing_package("--to hdf5", "h5py", "hdf5") from error
    # Imported here, as other formats need nothing of it.
    from imufield.campaign import interrupts_held

    rows = 0
    with h5py.File(path, "w") as file:
        file.attrs.update(facts)
        kinds = {"counter": "<i8", "status": "<u4"}
        datasets = {
            name: file.create_dataset(
                name,
                (0,),
                kinds.get(name, "<f8"),
                maxshape=(None,),
                chunks=(_HDF5_CHUNK_ROWS,),
                compression="gzip",
                shuffle=True,
            )
            for name in SAMPLE_COLUMNS
        }
        for block in blocks:
            # The callbacks of h5py swallow a Ctrl-C.
            with interrupts_held():
                for name, values in columns_of(block).items():
                    datasets[name].resize(rows + len(block), axis=0)
                    datasets[name][rows:] = values
            rows += len(block)
    return rows
