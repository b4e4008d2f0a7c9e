"""The gyroscope's model: whether the g-sensitivity G is fitted.

The choice "auto" keeps G where an F test on its nine entries together says 95 %. Where it does not, the best guess of what it
hides goes into the covariance, as for the accelerometer's quadratic term.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from imufield.calibrate.gyroscope.fit import JointFit, fit_jointly
from imufield.calibrate.gyroscope.move_integration import PARAMETERS, SENSITIVITY
from imufield.calibrate.gyroscope.observability import Observability
from imufield.calibrate.gyroscope.residuals import GyroscopeData
from imufield.calibrate.model.uncertainty import f_limit_95, told_apart
from imufield.errors import CalibrationError, Reason
from imufield.samples import FloatArray
from imufield.sentences import Sentence, Sentences

sentence = Sentences(__package__)

GyroscopeModel = Literal["auto", "basic", "g-sensitive"]
BASIC = np.arange(SENSITIVITY.start)
FULL = np.arange(PARAMETERS)


@dataclass(frozen=True, slots=True)
class ChosenModel:
    """The model that is kept, and its fit."""

    fit: JointFit
    g_sensitive: bool
    hidden_change: FloatArray
    """By how much a rejected g-sensitivity may have moved the rest, shape (parameters,)."""
    sentence: Sentence


def choose_model(data: GyroscopeData, start: FloatArray, observability: Observability, model: GyroscopeModel) -> ChosenModel:
    """Fit what is asked for, or, with "auto", what is significant.

    Raises
    ------
    CalibrationError
        If the g-sensitivity is asked for and the positions cannot show it.
    """
    nothing = np.zeros(data.parameters)
    if model == "basic" or not observability.sensitivity:
        if model == "g-sensitive":
            raise CalibrationError(sentence("model_choice.hidden"), Reason.UNOBSERVABLE)
        why = sentence("model_choice.basic_as_asked" if model == "basic" else "model_choice.basic_as_shown")
        basic = fit_jointly(data, start, observability.free(BASIC))
        return ChosenModel(basic, False, nothing, why)
    full = fit_jointly(data, start, observability.free(FULL))
    if model == "g-sensitive":
        return ChosenModel(full, True, nothing, sentence("model_choice.fitted_as_asked"))
    # F statistic of the entries of G against zero.
    places = np.flatnonzero((full.free >= SENSITIVITY.start) & (full.free < SENSITIVITY.stop))
    values = full.p[full.free[places]]
    F = float(values @ np.linalg.pinv(full.covariance[np.ix_(places, places)], hermitian=True) @ values) / len(places)
    F, limit = max(F, np.finfo(float).tiny), f_limit_95(len(places), full.degrees_of_freedom)
    told = dict(zip(("F", "limit"), told_apart(F, limit), strict=True))
    if limit < F:
        return ChosenModel(full, True, nothing, sentence("model_choice.kept", **told))
    basic = fit_jointly(data, start, observability.free(BASIC))
    # Of F only what is above 1, the value of pure noise, speaks for a true G.
    hidden_change = np.sqrt(max(0.0, 1 - 1 / F)) * (full.p - basic.p)
    hidden_change[SENSITIVITY] = 0.0
    return ChosenModel(basic, False, hidden_change, sentence("model_choice.left_out", **told))
