"""``imufield apply``: corrected samples of a whole recording as CSV, one block in memory at a time."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path

import numpy as np

from imufield.dataclass import replace
from imufield.deliver.parameters.file import Parameters
from imufield.deliver.samples.export_data import export_csv
from imufield.errors import Reason, RecordingError
from imufield.samples import Samples, SampleUnits, Status, TemperatureHold, require_possible_degc
from imufield.sentences import Sentences

sentence = Sentences(__package__)


class TemperatureFlags:
    """Flags samples whose temperature the calibration does not cover, and counts them.

    Parameters
    ----------
    parameters : Parameters
    """

    def __init__(self, parameters: Parameters) -> None:
        self._parameters = parameters
        self._temperature = TemperatureHold()
        self._outside = self._unknown = 0

    def flag(self, block: Samples) -> Samples:
        """Return the next block, its temperatures filled in, with its flags.

        Raises
        ------
        RecordingError
            If a temperature that the parameters are to be corrected by is none that an instrument has.
        """
        if not self._parameters.temperature_models:
            return block
        require_possible_degc("the recording", block.temperature_degc)
        block = self._temperature.fill(block)
        flags = self._parameters.temperature_status(block)
        self._outside += int(np.count_nonzero(flags & np.uint32(Status.TEMPERATURE_OUTSIDE)))
        self._unknown += int(np.count_nonzero(flags & np.uint32(Status.TEMPERATURE_UNKNOWN)))
        return replace(block, status=block.status | flags)

    def count(self, block: Samples) -> None:
        """Take the next block where no flag is wanted, but ``notes``; raises as ``flag``."""
        self.flag(block)

    def notes(self) -> tuple[str, ...]:
        """Return a sentence for each flag that was set."""
        models, said = self._parameters.temperature_models, []
        if self._outside:
            low, high = self._parameters.temperature_range_degc
            said.append(sentence("apply_session.outside", samples=self._outside, low=low, high=high))
        if self._unknown:
            said.append(sentence("apply_session.unknown", samples=self._unknown, reference=models[0].reference_degc))
        return tuple(said)


def apply_session(
    parameters: Parameters,
    blocks: Iterable[Samples],
    path: str | Path,
    *,
    serial_number: str = "",
    flags: TemperatureFlags | None = None,
) -> int:
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
    flags : TemperatureFlags, optional
        Counts the samples whose temperature the calibration does not cover; they are flagged all the same.

    Returns
    -------
    int
        Rows written.

    Raises
    ------
    ParameterFileError
        If the parameters are for another instrument or other raw units.
    RecordingError
        If the file cannot be written, or nothing of the recording can be corrected. In every case what stood under ``path``
        before is untouched.
    """
    # Before the first block: the file must not begin with numbers of another instrument.
    parameters.check_instrument(serial_number)
    return export_csv(corrected_blocks(parameters, blocks, flags or TemperatureFlags(parameters)), path)


def corrected_blocks(parameters: Parameters, blocks: Iterable[Samples], flags: TemperatureFlags) -> Iterator[Samples]:
    """Yield blocks in SI, with the temperatures that were recorded, for raw blocks; raises as ``apply_session``."""
    rows, is_empty = 0, True
    for block in blocks:
        flagged = flags.flag(block)
        _, force, rate = parameters.apply(flagged)
        rows, is_empty = rows + len(force), is_empty and not (np.isfinite(force).any() or np.isfinite(rate).any())
        yield replace(block, accelerometer=force, gyroscope=rate, status=flagged.status, units=SampleUnits())
    # Known at the end: a block without a value may be a gap. With an acceleration there is a specific force.
    if rows and is_empty:
        raise RecordingError(sentence("apply_session.nothing"), Reason.BAD_DATA)
