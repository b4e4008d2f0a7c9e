"""Noise figures in the forms that navigation filters read, and as a plot.

Filters take one number for a triad: the largest axis. A random walk that the recording was too short to see is given as its
upper 95 % limit, and a comment says so; zero would make a filter trust a constant bias.
"""

from __future__ import annotations

import importlib
import io
import os
import re
from typing import Literal

import numpy as np

from imufield.calibrate.noise.noise import NoiseResult
from imufield.calibrate.noise.noise_fit import NoiseFigure
from imufield.earth import STANDARD_GRAVITY_M_S2
from imufield.errors import Reason, UsageError
from imufield.sentences import Sentences, shortened

sentence = Sentences(__package__)

NoiseFormat = Literal["kalibr", "openvins", "vins", "ros2"]


def noise_text(result: NoiseResult, form: NoiseFormat, *, topic: str = "/imu0", gravity_m_s2: float | None = None) -> str:
    """Return YAML text for Kalibr, OpenVINS, VINS-Fusion, or the publisher of a ROS 2 ``sensor_msgs/Imu``.

    Raises
    ------
    UsageError
        If the figures are not in SI units, or there is no gyroscope.
    """
    if not result.is_si or not result.triad("gyroscope"):
        raise UsageError(sentence("noise_texts.not_si"), Reason.UNITS)
    source = f"# {result.source}; largest axis of each triad"
    if form == "ros2":
        return _covariances(result)
    if form == "vins":
        names = ("acc_n", "gyr_n", "acc_w", "gyr_w")
        pairs = [(triad, figure) for figure in ("density", "walk") for triad in ("accelerometer", "gyroscope")]
        lines = [f"{name}: {_largest(result, *pair)} SI" for name, pair in zip(names, pairs, strict=True)]
        gravity = STANDARD_GRAVITY_M_S2 if gravity_m_s2 is None else gravity_m_s2
        return "\n".join([source, *lines, f"g_norm: {gravity:.6f}"]) + "\n"
    indent = "  " if form == "openvins" else ""
    figures = (
        ("accelerometer", "noise_density", "density", "m/s^2/sqrt(Hz)"),
        ("accelerometer", "random_walk", "walk", "m/s^3/sqrt(Hz)"),
        ("gyroscope", "noise_density", "density", "rad/s/sqrt(Hz)"),
        ("gyroscope", "random_walk", "walk", "rad/s^2/sqrt(Hz)"),
    )
    lines = [f"{indent}{triad}_{name}: {_largest(result, triad, figure)} {unit}" for triad, name, figure, unit in figures]
    top = [source, "imu0:"] if form == "openvins" else [source]
    return "\n".join([*top, *lines, f"{indent}rostopic: {topic}", f"{indent}update_rate: {result.rate_hz:.6g}"]) + "\n"


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


def _largest(result: NoiseResult, triad: str, figure: str) -> str:
    """Return the number and the start of a comment."""
    values = result.values(triad, figure)
    if np.isfinite(values).any():
        return f"{np.nanmax(values):.6e}  #"
    return f"{np.nanmax(result.upper_limits(triad, figure)):.6e}  # upper 95 % limit, not seen;"


def _shown(figure: NoiseFigure) -> str:
    return f"{figure.value:.3g}" if figure.observed else f"< {figure.high:.2g}"


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
    date = os.environ.get("SOURCE_DATE_EPOCH")
    # Of 11 digits, in the year 5138, is the last that every system makes a date of.
    if date and not re.fullmatch("[0-9]{1,11}", date):
        raise UsageError(sentence("noise_texts.source_date", date=shortened(date)))
    try:
        figure = importlib.import_module("matplotlib.figure").Figure(figsize=(9.0, 5.2), layout="constrained")
    except ImportError as error:
        raise UsageError(sentence("noise_texts.no_matplotlib"), Reason.MISSING_PACKAGE) from error
    for place, triad in enumerate(("accelerometer", "gyroscope")):
        axes = figure.add_subplot(1, 2, place + 1)
        sheets = [(sheet, figures) for sheet, figures in result.data_sheet() if sheet.triad == triad]
        for number, axis in enumerate(result.triad(triad)):
            told = ", ".join(f"{_shown(figures[number])} {sheet.unit}" for sheet, figures in sheets)
            label = f"{axis.name[-1]}  {told}"
            (line,) = axes.loglog(axis.tau_s, axis.deviation, "osD"[number], markersize=4, markerfacecolor="white", label=label)
            axes.fill_between(axis.tau_s, axis.low, axis.high, alpha=0.15, linewidth=0, color=line.get_color())
            if axis.model is not None:
                axes.loglog(axis.tau_s, axis.model.deviation(axis.tau_s), "-", linewidth=1, color=line.get_color())
            axes.set_ylabel(f"Allan deviation, {axis.unit}")
        axes.set_title(triad)
        axes.set_xlabel("averaging time, s")
        axes.grid(visible=True, which="both", alpha=0.3)
        if result.triad(triad):
            # Below, where no curve can be.
            axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.16), fontsize=8, frameon=False)
    figure.suptitle(result.source)
    kinds = figure.canvas.get_supported_filetypes()
    if kind not in kinds:
        raise UsageError(sentence("noise_texts.plot_kind", kind=kind, suffixes=[f".{known}" for known in sorted(kinds)]))
    picture = io.BytesIO()
    figure.savefig(picture, format=kind, dpi=150)
    return picture.getvalue()
