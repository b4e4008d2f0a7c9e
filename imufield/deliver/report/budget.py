"""The uncertainty budget of a calibration: of each parameter its shares, their sum, and the factor to 95 %.

A file of before has no shares. Gravity's is in the covariance all the same; the rest stands as one.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np

from imufield.acquire.protocol.units import nominal_scale
from imufield.calibrate.model.budget import Share, combined_sigma, effective_freedom
from imufield.calibrate.model.coverage_factors import degrees_of_freedom, student_factor
from imufield.calibrate.model.result import GRAVITY_NAME, AccelerometerParameters, Calibration, GyroscopeParameters
from imufield.calibrate.model.uncertainty import without_gravity
from imufield.dataclass import dataclass, replace
from imufield.deliver.parameters.context import ClockFacts
from imufield.deliver.parameters.file import Parameters
from imufield.deliver.parameters.printed_numbers import DEG_PER_HOUR_RAD_S, acceleration_unit, decimals, rounded
from imufield.deliver.report.over_temperature import temperature_curves
from imufield.earth import MILLI_G_M_S2, STANDARD_GRAVITY_M_S2
from imufield.samples import AXES, FloatArray
from imufield.sentences import Sentence, Sentences, three_digits

sentence = Sentences(__package__)

COVERAGE = 0.95
"""Probability of the interval that the expanded uncertainty is half of."""
LEAST_SHOWN = 1e-3
"""Of the combined uncertainty: a smaller share changes no digit of it."""
_TIME_BASE = "time_base"
_FIXED = 1e-12  # rad: rounding of an angle that the gauge fixes.
_TITLES = {
    "accelerometer.bias_m_s2": "titles.accelerometer_bias",
    "accelerometer.scale": "titles.accelerometer_scale",
    "accelerometer.misalignment_rad": "titles.accelerometer_misalignment",
    "accelerometer.quadratic": "titles.accelerometer_quadratic",
    "gyroscope.bias": "titles.gyroscope_bias",
    "gyroscope.scale": "titles.gyroscope_scale",
    "gyroscope.misalignment_rad": "titles.gyroscope_misalignment",
    "gyroscope.g_sensitivity": "titles.gyroscope_g_sensitivity",
}
_INPUT_UNITS = {"accelerometer": "m/s²", "gyroscope": "rad/s"}


@dataclass(frozen=True, slots=True)
class Entry:
    """What one share contributes to one parameter."""

    share: Share
    sigma: float
    """In the unit of the parameter."""

    @property
    def sensitivity(self) -> float:
        """Size of d parameter / d input; NaN where the share has no single input quantity."""
        return self.sigma / self.share.input_sigma if self.share.input_sigma > 0 else math.nan


@dataclass(frozen=True, slots=True, kw_only=True)
class ParameterBudget:
    """The budget of one parameter, in the unit of the parameter file."""

    name: str
    """As in the covariance, "accelerometer.scale.x"."""
    value: float
    entries: tuple[Entry, ...]
    sigma: float
    """Combined standard uncertainty."""
    degrees_of_freedom: float
    """Effective; infinite where nothing of it is estimated from few residuals."""

    @property
    def place(self) -> str:
        """Axis, or row and column."""
        return self.name.rpartition(".")[2]

    @property
    def sigma_by_clock(self) -> float:
        """Combined standard uncertainty for the clock of the samples: without the share of the time base."""
        return math.hypot(*(entry.sigma for entry in self.entries if entry.share.name != _TIME_BASE))

    @property
    def coverage_factor(self) -> float:
        """From the combined to the expanded uncertainty, by Student's distribution; NaN without degrees of freedom."""
        return student_factor(self.degrees_of_freedom, chance=1 - COVERAGE)

    @property
    def expanded(self) -> float:
        """Half of the 95 % interval."""
        return self.coverage_factor * self.sigma


@dataclass(frozen=True, slots=True, kw_only=True)
class Group:
    """Parameters of one kind."""

    key: str
    """As in the parameter file, "accelerometer.scale"."""
    parameters: tuple[ParameterBudget, ...]

    @property
    def title(self) -> Sentence:
        """For people."""
        return sentence(_TITLES[self.key])

    @property
    def shares(self) -> tuple[Share, ...]:
        """Those that matter for any of them."""
        entries = ((entry, parameter.sigma) for parameter in self.parameters for entry in parameter.entries)
        return tuple(
            {entry.share.name: entry.share for entry, sigma in entries if not entry.sigma < LEAST_SHOWN * sigma}.values()
        )


def budget_of(parameters: Parameters, *, as_rates: bool = False) -> tuple[Group, ...]:
    """Return the budget of each parameter that was estimated, in groups; ``as_rates``: of biases of the gyroscope as e / K."""
    calibration = parameters.calibration
    names = calibration.covariance_names
    shares = [*(calibration.budget or _not_apart(calibration)), *_time_base(calibration, parameters.context.clock)]
    if as_rates and calibration.gyroscope is not None:
        shares = [_of_rates(share, names, calibration.gyroscope.parameters) for share in shares]
    combined, freedom = combined_sigma(shares), effective_freedom(shares)
    groups: dict[str, list[ParameterBudget]] = {}
    for row, name in enumerate(names):
        if name == GRAVITY_NAME or combined[row] <= _FIXED:
            continue
        entries = tuple(Entry(share, float(share.sigma[row])) for share in shares)
        groups.setdefault(name.rpartition(".")[0], []).append(
            ParameterBudget(
                name=name,
                value=_value(calibration, name),
                entries=entries,
                sigma=float(combined[row]),
                degrees_of_freedom=float(freedom[row]),
            )
        )
    return tuple(Group(key=key, parameters=tuple(groups[key])) for key in _TITLES if key in groups)


def _of_rates(share: Share, names: Sequence[str], gyroscope: GyroscopeParameters) -> Share:
    """Return a share of biases e as one of rates e / K, in the raw unit: its part in the scale is one of them, too."""
    sigma = share.sigma.copy()
    for axis, rate in zip(AXES, gyroscope.bias / gyroscope.scale, strict=True):
        bias, scale = f"gyroscope.bias.{axis}", f"gyroscope.scale.{axis}"
        if bias in names and scale in names:
            row = names.index(bias)
            sigma[row] = math.hypot(sigma[row], rate * sigma[names.index(scale)])
    return replace(share, sigma=sigma)


def covariance_of(parameters: Parameters) -> FloatArray:
    """Return the covariance of the parameters of ``budget_of``, in their order and units, with the time base, shape (n, n)."""
    calibration = parameters.calibration
    by_clock = _by_clock(calibration, parameters.context.clock)
    # Rounding in the file leaves it symmetric but for the last digits.
    C = (calibration.covariance + calibration.covariance.T) / 2 + np.outer(by_clock, by_clock)
    names = (parameter.name for group in budget_of(parameters) for parameter in group.parameters)
    rows = [calibration.covariance_names.index(name) for name in names]
    return np.asarray(C[np.ix_(rows, rows)])


def _not_apart(calibration: Calibration) -> Iterator[Share]:
    """Yield the shares of a file that has none: what gravity is in the covariance, and the rest."""
    names, C = calibration.covariance_names, calibration.covariance
    rest = without_gravity(names, C)
    freedom = degrees_of_freedom(calibration.quality.student_factor_95)
    by_gravity = np.sqrt(np.maximum(np.diag(C - rest), 0.0))
    sigma_m_s2 = calibration.gravity.sigma_m_s2
    yield Share(name="gravity", kind="B", input_sigma=sigma_m_s2, input_unit="m/s^2", sigma=by_gravity)
    yield Share(
        name="not_recorded_apart",
        kind="A",
        degrees_of_freedom=freedom,
        sigma=np.sqrt(np.maximum(np.diag(rest), 0.0)),
    )


def _time_base(calibration: Calibration, clock: ClockFacts | None) -> Iterator[Share]:
    """Yield the share of the clock, where it has one."""
    sigma = np.abs(_by_clock(calibration, clock))
    if clock is not None and np.any(sigma > 0):
        yield Share(name=_TIME_BASE, kind="B", input_sigma=clock.sigma, input_unit="s/s", sigma=sigma)


def _by_clock(calibration: Calibration, clock: ClockFacts | None) -> FloatArray:
    """Return by how much 1 sigma of the clock moves each parameter, shape (n,): it is common to the scales of the gyroscope.

    They hold for the period of the clock, and are stated here in true seconds.
    """
    if clock is None or calibration.gyroscope is None:
        return np.zeros(len(calibration.covariance_names))
    scale = dict(zip((f"gyroscope.scale.{axis}" for axis in AXES), calibration.gyroscope.parameters.scale, strict=True))
    return np.array([scale.get(name, 0.0) * clock.sigma for name in calibration.covariance_names])


def _value(calibration: Calibration, name: str) -> float:
    triad, key, place = name.split(".")
    return float(getattr(_of_triad(calibration, triad)[0], key)[tuple(AXES.index(axis) for axis in place)])


def scale_words(parameters: Parameters) -> Sentence | None:
    """Return both uncertainties of the gyroscope's scale, on the worst axis; None where they are one."""
    scales = [each for group in budget_of(parameters) if group.key == "gyroscope.scale" for each in group.parameters]
    if all(_TIME_BASE not in {entry.share.name for entry in each.entries} for each in scales):
        return None
    nominal = nominal_scale(_of_triad(parameters.calibration, "gyroscope")[1])
    by_clock, true = (
        1e6 * max(sigma / abs(nominal or each.value) for each, sigma in zip(scales, sigmas, strict=True))
        for sigmas in ([each.sigma_by_clock for each in scales], [each.sigma for each in scales])
    )
    return sentence("budget.two_clocks", by_clock=short(by_clock), true=short(true))


def is_mostly_time_base(parameters: Parameters) -> bool:
    """Return whether the clock makes more of the variance of a scale of the gyroscope than all else together."""
    scales = (each for group in budget_of(parameters) if group.key == "gyroscope.scale" for each in group.parameters)
    return any(each.sigma**2 > 2 * each.sigma_by_clock**2 for each in scales)


def not_in_budget(parameters: Parameters) -> tuple[Sentence, ...]:
    """Return what the budget has no share of, and what it takes to have one."""
    calibration, context = parameters.calibration, parameters.context
    if not budget_of(parameters):
        return (sentence("budget.no_covariance"),)
    told = []
    if not calibration.budget:
        told.append(sentence("budget.not_apart"))
    if context.together is None:
        told.append(sentence("budget.no_repeatability"))
    if not parameters.temperature_models:
        told.append(sentence("budget.no_temperature"))
    else:
        told += [*_over_temperature(parameters)]
    return tuple(told)


def _over_temperature(parameters: Parameters) -> Iterator[Sentence]:
    """Yield 1 sigma of bias and scale, as they are stated at the worst temperature of their range."""
    for curves in temperature_curves(parameters):
        low, high = curves.temperature_degc[[0, -1]].tolist()
        for each in (curves.bias, curves.scale):
            sigma = float(np.fmax.reduce(each.sigma, axis=None))
            key = "budget.over_temperature_days" if each.is_of_new_day else "budget.over_temperature"
            # None for a scale that no turn has shown.
            if np.isfinite(sigma):
                told = {"triad": curves.triad, "quantity": each.quantity, "sigma": sigma, "unit": each.unit}
                yield sentence(key, low=low, high=high, **told)


def share_words(share: Share) -> str:
    """Return a share in words; its key where a file has one of somebody else."""
    key = f"shares.{share.name}"
    return sentence(key) if key in sentence else share.name


@dataclass(frozen=True, slots=True, kw_only=True)
class BudgetRow:
    """A share as text."""

    words: str
    kind: str
    freedom: str
    source: str
    """Input quantity with its unit; empty where it is no single one."""
    sensitivity_unit: str
    """Of the sensitivities; empty where there are none."""
    cells: tuple[tuple[str, str], ...]
    """Contribution and sensitivity of each parameter."""


@dataclass(frozen=True, slots=True, kw_only=True)
class BudgetTable:
    """A group as text, for a page."""

    title: str
    unit: str
    places: tuple[str, ...]
    rows: tuple[BudgetRow, ...]
    sums: tuple[tuple[str, ...], ...]
    """Name, then the text of each parameter: combined uncertainties, degrees of freedom, k, U."""
    values: tuple[str, ...]
    """Rounded as U."""

    @property
    def results(self) -> tuple[tuple[str, ...], ...]:
        """Place, value, U, k and effective degrees of freedom of each parameter."""
        *_, freedom, factor, expanded = (texts for _, *texts in self.sums)
        return tuple(zip(self.places, self.values, expanded, factor, freedom, strict=True))


def budget_tables(parameters: Parameters) -> tuple[BudgetTable, ...]:
    """Return the budget as tables for people, in units of the trade."""
    return tuple(_table(group, parameters.calibration) for group in budget_of(parameters, as_rates=True))


def _table(group: Group, calibration: Calibration) -> BudgetTable:
    unit, sizes = _shown(group, calibration)
    rows = []
    for share in group.shares:
        input_unit, input_size = _input_unit(share, calibration)
        # Contributions are milli-g and parts of them: per micro-g a sensitivity would be all zeros.
        per, per_size = ("mg", MILLI_G_M_S2) if input_unit == "µg" else (input_unit, input_size)
        entries = (next(entry for entry in parameter.entries if entry.share is share) for parameter in group.parameters)
        cells = (
            (_fixed(entry.sigma / abs(size), parameter.sigma / abs(size)), short(entry.sensitivity * per_size / abs(size)))
            for entry, parameter, size in zip(entries, group.parameters, sizes, strict=True)
        )
        rows.append(
            BudgetRow(
                words=share_words(share),
                kind=share.kind,
                freedom=freedom_words(share.degrees_of_freedom),
                source=f"{_input_words(share.input_sigma / input_size)} {input_unit}" if share.input_sigma > 0 else "",
                sensitivity_unit=f"{unit} per {per}" if share.input_sigma > 0 else "",
                cells=tuple(cells),
            )
        )
    pairs = [*zip(group.parameters, sizes, strict=True)]
    combined, expanded, both = "budget.combined", "budget.expanded", []
    if any(share.name == _TIME_BASE for share in group.shares):
        by_clock = (short(parameter.sigma_by_clock / abs(size)) for parameter, size in pairs)
        both = [(sentence("budget.combined_by_clock"), *by_clock)]
        combined, expanded = "budget.combined_true_seconds", "budget.expanded_true_seconds"
    sums = (
        *both,
        (sentence(combined), *(short(parameter.sigma / abs(size)) for parameter, size in pairs)),
        (sentence("budget.effective_freedom"), *(freedom_words(parameter.degrees_of_freedom) for parameter, _ in pairs)),
        (sentence("budget.coverage_factor"), *(f"{parameter.coverage_factor:.2f}" for parameter, _ in pairs)),
        (sentence(expanded), *(short(parameter.expanded / abs(size)) for parameter, size in pairs)),
    )
    values = tuple(_value_words(parameter, size, group, calibration) for parameter, size in pairs)
    places = tuple(parameter.place for parameter in group.parameters)
    return BudgetTable(title=group.title, unit=unit, places=places, rows=tuple(rows), sums=sums, values=values)


def _shown(group: Group, calibration: Calibration) -> tuple[str, Sequence[float]]:
    """Return the unit of the trade, and its size for each parameter in that of the file, signs of scales left to them."""
    triad, _, kind = group.key.partition(".")
    rows = [AXES.index(parameter.place[0]) for parameter in group.parameters]
    of_triad, raw_unit = _of_triad(calibration, triad)
    fixed = {"misalignment_rad": ("mrad", 1e-3), "bias_m_s2": ("mg", MILLI_G_M_S2)}
    if kind in fixed:
        return fixed[kind][0], [fixed[kind][1]] * len(rows)
    if not np.isfinite(of_triad.scale).all():
        return raw_unit, [1.0] * len(rows)
    if kind == "scale" and (nominal := nominal_scale(raw_unit)) is not None:
        return "ppm", [nominal * 1e-6] * len(rows)
    # In the raw unit: a millionth of the scale, and of an acceleration, a rate, or a term at 1 g.
    units = {
        "scale": ("ppm", 1e-6),
        "quadratic": ("µg/g²", 1e-6 / STANDARD_GRAVITY_M_S2),
        "bias": ("°/h", DEG_PER_HOUR_RAD_S),
        "g_sensitivity": ("°/h/g", DEG_PER_HOUR_RAD_S / STANDARD_GRAVITY_M_S2),
    }
    return units[kind][0], (of_triad.scale[rows] * units[kind][1]).tolist()


def _value_words(parameter: ParameterBudget, size: float, group: Group, calibration: Calibration) -> str:
    triad, _, kind = group.key.partition(".")
    if kind != "scale":
        return rounded(parameter.value / size, abs(parameter.expanded / size), sign=True)
    _, raw_unit = _of_triad(calibration, triad)
    nominal = nominal_scale(raw_unit)
    if nominal is not None:
        return rounded((parameter.value / nominal - 1) * 1e6, abs(parameter.expanded / size), sign=True)
    # Only the maker knows how far it is off: the scale itself, in its own unit.
    places = max(decimals(abs(parameter.expanded)), 0)
    return f"{parameter.value:.{places}f} {raw_unit} per {_INPUT_UNITS[triad]}"


def _of_triad(calibration: Calibration, triad: str) -> tuple[AccelerometerParameters | GyroscopeParameters, str]:
    """Return the parameters of a triad, and its raw unit."""
    if triad == "gyroscope" and calibration.gyroscope is not None:
        return calibration.gyroscope.parameters, calibration.gyroscope.raw_unit
    return calibration.accelerometer, calibration.accelerometer_raw_unit


def _input_unit(share: Share, calibration: Calibration) -> tuple[str, float]:
    """Return the unit in which the input quantity is shown, that of the residuals where it is one, and its size."""
    if share.input_unit == "m/s^2":
        return acceleration_unit(calibration.quality.residual_max_m_s2)
    # The clock as everywhere: in ppm of true seconds.
    return ("ppm", 1e-6) if share.input_unit == "s/s" else (share.input_unit.replace("^2", "²"), 1.0)


def _input_words(value: float) -> str:
    return short(value) if value < 1 else three_digits(value)


def _fixed(contribution: float, combined: float) -> str:
    """Return a contribution with one decimal more than the sum."""
    places = max(decimals(combined) + 1, 0)
    return f"{contribution:.{places}f}" if math.isfinite(contribution) else ""


def freedom_words(freedom: float) -> str:
    """Return degrees of freedom, those that are as good as infinite as such."""
    return "∞" if not freedom < 1e4 else f"{freedom:.0f}"


def short(value: float) -> str:
    """Return two digits; nothing of what is not known, or nothing."""
    if not math.isfinite(value):
        return ""
    if value == 0:
        return "0"
    return f"{value:.1e}" if decimals(abs(value)) > 6 or abs(value) >= 1e7 else rounded(value, abs(value))
