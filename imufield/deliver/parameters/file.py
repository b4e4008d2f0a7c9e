"""The parameter file for programs: ``imufield.load(path).apply(samples)``.

The format is docs/parameter-file.md; ``parameters.schema.json`` beside this file is its JSON Schema.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import NamedTuple, overload

import numpy as np

from imufield.calibrate.model.result import Calibration, GyroscopeParameters
from imufield.deliver.parameters.apply import correct_accelerometer, correct_both, correct_gyroscope
from imufield.deliver.parameters.context import Context, InstrumentFacts, Noise, SessionFacts
from imufield.deliver.parameters.document import VERSION, calibration_from_document, context_from_document, to_document
from imufield.deliver.parameters.read import read_document
from imufield.deliver.parameters.schema import Document, json_ready, parameter_schema
from imufield.deliver.parameters.write import EDITED, to_toml, write_document, write_parameters
from imufield.errors import ParameterFileError, Reason
from imufield.files import Origin
from imufield.samples import FloatArray, Samples
from imufield.sentences import Sentences

sentence = Sentences(__package__)

PARAMETER_FILE = "parameters.toml"
"""Its name in the folder of a session."""

__all__ = [
    "PARAMETER_FILE",
    "Context",
    "Corrected",
    "InstrumentFacts",
    "Noise",
    "Parameters",
    "SessionFacts",
    "from_document",
    "json_ready",
    "load",
    "parameter_schema",
    "to_document",
    "to_toml",
    "write_document",
    "write_parameters",
]


class Corrected(NamedTuple):
    """What ``Parameters.apply`` returns for a block of n samples."""

    time_s: FloatArray
    """Shape (n,), the sample clock."""
    specific_force_m_s2: FloatArray
    """Shape (n, 3), body frame."""
    angular_rate_rad_s: FloatArray
    """Shape (n, 3), body frame; NaN where the file has no gyroscope or not its scale."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Parameters:
    """A loaded parameter file."""

    calibration: Calibration
    context: Context
    document: Document = field(repr=False)
    """The file's content, in the current version."""
    edited: bool = False
    """Whether somebody changed the file by hand and said so."""
    path: Path | None = None
    version: int = VERSION
    """Of the file; an older one was converted."""

    def apply_accelerometer(self, raw: FloatArray) -> FloatArray:
        """Return specific force in m/s^2 for raw outputs (increments divided by their interval), both of shape (..., 3).

        Raises
        ------
        CalibrationError
            If no specific force gives such an output with these parameters; NaN is passed on as NaN.
        ParameterFileError
            If the last axis of ``raw`` has not 3 entries.
        """
        return correct_accelerometer(self.calibration.accelerometer, raw)

    def apply_gyroscope(self, raw: FloatArray, specific_force: FloatArray | None = None) -> FloatArray:
        """Return angular rate in rad/s for raw outputs, both of shape (..., 3).

        Parameters
        ----------
        raw : ndarray, shape (..., 3)
            Raw unit; increments divided by their interval.
        specific_force : ndarray, shape (..., 3), optional
            What ``apply_accelerometer`` returns, m/s^2; needed where a g-sensitivity was fitted.

        Raises
        ------
        ParameterFileError
            If the file has no gyroscope or not its scale, a g-sensitivity was fitted and ``specific_force`` is not given, or a
            shape is wrong.
        """
        return correct_gyroscope(self._gyroscope(), raw, specific_force)

    def _gyroscope(self) -> GyroscopeParameters:
        if self.calibration.gyroscope is None:
            raise ParameterFileError(sentence("file.no_gyroscope", name=self._name), Reason.UNITS)
        if not self.gyroscope_is_complete:
            raise ParameterFileError(sentence("file.no_scale", name=self._name), Reason.UNITS)
        return self.calibration.gyroscope.parameters

    @overload
    def apply(self, raw: Samples) -> Corrected: ...

    @overload
    def apply(self, raw: FloatArray) -> FloatArray: ...

    def apply(self, raw: Samples | FloatArray) -> Corrected | FloatArray:
        """Correct raw values.

        Parameters
        ----------
        raw : Samples or ndarray
            Samples, or an array of shape (..., 3), ax ay az, or of shape (..., 6), ax ay az gx gy gz; raw units,
            increments divided by their interval.

        Returns
        -------
        Corrected or ndarray
            ``Corrected`` for samples; for an array one of the same shape, in m/s^2 and rad/s.

        Raises
        ------
        ParameterFileError
            If the samples are in other raw units than the parameters, the shape is wrong, or gyroscope values are given
            and the file has no gyroscope.
        CalibrationError
            If no specific force gives such an output with these parameters.
        """
        if isinstance(raw, Samples):
            self.check_unit("accelerometer", raw.units.accelerometer_rate_unit)
            force = self.apply_accelerometer(raw.accelerometer_rate())
            # A file without the gyroscope is still good for the accelerometer.
            if not self.gyroscope_is_complete:
                return Corrected(raw.time_s, force, np.full_like(force, np.nan))
            self.check_unit("gyroscope", raw.units.gyroscope_rate_unit)
            return Corrected(raw.time_s, force, self.apply_gyroscope(raw.gyroscope_rate(), force))
        # What a caller gives may be a list, or an array of whole counts.
        raw = np.asarray(raw, dtype=np.float64)
        if raw.shape[-1:] != (6,):
            return self.apply_accelerometer(raw)
        return correct_both(self.calibration.accelerometer, self._gyroscope(), raw.reshape(-1, 6)).reshape(raw.shape)

    @property
    def gyroscope_is_complete(self) -> bool:
        """Whether the file can turn gyroscope output into rad/s."""
        gyroscope = self.calibration.gyroscope
        return gyroscope is not None and bool(np.isfinite(gyroscope.parameters.scale).all())

    @property
    def _name(self) -> str:
        return "the parameter file" if self.path is None else str(self.path)

    @property
    def edited_note(self) -> str:
        """The sentence that says so where the file was edited by hand, else an empty one."""
        return sentence("file.edited", name=self._name) if self.edited else ""

    @property
    def gyroscope_note(self) -> str:
        """The sentence that says so where the gyroscope was not calibrated, or its bias alone, else an empty one."""
        gyroscope = self.calibration.gyroscope
        if gyroscope is None:
            return sentence("file.not_calibrated", name=self._name)
        if np.isfinite(gyroscope.sigma.scale).any():
            return ""
        return sentence("file.bias_with_scale" if self.gyroscope_is_complete else "file.bias_alone", name=self._name)

    def check_unit(self, triad: str, unit: str) -> None:
        """Raise ``ParameterFileError`` if a triad whose rates are in this unit is not what the parameters are for."""
        wanted = self.document[triad]["raw_unit"]
        if wanted != unit:
            refused = sentence("file.unit", name=self._name, triad=triad, wanted=wanted, unit=unit)
            raise ParameterFileError(refused, Reason.UNITS)

    def check_instrument(self, serial_number: str) -> None:
        """Raise ``ParameterFileError`` if both serial numbers are known and these parameters are of another instrument."""
        known = self.context.instrument.serial_number
        if known and serial_number and known != serial_number:
            refused = sentence("file.instrument", name=self._name, parameters=known, recording=serial_number)
            raise ParameterFileError(refused, Reason.FOREIGN)


def from_document(document: Document, *, path: Path | None = None) -> Parameters:
    """Return the parameters of a document that passed the checks of ``read_document``."""
    return Parameters(
        calibration=calibration_from_document(document),
        context=context_from_document(document),
        document=document,
        # A document that was just made, and not read, has no hash yet.
        edited=document.get("integrity", {}).get("sha256") == EDITED,
        path=path,
    )


def load(path: str | Path) -> Parameters:
    """Load a parameter file, or that of a session whose folder is given.

    Parameters
    ----------
    path : str or Path
        Parameter file, or session folder.

    Returns
    -------
    loaded : Parameters
        ``apply(samples)`` corrects raw values; ``calibration`` has every number with its uncertainty, in the units of the
        dictionary (``imufield``); ``document`` is the file's content under the file's keys.

    Raises
    ------
    ParameterFileError
        If the file is not there, cut, damaged, newer than this program, not a parameter file, or edited by hand without
        saying so.
    """
    path = Path(path)
    if path.is_dir():
        return load_found(path / PARAMETER_FILE, Origin.INSIDE)
    return load_found(path, Origin.TYPED)


def load_found(path: Path, origin: Origin) -> Parameters:
    """Load a parameter file that this program looked for; raises as ``load``."""
    content = read_document(path, origin)
    return replace(from_document(content.document, path=path), version=content.version)
