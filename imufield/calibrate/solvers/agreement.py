"""Agreement of methods as proof: how far apart they end, in units of sigma.

Each method minimises the cost of its paper, so even two perfect ones differ by statistics: an absolute cost weighs outliers
less than squares do. A cross-check therefore runs twice: with each method's own cost, and with one weighted cost for all, where
what is left is how well each method searches.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from imufield.calibrate.solvers.norm_problem import CostName
from imufield.calibrate.solvers.registry import find_method
from imufield.dataclass import dataclass
from imufield.samples import FloatArray
from imufield.sentences import Sentences

sentence = Sentences(__package__)

LEAST_SQUARES = "least-squares"
CROSS_CHECKED = ("bsas", "ide", LEAST_SQUARES)
AGREEMENT_SIGMA = 3.0
"""Methods with different costs may differ by this much; an absolute cost alone makes 0.7 on the average of one parameter."""
SEARCH_AGREEMENT_SIGMA = 0.05
"""Methods with one cost may differ by this much."""

Attempt = tuple[FloatArray, str]
"""What a method found, and why it did not converge, "" where it did."""


@dataclass(frozen=True, slots=True)
class MethodDifference:
    """The largest difference between two methods in one number."""

    sigma: float
    parameter: str
    methods: tuple[str, str]

    @property
    def words(self) -> str:
        """The parameter as people read it: "bias x" for "intrinsic.bias_raw.x"."""
        return " ".join(part.removesuffix("_raw").removesuffix("_rad") for part in self.parameter.split(".")[1:])


@dataclass(frozen=True, slots=True, kw_only=True)
class CrossCheck:
    """What several methods make of the same observations."""

    what: str
    """Accelerometer or gyroscope."""
    own_costs: MethodDifference
    """Each with the cost of its paper."""
    one_cost: MethodDifference
    """All with the weighted cost."""
    not_converged: tuple[str, ...]
    """A sentence for each run that did not converge."""
    found: dict[str, FloatArray]
    """The numbers compared, by method, own costs, shape (n,) each."""

    @property
    def agree(self) -> bool:
        """Whether the methods prove one another."""
        near = self.own_costs.sigma <= AGREEMENT_SIGMA and self.one_cost.sigma <= SEARCH_AGREEMENT_SIGMA
        return near and not self.not_converged

    @property
    def sentence(self) -> str:
        """The outcome in words."""
        key = "agreement.agree" if self.agree else "agreement.disagree"
        told = sentence(
            key,
            what=self.what,
            methods=list(self.found),
            own=self.own_costs,
            limit_sigma=AGREEMENT_SIGMA,
            shared=self.one_cost,
            shared_limit_sigma=SEARCH_AGREEMENT_SIGMA,
        )
        return "; ".join([told, *self.not_converged])


def compare(
    what: str,
    attempt: Callable[[str, CostName], Attempt],
    names: Sequence[str],
    sigma: FloatArray,
    *,
    methods: Sequence[str] = CROSS_CHECKED,
) -> CrossCheck:
    """Let each method try with its own cost and with the weighted one, and compare.

    Parameters
    ----------
    what : str
    attempt : callable
        Given method and cost, returns the n numbers it found and why it did not converge.
    names : sequence of str
    sigma : ndarray, shape (n,)
        0 where a number is not fitted.
    methods : sequence of str

    Raises
    ------
    UsageError
        If there is no such method.
    """
    own: dict[str, FloatArray] = {}
    shared: dict[str, FloatArray] = {}
    open_runs: list[str] = []
    for method in methods:
        costs: tuple[CostName, CostName] = (find_method(method).cost_name, "weighted")
        for found_by, cost_name in zip((own, shared), costs, strict=True):
            # Own cost first, then the cost that all share.
            found_by[method], why = attempt(method, cost_name)
            if why:
                open_runs.append(sentence("agreement.open_run", method=method, cause=why))
    return CrossCheck(
        what=what,
        own_costs=_largest(own, names, sigma),
        one_cost=_largest(shared, names, sigma),
        not_converged=tuple(dict.fromkeys(open_runs)),
        found=own,
    )


def _largest(found: Mapping[str, FloatArray], names: Sequence[str], sigma: FloatArray) -> MethodDifference:
    methods = list(found)
    largest = MethodDifference(0.0, "", (methods[0], methods[-1]))
    # A number that is not fitted has no sigma, and rounding apart the same value everywhere.
    fitted = sigma > 1e-9 * np.maximum(np.abs(found[methods[0]]), np.finfo(float).tiny)
    for i, first in enumerate(methods):
        for second in methods[i + 1 :]:
            apart = np.where(fitted, np.abs(found[first] - found[second]) / np.where(fitted, sigma, 1.0), 0.0)
            worst = int(np.argmax(apart))
            if apart[worst] > largest.sigma:
                largest = MethodDifference(float(apart[worst]), names[worst], (first, second))
    return largest
