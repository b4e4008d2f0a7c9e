"""What a calibration has gained: the error of the specific force at rest before and after, position by position."""

from __future__ import annotations

from typing import Literal

import numpy as np

from imufield.acquire.protocol.units import nominal_scale
from imufield.calibrate.model.models import recover
from imufield.calibrate.model.result import AccelerometerParameters
from imufield.calibrate.model.uncertainty import rms
from imufield.dataclass import dataclass
from imufield.deliver.parameters.file import Parameters, json_ready
from imufield.deliver.parameters.schema import Document
from imufield.earth import MICRO_G_M_S2, MILLI_G_M_S2
from imufield.errors import CalibrationError
from imufield.samples import FloatArray
from imufield.sentences import Sentence, Sentences

sentence = Sentences(__package__)

_LEAST_FACTOR = 1.1  # Less is no gain that anybody sees.
_BY = {"preset": "gain.by_preset", "nominal": "gain.by_nominal", "fitted": "gain.by_fitted"}
_ROUNDING_M_S2 = 1e-6 * MICRO_G_M_S2  # What is left of ideal outputs.


@dataclass(frozen=True, slots=True)
class Gain:
    """Norm of the specific force less gravity at the positions that others can check."""

    names: tuple[str, ...]
    before_m_s2: FloatArray
    """By the parameters in force before; where there were none by the nominal scale, or one scale that fits. Shape (m,)."""
    after_m_s2: FloatArray
    """With this position left out of the fit. Shape (m,)."""
    by: Literal["preset", "nominal", "fitted"] = "nominal"
    """What gave the error before: the parameters in force, the nominal scale, or one scale that fits."""

    @property
    def words(self) -> Sentence:
        """In one line."""
        before_m_s2, after_m_s2 = rms(self.before_m_s2), rms(self.after_m_s2)
        factor = before_m_s2 / max(after_m_s2, _ROUNDING_M_S2)
        errors = {"before_mg": before_m_s2 / MILLI_G_M_S2, "after_mg": after_m_s2 / MILLI_G_M_S2}
        key = "gain.better" if factor > _LEAST_FACTOR else "gain.not_better"
        times = f"{factor:.0f}" if factor >= 10 else f"{factor:.1f}"
        return sentence(key, **errors, by=sentence(_BY[self.by]), times=times)


def gain(parameters: Parameters, preset: Parameters | None = None) -> Gain | None:
    """Return what the calibration has gained; None where no position can be left out."""
    calibration = parameters.calibration
    # The residual of a position that no other checks tells no gain: the fit goes through it.
    left_out = np.where(calibration.positions.used, calibration.positions.leave_one_out_m_s2, np.nan)
    is_checked = np.isfinite(left_out)
    if not is_checked.any() or calibration.quality.degrees_of_freedom < 1:
        return None
    tables = [table for table, checked in zip(parameters.document["position"], is_checked, strict=True) if checked]
    accelerometer, gravity = calibration.accelerometer, calibration.gravity.gravity_m_s2
    raw = np.array([table["mean_raw"] for table in tables], dtype=np.float64)
    by: Literal["preset", "nominal", "fitted"] = "preset"
    before = None if preset is None else _norms(preset.calibration.accelerometer, raw)
    if before is None:
        outputs = np.linalg.norm(raw - accelerometer.raw_zero, axis=1)
        nominal = nominal_scale(calibration.accelerometer_raw_unit)
        by = "nominal" if nominal else "fitted"
        before = outputs / (nominal or float(np.mean(outputs)) / gravity)
    return Gain(tuple(table["name"] for table in tables), before - gravity, left_out[is_checked], by)


def document_with_gain(parameters: Parameters) -> Document:
    """Return the content of a parameter file for JSON, and beside it what the summary says of it in one line."""
    gained = gain(parameters)
    if gained is None:
        return json_ready(parameters.document)
    figures = {key: value for key, value in gained.words.values.items() if key != "by"}
    return {**json_ready(parameters.document), "error_at_rest": {"words": gained.words, **figures}}


def _norms(parameters: AccelerometerParameters, raw: FloatArray) -> FloatArray | None:
    try:
        return np.asarray(np.linalg.norm(recover(parameters, raw), axis=1))
    except CalibrationError:
        # Parameters of another range have no answer for these outputs: nothing to compare with.
        return None
