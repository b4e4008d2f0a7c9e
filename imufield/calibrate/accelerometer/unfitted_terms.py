"""Uncertainty added for error terms that were not fitted: in the parameters, and of the higher terms themselves."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from imufield.calibrate.accelerometer.fit import Fit
from imufield.calibrate.accelerometer.model_choice import VERDICT_LEVEL, ChosenModel
from imufield.calibrate.model.aliasing import HIGHER_COLUMNS, LEFT_OUT_SHARES, open_terms, typical_entries, typical_higher
from imufield.calibrate.model.coverage_factors import NORMAL_FACTOR_95, f_tail, student_factor
from imufield.calibrate.model.grades import Grade
from imufield.calibrate.model.higher_terms import KINDS, TERMS, HigherTerms, higher_scale
from imufield.calibrate.model.models import MISALIGNMENT, PARAMETERS, QUADRATIC, SCALE
from imufield.calibrate.model.observability import LOWER_GAUGE_COLUMNS, parameter_scale
from imufield.dataclass import dataclass, field
from imufield.samples import FloatArray


@dataclass(frozen=True, slots=True)
class Unshown:
    """Roots of what the fit does not show of covariances, in columns."""

    choice: FloatArray
    """Of the 15 parameters by choosing the model, shape (15, k)."""
    typical: FloatArray
    """Of them by typical terms, shape (15, l)."""
    higher: FloatArray
    """Of the higher terms in steps of ``higher_scale``, shape (12, l)."""
    left_out: dict[str, FloatArray] = field(default_factory=dict)
    """Of the parameters by entries that the positions leave open, these included, by the name of the share."""

    @property
    def parameters(self) -> FloatArray:
        """Of the 15 parameters, shape (15, k + l)."""
        return np.hstack([self.choice, self.typical])


def unshown(
    fitted: Fit,
    chosen: ChosenModel,
    typical: Grade | None,
    up: FloatArray,
    *,
    is_open: NDArray[np.bool_],
    to_gauge: FloatArray,
    gravity_m_s2: float,
) -> Unshown:
    """Return what choosing the model adds, and typical terms that are not fitted; of higher terms the rest of what is shown.

    Parameters
    ----------
    fitted : Fit
        In the wanted gauge.
    chosen : ChosenModel
    typical : Grade, optional
    up : ndarray, shape (m, 3)
    is_open : ndarray, shape (6,)
        As for ``open_terms``.
    to_gauge : ndarray, shape (15, 15)
        From the gauge of ``chosen``.
    gravity_m_s2 : float
    """
    by_choice = to_gauge @ chosen.choice.root
    if typical is None:
        return Unshown(by_choice, np.zeros((PARAMETERS, 0)), np.zeros((TERMS, 0)))
    shown, columns, sigma = chosen.higher, open_terms(up, typical, is_open), fitted.sigma_m_s2[:, None]
    rest = np.eye(TERMS) - shown @ shown.T
    if fitted.higher is not None:
        found_m_s2 = shown.T @ (fitted.higher.to_vector() / higher_scale(gravity_m_s2))
        rest *= _excess(fitted, shown, found_m_s2, typical)
    columns[:, HIGHER_COLUMNS] = columns[:, HIGHER_COLUMNS] @ rest
    alias = np.linalg.lstsq(fitted.jacobian / sigma, columns / sigma, rcond=None)[0]
    higher = shown @ alias[len(alias) - shown.shape[1] :]
    higher[:, HIGHER_COLUMNS] += typical_higher(typical)[:, None] * rest
    moved = fitted.basis @ alias
    # An entry that keeps its value is itself off by all of the term.
    entries = np.array(LOWER_GAUGE_COLUMNS[6:])[is_open]
    steps = parameter_scale(fitted.vector, gravity_m_s2)
    steps[QUADRATIC] *= np.sign(fitted.vector[SCALE])
    own = to_gauge[:, entries] * steps[entries] * typical_entries(typical)[is_open]
    own[: MISALIGNMENT.start] = 0.0  # What the turn into the gauge makes of it there is of second order.
    roots = np.split(moved[:, moved.shape[1] - len(entries) :] + own, [np.count_nonzero(is_open[:3])], axis=1)
    left_out = {name: root for name, root in zip(LEFT_OUT_SHARES, roots, strict=True) if root.size}
    return Unshown(by_choice, moved, higher, left_out)


def _excess(fitted: Fit, shown: FloatArray, found_m_s2: FloatArray, typical: Grade) -> FloatArray:
    """Return how many times as large as typical the terms are taken to be, shape (12,).

    Where the part of a kind that is shown is larger than noise and typical terms explain, its size stands for the rest: known
    from k numbers only, so by Student's factor.
    """
    spread = np.linalg.inv(np.linalg.qr(fitted.jacobian / fitted.sigma_m_s2[:, None])[1])
    variance = np.sum(spread[-shown.shape[1] :] ** 2, axis=1)
    excess = np.ones(TERMS)
    for kind in KINDS:
        own, size = shown[kind].any(axis=0), typical_higher(typical)[kind][0]
        square, count = found_m_s2[own] ** 2, int(own.sum())
        ratio = float(np.mean(square / (variance[own] + size**2))) if count else 0.0
        if count and f_tail(count, fitted.degrees_of_freedom, ratio) < VERDICT_LEVEL:
            # The factor that is stated goes down to the normal one, the larger the part that residuals do not tell.
            factor = student_factor(count) / NORMAL_FACTOR_95
            excess[kind] = max(1.0, factor * float(np.sqrt(np.mean(square))) / size)
    return excess


def higher_sigma(chosen: ChosenModel, covariance: FloatArray, hidden: Unshown, gravity_m_s2: float) -> HigherTerms | None:
    """Return 1 sigma of the higher terms, NaN where nothing is shown of one; None where none is fitted.

    Parameters
    ----------
    chosen : ChosenModel
    covariance : ndarray, shape (k, k)
        Of the combinations that are fitted.
    hidden : Unshown
    gravity_m_s2 : float
    """
    shown = chosen.higher
    if not shown.size:
        return None
    variance = np.diag(shown @ covariance @ shown.T + hidden.higher @ hidden.higher.T)
    return HigherTerms.from_vector(higher_scale(gravity_m_s2) * np.where(shown.any(axis=1), np.sqrt(variance), np.nan))
