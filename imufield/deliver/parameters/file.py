"""The parameter file for programs: ``imufield.load(path).apply(samples)``.

The format is docs/parameter-file.md; ``parameters.schema.json`` beside this file is its JSON Schema.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple, overload

import numpy as np
from numpy.typing import NDArray

from imufield.calibrate.model.observations import Observations
from imufield.calibrate.model.result import Calibration, GyroscopeCalibration
from imufield.calibrate.model.temperature_polynomials import TriadTemperature
from imufield.dataclass import dataclass, replace
from imufield.deliver.parameters.apply import (
    at_reference,
    correct_accelerometer,
    correct_both,
    correct_gyroscope,
    temperatures_for,
)
from imufield.deliver.parameters.clock import clock_words
from imufield.deliver.parameters.context import Context, InstrumentFacts, Noise, SessionFacts
from imufield.deliver.parameters.document import calibration_from_document, context_from_document, to_document
from imufield.deliver.parameters.read import read_document
from imufield.deliver.parameters.schema import Document, json_ready, parameter_schema
from imufield.deliver.parameters.write import EDITED, as_written, to_toml, write_document, write_parameters
from imufield.errors import ParameterFileError, Reason
from imufield.files import Origin
from imufield.samples import FloatArray, Samples, Status, TemperatureHold
from imufield.sentences import Sentences

if TYPE_CHECKING:
    from imufield.acquire.recording.session_record import InstrumentRecord
    from imufield.deliver.parameters.gauge_free import GaugeFree

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
    "as_written",
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
    document: Document
    """The file's content, in the current version."""
    edited: bool = False
    """Whether somebody changed the file by hand and said so."""
    path: Path | None = None
    version: int
    """Of the file; older than that of the document where it was converted."""
    of_recording: tuple[str, ...] = ()
    """What a solve found missing, damaged or refused in its recording, in sentences; empty for a loaded file."""

    def __repr__(self) -> str:
        """Return one line: instrument, date and verdict. All fields are 300 lines."""
        own, verdict = self.context.instrument, self.calibration.quality.verdict
        who = " ".join(filter(None, (own.model or own.driver, own.serial_number))) or "unknown instrument"
        return f"<Parameters of {who}, measured {self.context.measured}, {verdict.upper()}>"

    @property
    def is_converted(self) -> bool:
        """Whether the document is of a newer version than the file."""
        return bool(self.version != self.document["version"])

    def apply_accelerometer(self, raw: FloatArray, *, temperature_degc: FloatArray | float | None = None) -> FloatArray:
        """Return specific force in m/s^2 for raw outputs (increments divided by their interval), both of shape (..., 3).

        ``temperature_degc`` is one for all or of shape (...); without it, as at the reference temperature.

        Raises
        ------
        CalibrationError
            If no specific force gives such an output with these parameters; NaN is passed on as NaN.
        ParameterFileError
            If the last axis of ``raw`` has not 3 entries.
        """
        return correct_accelerometer(self.calibration.accelerometer, self._accelerometer_at_reference(raw, temperature_degc))

    def _accelerometer_at_reference(self, raw: FloatArray, temperature_degc: FloatArray | float | None) -> FloatArray:
        parameters, model = self.calibration.accelerometer, self.calibration.accelerometer_temperature
        return at_reference(raw, temperature_degc, model, scale=parameters.scale, raw_zero=parameters.raw_zero)

    def _gyroscope_at_reference(self, raw: FloatArray, temperature_degc: FloatArray | float | None) -> FloatArray:
        parameters, model = self._gyroscope().parameters, self._gyroscope().temperature
        return at_reference(raw, temperature_degc, model, scale=parameters.scale, raw_zero=parameters.raw_zero)

    def apply_gyroscope(
        self,
        raw: FloatArray,
        specific_force: FloatArray | None = None,
        *,
        temperature_degc: FloatArray | float | None = None,
    ) -> FloatArray:
        """Return angular rate in rad/s for raw outputs, both of shape (..., 3).

        Parameters
        ----------
        raw : ndarray, shape (..., 3)
            Raw unit; increments divided by their interval.
        specific_force : ndarray, shape (..., 3), optional
            What ``apply_accelerometer`` returns, m/s^2; needed where a g-sensitivity was fitted.
        temperature_degc : float or ndarray of shape (...), optional
            Without it, as at the reference temperature.

        Raises
        ------
        ParameterFileError
            If the file has no gyroscope or not its scale, a g-sensitivity was fitted and ``specific_force`` is not given, or a
            shape is wrong.
        """
        there = self._gyroscope_at_reference(raw, temperature_degc)
        return correct_gyroscope(self._gyroscope().parameters, there, specific_force)

    def _gyroscope(self) -> GyroscopeCalibration:
        if self.calibration.gyroscope is None:
            raise ParameterFileError(sentence("file.no_gyroscope", name=self._name), Reason.UNITS)
        if not self.gyroscope_is_complete:
            raise ParameterFileError(sentence("file.no_scale", name=self._name), Reason.UNITS)
        return self.calibration.gyroscope

    @overload
    def apply(self, raw: Samples) -> Corrected: ...

    @overload
    def apply(self, raw: FloatArray, *, temperature_degc: FloatArray | float | None = None) -> FloatArray: ...

    def apply(self, raw: Samples | FloatArray, *, temperature_degc: FloatArray | float | None = None) -> Corrected | FloatArray:
        """Correct raw values.

        Of a recording that comes in blocks, give each block through one ``imufield.samples.TemperatureHold`` first: a block
        knows no temperature of those before it.

        Parameters
        ----------
        raw : Samples or ndarray
            Samples, or an array of shape (..., 3), ax ay az, or of shape (..., 6), ax ay az gx gy gz; raw units,
            increments divided by their interval.
        temperature_degc : float or ndarray of shape (...), optional
            Of an array; samples have their own, the last one known where a sample has none. Without it, or where it is NaN,
            raw values are corrected as at the reference temperature (``temperature_status`` tells which).

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
            raw = TemperatureHold().fill(raw)
            at_degc = temperatures_for(raw, self.calibration.accelerometer_temperature, 0)
            force = self.apply_accelerometer(raw.accelerometer_rate(), temperature_degc=at_degc)
            # A file without the gyroscope is still good for the accelerometer.
            if not self.gyroscope_is_complete:
                return Corrected(raw.time_s, force, np.full_like(force, np.nan))
            # Samples without a gyroscope are in no unit of it.
            if np.isfinite(raw.gyroscope).any():
                self.check_unit("gyroscope", raw.units.gyroscope_rate_unit)
            at_degc = temperatures_for(raw, self._gyroscope().temperature, 3)
            rate = self.apply_gyroscope(raw.gyroscope_rate(), force, temperature_degc=at_degc)
            return Corrected(raw.time_s, force, rate)
        # What a caller gives may be a list, or an array of whole counts.
        raw = np.asarray(raw, dtype=np.float64)
        if raw.shape[-1:] != (6,):
            return self.apply_accelerometer(raw, temperature_degc=temperature_degc)
        gyroscope = self._gyroscope().parameters
        if temperature_degc is not None and self.temperature_models:
            triads = self._accelerometer_at_reference, self._gyroscope_at_reference
            raw = np.concatenate([to(raw[..., 3 * k : 3 * k + 3], temperature_degc) for k, to in enumerate(triads)], axis=-1)
        return correct_both(self.calibration.accelerometer, gyroscope, raw.reshape(-1, 6)).reshape(raw.shape)

    @property
    def temperature_models(self) -> tuple[TriadTemperature, ...]:
        """What is known over temperature, of the triads of which it is."""
        gyroscope = self.calibration.gyroscope
        both = (self.calibration.accelerometer_temperature, None if gyroscope is None else gyroscope.temperature)
        return tuple(model for model in both if model is not None)

    @property
    def temperature_range_degc(self) -> tuple[float, float]:
        """Lowest and highest temperature at which every triad is known over temperature; NaN where none is."""
        ranges = [model.range_degc for model in self.temperature_models] or [(math.nan, math.nan)]
        return max(low for low, _ in ranges), min(high for _, high in ranges)

    def temperature_status(self, raw: Samples | FloatArray) -> NDArray[np.uint32]:
        """Return ``Status`` flags: which temperatures are not known, and which lie outside those measured, shape (n,).

        ``raw`` is samples, whose temperatures are those that ``apply`` uses, or temperatures of shape (n,).
        """
        temperature_degc = TemperatureHold().fill(raw).temperature_degc if isinstance(raw, Samples) else raw
        status = np.zeros(len(temperature_degc), dtype=np.uint32)
        for model in self.temperature_models:
            status[model.is_outside(temperature_degc)] |= np.uint32(Status.TEMPERATURE_OUTSIDE)
            status[np.isnan(temperature_degc)] |= np.uint32(Status.TEMPERATURE_UNKNOWN)
        return status

    def observed_at_reference(self, observations: Observations) -> Observations:
        """Return observations as they would be at the reference temperature."""
        at_degc = observations.temperature_degc
        force = self._accelerometer_at_reference(observations.mean_raw, at_degc)
        if not self.gyroscope_is_complete:
            return replace(observations, mean_raw=force)
        rate = self._gyroscope_at_reference(observations.gyroscope_mean_raw, at_degc)
        return replace(observations, mean_raw=force, gyroscope_mean_raw=rate)

    def at(self, temperature_degc: float) -> Parameters:
        """Return the parameters that hold at one temperature, for programs that know none.

        Sigma of bias and scale is that of a day that was not measured where sessions show how days differ, else that of the
        reference and of the change from there; the covariance has the same on its diagonal. The document stays that of the
        file, without positions: their outputs belong to the temperature they were measured at.
        """
        if not self.temperature_models:
            return self
        from imufield.calibrate.temperature.at_temperature import calibration_at  # late: only with tables over temperature

        calibration = calibration_at(self.calibration, temperature_degc)
        session = replace(self.context.session, temperature_degc=(temperature_degc, temperature_degc))
        context = replace(self.context, session=session, temperature_sources=())
        return replace(self, calibration=calibration, context=context, document=self.document | {"position": []})

    def gauge_free(self) -> GaugeFree:
        """Return the numbers that no choice of the body frame changes; raises CalibrationError for left-handed axes."""
        from imufield.deliver.parameters.gauge_free import gauge_free  # late: most files are applied, and not compared

        positions = self.document["position"]
        mean_raw, sigma_raw = (
            np.array([position[key] for position in positions], dtype=np.float64) for key in ("mean_raw", "sigma_raw")
        )
        return gauge_free(self.calibration, mean_raw, sigma_raw)

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

    @property
    def verdict_note(self) -> str:
        """The sentence that says why the parameters are not to be relied on, by their own file, else an empty one."""
        solver, quality = self.calibration.solver, self.calibration.quality
        if not solver.converged:
            said = {"method": solver.method, "status": solver.status, "message": solver.message}
            return sentence("file.not_converged", name=self._name, verdict=quality.verdict, **said)
        return sentence("file.poor", name=self._name, reason=quality.main_reason) if quality.verdict == "poor" else ""

    @property
    def clock_note(self) -> str:
        """What to say where the clock behind the gyroscope's scale was compared with no other; empty where it was."""
        clock, gyroscope = self.context.clock, self.calibration.gyroscope
        knows_scale = gyroscope is not None and np.isfinite(gyroscope.sigma.scale).any()
        return clock_words(clock) if knows_scale and clock is not None and clock.source == "unchecked" else ""

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

    def instrument_note(self, recorded: InstrumentRecord, sha256: Callable[[], str]) -> str:
        """Say that no serial numbers show whether a recording is of this instrument; an empty text where they do.

        ``sha256`` is asked for the hash of the recording where its instrument has no serial number: it may be the one that was
        solved.
        """
        own, together = self.context.instrument, self.context.together
        solved = [self.context.session.sha256, *(session.sha256 for session in (() if together is None else together.session))]
        if (own.serial_number and recorded.serial_number) or sha256() in solved:
            return ""
        who = "recording names" if own.serial_number else "parameter file names"
        who = who if own.serial_number or recorded.serial_number else "recording and the parameter file name"
        return sentence("file.no_serial_number", who=who, own=own.model or "unknown", recorded=recorded.model or "unknown")


def from_document(document: Document, *, path: Path | None = None) -> Parameters:
    """Return the parameters of a document that passed the checks of ``read_document``."""
    return Parameters(
        calibration=calibration_from_document(document),
        context=context_from_document(document),
        document=document,
        # A document that was just made, and not read, has no hash yet.
        edited=document.get("integrity", {}).get("sha256") == EDITED,
        path=path,
        version=document["version"],
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
