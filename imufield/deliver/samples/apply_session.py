"""``imufield apply``: corrected samples of a whole recording as CSV, one block in memory at a time."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace
from pathlib import Path

from imufield.deliver.parameters.file import Parameters
from imufield.deliver.samples.export_data import export_csv
from imufield.samples import Samples, SampleUnits


def apply_session(parameters: Parameters, blocks: Iterable[Samples], path: str | Path, *, serial_number: str = "") -> int:
    """Correct blocks of samples and write them as CSV, in m/s^2 and rad/s; the file takes its name when it is complete.

    Columns are those of ``export-data``: time, corrected specific force and angular rate, temperature, counter, status; empty
    where not available, and for the angular rate where the parameters have no gyroscope.

    Parameters
    ----------
    parameters : Parameters
    blocks : iterable of Samples
        In time order, raw.
    path : Path
        Replaced if it exists.
    serial_number : str
        Of the instrument that was recorded; empty where not known.

    Returns
    -------
    int
        Rows written.

    Raises
    ------
    ParameterFileError
        If the parameters are for another instrument or other raw units.
    RecordingError
        If the file cannot be written. In every case what stood under ``path`` before is untouched.
    """
    # Before the first block: the file must not begin with numbers of another instrument.
    parameters.check_instrument(serial_number)
    return export_csv(corrected_blocks(parameters, blocks), path)


def corrected_blocks(parameters: Parameters, blocks: Iterable[Samples]) -> Iterator[Samples]:
    """Yield blocks in SI for raw blocks; raises as ``Parameters.apply``."""
    for block in blocks:
        _, force, rate = parameters.apply(block)
        yield replace(block, accelerometer=force, gyroscope=rate, units=SampleUnits())
