"""Noise figures in the forms that navigation filters read, and as a plot.

Filters take one number for a triad: the largest axis. A random walk that the recording was too short to see is given as its
upper 95 % limit, and a comment says so; zero would make a filter trust a constant bias.

VINS-Fusion [1]_ adds ``(dt n)^2 / 2`` to the variance of an integral in each step ``dt``, and ``(dt w)^2`` to that of a bias:
for a density N and a random walk K these are ``N^2 dt`` and ``K^2 dt`` where ``n = N sqrt(2 / dt)`` and ``w = K / sqrt(dt)``.

References
----------
.. [1] VINS-Fusion, vins_estimator/src/factor/integration_base.h, ``midPointIntegration``.
"""

from __future__ import annotations

import io
import math
import re
from typing import TYPE_CHECKING, Literal

import numpy as np

from imufield.calibrate.noise.noise import NoiseResult
from imufield.calibrate.noise.noise_fit import NoiseFigure
from imufield.drawing.style import figure, legend_beside, plain_ticks, plot_style, title
from imufield.earth import STANDARD_GRAVITY_M_S2
from imufield.errors import CalibrationError, Reason, UsageError
from imufield.files import source_date
from imufield.samples import TRIADS
from imufield.sentences import Sentences

if TYPE_CHECKING:
    from matplotlib.axes import Axes

sentence = Sentences(__package__)

NoiseFormat = Literal["kalibr", "openvins", "vins", "ros2"]


def noise_text(result: NoiseResult, form: NoiseFormat) -> str:
    """Return YAML text for Kalibr, OpenVINS, VINS-Fusion, or the publisher of a ROS 2 ``sensor_msgs/Imu``.

    Raises
    ------
    UsageError
        If the figures are not in SI units, or there is no gyroscope.
    CalibrationError
        If no axis of a triad ever changed.
    """
    if not result.is_si or not result.triad("gyroscope"):
        raise UsageError(sentence("noise_texts.not_si"), Reason.UNITS)
    for triad in TRIADS:
        if not np.isfinite(result.upper_limits(triad, "density")).any():
            raise CalibrationError(sentence("noise_texts.dead", triad=triad), Reason.TOO_FEW)
    source = f"# {result.source}; largest axis of each triad"
    if form == "ros2":
        return _covariances(result)
    if form == "vins":
        density, walk = math.sqrt(2 * result.rate_hz), math.sqrt(result.rate_hz)
        lines = [
            f"acc_n: {_largest(result, 'accelerometer', 'density', density)} m/s^2",
            f"gyr_n: {_largest(result, 'gyroscope', 'density', density)} rad/s",
            f"acc_w: {_largest(result, 'accelerometer', 'walk', walk)} m/s^3",
            f"gyr_w: {_largest(result, 'gyroscope', 'walk', walk)} rad/s^2",
        ]
        source += f", for {result.rate_hz:.6g} Hz"
        return "\n".join([source, *lines, f"g_norm: {STANDARD_GRAVITY_M_S2:.6f}"]) + "\n"
    indent = "  " if form == "openvins" else ""
    figures = (
        ("accelerometer", "noise_density", "density", "m/s^2/sqrt(Hz)"),
        ("accelerometer", "random_walk", "walk", "m/s^3/sqrt(Hz)"),
        ("gyroscope", "noise_density", "density", "rad/s/sqrt(Hz)"),
        ("gyroscope", "random_walk", "walk", "rad/s^2/sqrt(Hz)"),
    )
    lines = [f"{indent}{triad}_{name}: {_largest(result, triad, figure)} {unit}" for triad, name, figure, unit in figures]
    # OpenVINS reads with cv::FileStorage, which refuses a file that does not begin so.
    top = ["%YAML:1.0", source, "imu0:"] if form == "openvins" else [source]
    return "\n".join([*top, *lines, f"{indent}rostopic: /imu0", f"{indent}update_rate: {result.rate_hz:.6g}"]) + "\n"


def _covariances(result: NoiseResult) -> str:
    """Return the covariances that belong into every message at the recorded rate, axis by axis.

    A filter takes messages for independent, so what counts is the white noise it adds up, N^2 times the rate: where the
    instrument filters its output, single samples scatter less than that.
    """
    lines = [f"# {result.source}; of sensor_msgs/Imu at this rate, row by row"]
    for triad, name, unit in (
        ("accelerometer", "linear_acceleration_covariance", "(m/s^2)^2"),
        ("gyroscope", "angular_velocity_covariance", "(rad/s)^2"),
    ):
        known, most = result.values(triad, "density"), result.upper_limits(triad, "density")
        diagonal = np.diag(np.where(np.isfinite(known), known, most) ** 2 * result.rate_hz)
        lines.append(f"{name}: [{', '.join(f'{value:.6e}' if value else '0.0' for value in diagonal.ravel())}]  # {unit}")
    return "\n".join(lines) + "\n"


def _largest(result: NoiseResult, triad: str, figure: str, factor: float = 1.0) -> str:
    """Return the number and the start of a comment."""
    values = result.values(triad, figure)
    if np.isfinite(values).any():
        return f"{factor * np.nanmax(values):.6e}  #"
    return f"{factor * np.nanmax(result.upper_limits(triad, figure)):.6e}  # upper 95 % limit, not seen;"


def _shown(figure: NoiseFigure) -> str:
    if figure.observed:
        return f"{figure.value:.3g}"
    return f"< {figure.high:.2g}" if np.isfinite(figure.high) else "not known"


def draw_plot(result: NoiseResult, kind: str) -> bytes:
    """Return a picture of the Allan deviation of all axes, with 95 % limits and the model.

    Parameters
    ----------
    result : NoiseResult
    kind : str
        Format by the suffix of its file: "png", "svg", "pdf" and what else matplotlib writes.

    Raises
    ------
    UsageError
        If matplotlib is not installed, or does not write such files, or takes their date from an environment variable that is
        none.
    """
    source_date()
    triads = [triad for triad in TRIADS if result.triad(triad)]
    with plot_style():
        drawn = figure(2.6 * len(triads) + 0.5)
        panels = drawn.subplots(len(triads), 1, sharex=True, squeeze=False)[:, 0]
        for axes, triad in zip(panels, triads, strict=True):
            _draw_triad(axes, result, triad)
        panels[-1].set_xlabel("averaging time, s")
        title(drawn, result.source)
        kinds = drawn.canvas.get_supported_filetypes()
        if kind not in kinds:
            raise UsageError(sentence("noise_texts.plot_kind", kind=kind, suffixes=[f".{known}" for known in sorted(kinds)]))
        picture = io.BytesIO()
        drawn.savefig(picture, format=kind)
    return picture.getvalue()


def _draw_triad(axes: Axes, result: NoiseResult, triad: str) -> None:
    sheets = [(sheet, figures) for sheet, figures in result.data_sheet() if sheet.triad == triad]
    # A bias instability, the last of them, is an Allan deviation.
    unit, factor = (sheets[-1][0].unit, sheets[-1][0].factor) if sheets else (result.triad(triad)[0].unit, 1.0)
    for number, axis in enumerate(result.triad(triad)):
        # An axis that never changed has no place on logarithmic scales.
        if not axis.deviation.any():
            continue
        label = "\n".join([axis.name[-1], *(f"{_shown(figures[number])} {_in_print(sheet.unit)}" for sheet, figures in sheets)])
        (line,) = axes.loglog(
            axis.tau_s, factor * axis.deviation, "osD"[number], markersize=4, markerfacecolor="white", label=label
        )
        axes.fill_between(axis.tau_s, factor * axis.low, factor * axis.high, alpha=0.15, linewidth=0, color=line.get_color())
        if axis.model is not None:
            axes.loglog(axis.tau_s, factor * axis.model.deviation(axis.tau_s), ("-", "--", ":")[number], color=line.get_color())
    axes.set_ylabel(f"{triad}\nAllan deviation, {_in_print(unit)}")
    plain_ticks(axes.xaxis, axes.yaxis)
    if axes.lines:
        legend_beside(axes)


def _in_print(unit: str) -> str:
    """Return a unit as it is printed: "ug/sqrt(Hz)" as "µg/√Hz"."""
    return re.sub(r"sqrt\((\w+)\)", r"√\1", unit).replace("^2", "²").replace("ug", "µg").replace("deg", "°")
