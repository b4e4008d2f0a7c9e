"""A home-made instrument that prints lines of numbers and takes no commands."""

from __future__ import annotations

import math
from collections.abc import Sequence

from imufield.errors import UsageError
from imufield.samples import ACCELEROMETER_COLUMNS, GYROSCOPE_COLUMNS, Samples
from imufield.sentences import Sentences
from imufield.simulate.instruments.device import Device, Frames
from imufield.simulate.wire.forms import number_template
from imufield.simulate.wire.lines import LINE_END

sentence = Sentences(__package__)

TEXT_COLUMNS = ("time", *ACCELEROMETER_COLUMNS, *GYROSCOPE_COLUMNS)
"""What a line holds unless told otherwise; ``counter`` and ``temperature`` may be added."""


class TextDevice(Device):
    """A home-made instrument: values in the unit of the samples, nothing where one is not available.

    Parameters
    ----------
    columns : sequence of str
    prefix : str
        Stands before the first number.

    Raises
    ------
    UsageError
        If a column has no such name.
    """

    def __init__(self, columns: Sequence[str] = TEXT_COLUMNS, prefix: str = "") -> None:
        known = (*TEXT_COLUMNS, "counter", "temperature")
        if unknown := [name for name in columns if name not in known]:
            raise UsageError(sentence("text.column", column=unknown[0], columns=known))
        self._templates = {name: number_template(name) for name in columns}
        self._prefix = prefix
        self._offset = 0

    def encode(self, samples: Samples) -> Frames:
        """Return one line for each sample."""
        values = {
            "time": samples.time_s,
            "counter": samples.counter + self._offset,
            **dict(zip(ACCELEROMETER_COLUMNS, samples.accelerometer.T, strict=True)),
            **dict(zip(GYROSCOPE_COLUMNS, samples.gyroscope.T, strict=True)),
            "temperature": samples.temperature_degc,
        }
        cells = [
            ["" if math.isnan(value) else template.format(value) for value in values[name].tolist()]
            for name, template in self._templates.items()
        ]
        return Frames.of_lines([(self._prefix + ",".join(row) + LINE_END).encode("ascii") for row in zip(*cells, strict=True)])

    def jump_counter(self, by: int) -> None:
        """Let the counter column, if there is one, jump."""
        self._offset += by
