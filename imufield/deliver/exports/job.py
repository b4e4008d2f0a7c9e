"""What every exporter gets (``Job``) and gives back (``Draft``), and the checks and measurements around it."""

from __future__ import annotations

import re
from collections.abc import Callable

import numpy as np

from imufield.acquire.protocol.units import nominal_scale
from imufield.calibrate.model.rotation import from_matrix, logarithm
from imufield.dataclass import dataclass, replace
from imufield.deliver.exports.conventions import (
    Correction,
    Corrections,
    Frame,
    linear_corrections,
    require_usable,
)
from imufield.deliver.exports.loss import at_one_temperature, loss_sentences
from imufield.deliver.exports.target import Exported, ExportOptions, Target
from imufield.deliver.parameters.file import Parameters
from imufield.deliver.parameters.printed_numbers import to_ascii
from imufield.errors import ParameterFileError, Reason, UsageError
from imufield.samples import AXES, FloatArray
from imufield.sentences import Sentences

sentence = Sentences(__package__)

BIAS_ONLY = sentence("job.bias_only")
_SI = {"accelerometer": "m/s^2", "gyroscope": "rad/s"}
_NO_TURN_RAD = 1e-9  # A smaller turn is rounding.


@dataclass(frozen=True, slots=True, kw_only=True)
class Draft:
    """What an exporter returns."""

    files: dict[str, bytes]
    target_model: Corrections | None = None
    """What the target will compute from this instrument's raw output; None where the target has a place for the whole model."""
    accelerometer_lacks: str = ""
    """Why the accelerometer differs, to be put before the numbers."""
    gyroscope_lacks: str = ""
    losses: tuple[str, ...] = ()
    """What is lost beside that, in sentences."""
    notes: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Job:
    """One export."""

    parameters: Parameters
    target: Target
    options: ExportOptions

    @property
    def has_gyroscope(self) -> bool:
        """Whether there is a gyroscope with its scale."""
        return self.parameters.gyroscope_is_complete

    @property
    def free_frame(self) -> Frame:
        """Body frame where the target takes any."""
        return self.options.gauge or "file"

    def fixed_frame(self, frame: Frame) -> Frame:
        """Return the only body frame the target can take; refuses another that the user asked for."""
        if self.options.gauge not in (None, frame):
            raise UsageError(sentence("job.gauge", target=self.target.name, gauge=self.options.gauge))
        return frame

    def corrections(self, frame: Frame) -> Corrections:
        """Return the linear corrections of raw output in its own unit."""
        return linear_corrections(self.parameters.calibration, frame)

    def in_si(self, corrections: Corrections) -> Corrections:
        """Return the same for a program whose raw values are m/s^2 and rad/s.

        Raises
        ------
        ParameterFileError
            If the raw unit is one that only the maker of the driver can turn into SI.
        """
        scale, zero = self.accelerometer_si()
        accelerometer = corrections.accelerometer.of_scaled(scale, zero)
        own = self.parameters.calibration.gyroscope
        if corrections.gyroscope is None or own is None:
            return replace(corrections, accelerometer=accelerometer)
        scale = self.si_scale("gyroscope")
        gyroscope = corrections.gyroscope.of_scaled(scale, self._driver_zero("gyroscope", own.parameters.raw_zero))
        return replace(
            corrections, accelerometer=accelerometer, gyroscope=gyroscope, g_sensitivity=corrections.g_sensitivity / scale
        )

    def accelerometer_si(self) -> tuple[float, FloatArray]:
        """Return scale and zero by which the target's driver makes m/s^2: (N - zero) / scale; raises as ``in_si``."""
        raw_zero = self.parameters.calibration.accelerometer.raw_zero
        return self.si_scale("accelerometer"), self._driver_zero("accelerometer", raw_zero)

    def _driver_zero(self, triad: str, raw_zero: FloatArray) -> FloatArray:
        """Return what the target's driver subtracts, shape (3,): the raw zero where it makes SI of counts, else 0."""
        return raw_zero * (getattr(self.options, f"{triad}_nominal") is not None)

    def si_scale(self, triad: str) -> float:
        """Return the scale by which the target's driver makes SI of a triad that there is; raises as ``in_si``."""
        calibration = self.parameters.calibration
        units = {"accelerometer": calibration.accelerometer_raw_unit}
        if calibration.gyroscope is not None and self.has_gyroscope:
            units["gyroscope"] = calibration.gyroscope.raw_unit
        typed: dict[str, float | None] = {name: getattr(self.options, f"{name}_nominal") for name in units}
        scale = typed[triad]
        if scale is not None and not (np.isfinite(scale) and scale != 0):
            raise UsageError(sentence("job.nominal", triad=triad, value=scale))
        if scale is None:
            scale = nominal_scale(units[triad])
        if scale is not None:
            return scale
        # Every option that is missing at once, so that a user need not run into one after the other.
        missing = [name for name in units if typed[name] is None and nominal_scale(units[name]) is None]
        settings = " and ".join(f"--set {name}_nominal=NUMBER ({units[name]} per {_SI[name]})" for name in missing)
        unit = units[triad]
        refused = sentence("job.unit", target=self.target.name, triad=triad, unit=unit, settings=settings)
        raise ParameterFileError(refused, Reason.UNITS)

    def gyroscope_bias_only(self, corrections: Corrections) -> Corrections:
        """Return corrections whose gyroscope has the nominal scale and no misalignment.

        Raises
        ------
        ParameterFileError
            If an axis of the gyroscope is reversed: a bias cannot turn it.
        """
        if corrections.gyroscope is None:
            return corrections
        scale = self.si_scale("gyroscope")
        self.require_positive("gyroscope", scale * np.diag(corrections.gyroscope.matrix))
        bias_only = Correction(np.eye(3) / scale, corrections.gyroscope.offset)
        return replace(corrections.without_g_sensitivity(), gyroscope=bias_only)

    def require_positive(self, triad: str, scale: FloatArray) -> None:
        """Check that the signs of a triad's axes can be expressed by a target that knows positive scales only."""
        for axis, value in zip(AXES, scale, strict=True):
            if not value > 0:
                refused = sentence("job.sign", target=self.target.name, triad=triad, axis=axis, scale=float(value))
                raise ParameterFileError(refused, Reason.BOUNDS)

    def example(self, corrections: Corrections) -> list[str]:
        """Return a worked number for the file: what these corrections make of one raw sample in SI."""
        # The same raw sample as on the pages of docs/exports.
        raw, rate = np.array([1.0, -2.0, 9.5]), np.array([0.1, -0.2, 0.3])
        force = corrections.apply_accelerometer(raw)
        lines = [f"example: accelerometer {_shown(raw)} m/s^2 -> {_shown(force)}"]
        if corrections.gyroscope is not None:
            lines.append(f"example: gyroscope {_shown(rate)} rad/s -> {_shown(corrections.apply_gyroscope(rate, force))}")
        return lines

    def heading(self) -> list[str]:
        """Return lines that say where the numbers come from, plain ASCII, one line each."""
        context = self.parameters.context
        facts = context.instrument
        instrument = " ".join(filter(None, (facts.model or facts.driver, facts.serial_number)))
        lines = [
            self.target.title,
            f"instrument: {instrument or 'not known'}",
            f"calibrated: {context.created}, {context.software}, session {context.session.name or 'not known'}",
            f"verdict: {self.parameters.calibration.quality.verdict}",
        ]
        # A line break in a name would end the comment it stands in.
        return [re.sub(r"[^ -~]", "?", to_ascii(line)) for line in lines]


def _shown(values: FloatArray) -> str:
    return f"({', '.join(f'{value:.9g}' for value in values)})"


def run(export: Callable[[Job], Draft], parameters: Parameters, target: Target, options: ExportOptions) -> Exported:
    """Check, export, and measure what was lost."""
    parameters, cost = at_one_temperature(parameters, target, options.temperature_degc)
    require_usable(parameters.calibration)
    job = Job(parameters, target, options)
    draft = export(job)
    draft = replace(draft, losses=(*draft.losses, *cost))
    notes = draft.notes
    if not job.has_gyroscope and parameters.calibration.gyroscope is not None:
        notes = (sentence("job.no_gyroscope"), *notes)
    calibration = parameters.calibration
    # A gyroscope that is left out has its own note above.
    undetermined = [name.rpartition(".")[0] for name in calibration.unobservable if job.has_gyroscope or "gyro" not in name]
    if undetermined:
        notes = (sentence("job.not_determined", names=list(dict.fromkeys(undetermined))), *notes)
    if calibration.quality.verdict == "usable":
        notes = (sentence("job.usable", reason=calibration.quality.main_reason), *notes)
    if draft.target_model is None:
        return Exported(draft.files, draft.losses, notes)
    losses = loss_sentences(parameters, draft.target_model, draft.accelerometer_lacks, draft.gyroscope_lacks)
    return Exported(draft.files, (*losses, *draft.losses), (*frame_note(draft.target_model.rotation), *notes))


def frame_note(rotation: FloatArray) -> tuple[str, ...]:
    """Say by how much the target's body frame is turned; nothing where it is not."""
    turn_rad = logarithm(from_matrix(rotation))
    if np.linalg.norm(turn_rad) < _NO_TURN_RAD:
        return ()
    x, y, z = turn_rad * 1e3
    return (sentence("job.turned", x=x, y=y, z=z),)
