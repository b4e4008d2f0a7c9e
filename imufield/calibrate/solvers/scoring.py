"""How far a step of Fisher scoring may go, of variances and their restricted likelihood.

Scoring steps by the expected information; the likelihood bends by the observed one. Where that is more than twice as much along
a step, the step ends lower than it began, and two steps can lead to and fro for ever. With ``P`` of all noise and ``V_k`` of
each variance, the observed information is r^T P V_k P V_l P r - tr(P V_k P V_l) / 2 [1]_.

References
----------
.. [1] D. A. Harville, "Maximum likelihood approaches to variance component estimation and to related problems", Journal of the
   American Statistical Association 72 (1977) 320.
"""

from __future__ import annotations

from imufield.samples import FloatArray


def cut_at_top(step: FloatArray, score: FloatArray, observed: FloatArray) -> FloatArray:
    """Return a step of k variances, cut to the top of the likelihood's parabola along it where it goes twice as far or more.

    Parameters
    ----------
    step, score : ndarray, shape (k,)
    observed : ndarray, shape (k, k)
        Observed information, in the same multiple as the score.
    """
    gain, curvature = score @ step, step @ observed @ step
    return step * (gain / curvature) if 0 < gain < curvature / 2 else step
