"""Joint covariance of the 15 parameters and gravity: the fit's own, gravity's, and that of what no residual shows.

The covariance of the fit goes through the change of gauge to the parameters. Gravity is a common scale: its sigma moves all of
them together. What the positions cannot show enters by what is typical (``unfitted_terms``). ``covariance_shares`` tells the
same by source.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from imufield.calibrate.accelerometer.covariance_shares import fit_shares, gravity_share, hidden_shares
from imufield.calibrate.accelerometer.fit import Fit, FitData
from imufield.calibrate.accelerometer.leave_one_out import Influence, influence, single_position_factors, single_positions
from imufield.calibrate.accelerometer.model_choice import ChosenModel
from imufield.calibrate.accelerometer.unfitted_terms import Unshown, higher_sigma
from imufield.calibrate.model.budget import Share
from imufield.calibrate.model.higher_terms import HigherTerms
from imufield.calibrate.model.models import PARAMETERS
from imufield.calibrate.model.observability import LOWER_GAUGE_COLUMNS, parameter_scale
from imufield.calibrate.model.uncertainty import SPARE_POSITIONS, gravity_sensitivity
from imufield.dataclass import dataclass, replace
from imufield.earth import Gravity
from imufield.samples import FloatArray

# A number that takes more than this share (in scaled coordinates) of a parameter that was not fitted has no sigma.
_MIXED = 0.1


@dataclass(frozen=True, slots=True, kw_only=True)
class Uncertainty:
    """How sure the parameters are, and what tells it: all in the wanted gauge."""

    covariance: FloatArray
    """Of 15 parameters and gravity."""
    sigma: FloatArray
    """Of the parameters; NaN where one depends on what was not fitted."""
    higher_sigma: HigherTerms | None
    by_left_out: FloatArray
    """How parameters that were not fitted, in steps of their scale, reach all, shape (15, k)."""
    spread: Influence
    geometry: Influence
    """The same without a drift."""
    factors: FloatArray
    """By how much the sigma of each coordinate is raised, shape (n,)."""
    shares: tuple[Share, ...]
    """Of the fit, in the uncertainty of the parameters."""
    gravity: Share


def propagate(
    fitted: Fit, chosen: ChosenModel, data: FitData, gravity: Gravity, *, hidden: Unshown, to_gauge: FloatArray
) -> Uncertainty:
    """Return how sure the parameters are."""
    parameters = len(chosen.free)
    residual, jacobian = fitted.residual_m_s2 / fitted.sigma_m_s2, fitted.jacobian / fitted.sigma_m_s2[:, None]
    spread = influence(residual, jacobian)
    # What carries a parameter alone is a matter of the positions; a drift beside it takes half of what they have to spare.
    geometry = influence(residual, jacobian[:, :parameters])
    factors = np.ones(fitted.basis.shape[1])
    covariance = spread.covariance * chosen.choice.variance_ratio
    if fitted.degrees_of_freedom >= SPARE_POSITIONS:
        factors[:parameters] = single_position_factors(geometry, single_positions(geometry))
        covariance = covariance * np.outer(factors, factors)
    elif fitted.effective_degrees_of_freedom == 0 and data.covariance_raw is None:
        covariance = np.full_like(covariance, np.nan)  # nothing says how sure anything is
    # Gravity is a common scale: its sigma moves all parameters together.
    t = np.append(gravity_sensitivity(fitted.vector, gravity.gravity_m_s2), 1.0)
    joint = np.outer(t, t) * gravity.sigma_m_s2**2
    joint[:PARAMETERS, :PARAMETERS] += fitted.basis @ covariance @ fitted.basis.T + hidden.parameters @ hidden.parameters.T
    scale = parameter_scale(fitted.vector, gravity.gravity_m_s2)
    left_out = [k for k in LOWER_GAUGE_COLUMNS if k not in chosen.free]
    by_left_out = to_gauge[:, left_out] * scale[left_out]
    sigma = np.where(is_known(by_left_out, scale), np.sqrt(np.diag(joint)[:PARAMETERS]), np.nan)
    return Uncertainty(
        covariance=joint,
        sigma=sigma,
        higher_sigma=higher_sigma(chosen, covariance[parameters:, parameters:], hidden, gravity.gravity_m_s2),
        by_left_out=by_left_out,
        spread=spread,
        geometry=geometry,
        factors=factors,
        shares=tuple(fit_shares(fitted, data, chosen.choice, factors=factors, parameters=parameters)),
        gravity=gravity_share(t, gravity.sigma_m_s2),
    )


def is_known(by_left_out: FloatArray, size: FloatArray) -> NDArray[np.bool_]:
    """Return which numbers have a sigma: those that do not depend on parameters which were not fitted."""
    return np.asarray(~np.any(np.abs(by_left_out) / size[:, None] > _MIXED, axis=1))


def all_shares(known: Uncertainty, hidden: Unshown, open_misalignments: int) -> tuple[Share, ...]:
    """Return the shares of the 15 parameters and gravity, to which it alone contributes."""
    of_parameters = [*known.shares, *hidden_shares(hidden, open_misalignments, known.shares[0].degrees_of_freedom)]
    return (*(replace(share, sigma=np.append(share.sigma, 0.0)) for share in of_parameters), known.gravity)
