"""Pictures of the report by the places of their lines: read off their own axes they are the numbers that were drawn."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from collections.abc import Iterator

import numpy as np
import pytest

from imufield.deliver.report import plots
from imufield.deliver.report.over_temperature import QuantityCurves, TemperatureCurves
from imufield.drawing.style import INK, ORANGE
from imufield.samples import FloatArray

TIME_S = np.linspace(0.0, 3600.0, 40)
QUANTITIES = {
    "latitude_deg": 60.0,
    "longitude_deg": 60.0,
    "north_velocity_m_s": 1.0,
    "east_velocity_m_s": 1.0,
    "position_nmi": 1.0,
}
"""And what their axes count for 1 of it."""


def parts(svg: str, tag: str) -> Iterator[ET.Element]:
    return ET.fromstring(svg).iter(f"{{http://www.w3.org/2000/svg}}{tag}")  # noqa: S314 - our own


def points(text: str) -> FloatArray:
    return np.array([[float(number) for number in re.split("[ ,]", pair)] for pair in re.findall(r"[-\d.]+[ ,][-\d.]+", text)])


def upward_ticks(svg: str) -> list[tuple[float, float, float]]:
    """Return place across, height and number of each number of a vertical axis."""
    found = []
    for text in parts(svg, "text"):
        place = re.match(r"translate\(([-\d.]+) ([-\d.]+)\)$", text.attrib["transform"])
        if place is not None and text.attrib["text-anchor"] == "end":
            found.append((float(place[1]), float(place[2]), float((text.text or "").replace("\u2212", "-"))))
    return found


def read_off(svg: str, curve: FloatArray) -> FloatArray:
    """Return the numbers of a curve, by the two numbers of the axis at its left that are furthest apart."""
    axis = [tick for tick in upward_ticks(svg) if 0 < curve[0, 0] - tick[0] < 50]
    near = [tick for tick in axis if curve[:, 1].min() - 200 < tick[1] < curve[:, 1].max() + 200]
    rows = sorted(near, key=lambda tick: abs(tick[1] - curve[:, 1].mean()))[:2]
    (_, first, low), (_, second, high) = rows
    return np.asarray(low + (curve[:, 1] - first) * (high - low) / (second - first))


def drift(seed: int) -> dict[str, list[float]]:
    rng = np.random.default_rng(seed)
    return {"time_s": TIME_S.tolist(), **{name: np.cumsum(rng.normal(0, 0.01, 40)).tolist() for name in QUANTITIES}}


@pytest.mark.parametrize("has_forecast", [True, False])
def test_navigation_errors_and_their_band(has_forecast: bool) -> None:
    drifts = {"before": drift(1), "after": drift(2)}
    document: dict[str, object] = {"drift": drifts}
    if has_forecast:
        ends = {name: (TIME_S / 3600).tolist() for name in QUANTITIES}
        low = {name: [-value for value in values] for name, values in ends.items()}
        document["forecast"] = {"time_s": TIME_S.tolist(), "low": low, "high": ends, "position_95_nmi": ends["position_nmi"]}
    svg = plots.navigation(document)
    curves = [(part, points(part.attrib["d"])) for part in parts(svg, "path")]
    for name, color in (("after", INK), ("before", ORANGE)):
        drawn = [curve for part, curve in curves if part.attrib["stroke"] == color and len(curve) == len(TIME_S)]
        for (quantity, size), curve in zip(QUANTITIES.items(), drawn, strict=True):
            wanted = np.array(drifts[name][quantity]) * size
            assert read_off(svg, curve) == pytest.approx(wanted, abs=0.01 * np.ptp(wanted) + 1e-4)
    bands = [points(part.attrib["points"]) for part in parts(svg, "polygon")]
    assert len(bands) == (len(QUANTITIES) if has_forecast else 0)
    for (quantity, size), band in zip(QUANTITIES.items(), bands, strict=False):
        edges, lowest = read_off(svg, band), 0.0 if quantity == "position_nmi" else -size
        assert (edges.min(), edges.max()) == pytest.approx((lowest, size), abs=0.02 * size)


def test_bias_and_scale_over_temperature() -> None:
    degc = np.linspace(-10.0, 50.0, 81)

    def curves_of(quantity: str, slopes: list[float]) -> QuantityCurves:
        change = (degc[:, None] - 20.0) * np.array(slopes)
        sigma = np.full_like(change, 0.5 * abs(slopes[0]))
        sessions = change[[0, 40, 80]]
        return QuantityCurves(
            quantity=quantity, unit="mg", change=change, sigma=sigma, factor=2.0, is_of_new_day=True, sessions=sessions
        )

    bias, scale = curves_of("bias", [0.1, -0.2, 0.05]), curves_of("scale", [-3.0, 1.0, 2.0])
    svg = plots.over_temperature(
        TemperatureCurves(
            triad="accelerometer",
            temperature_degc=degc,
            sessions_degc=degc[[0, 40, 80]],
            reference_degc=20.0,
            bias=bias,
            scale=scale,
        )
    )
    drawn = [curve for part in parts(svg, "path") if len(curve := points(part.attrib["d"])) == len(degc)]
    for curve, wanted in zip(drawn, [*bias.change.T, *scale.change.T], strict=True):
        assert read_off(svg, curve) == pytest.approx(wanted, abs=0.01 * np.ptp(wanted))
    assert len(list(parts(svg, "circle"))) == 2 * 3
    for band, quantity, axis in zip(parts(svg, "polygon"), [bias] * 3 + [scale] * 3, [0, 1, 2] * 2, strict=True):
        edges = read_off(svg, points(band.attrib["points"]))
        half = 2.0 * quantity.sigma[:, axis]
        wanted = np.concatenate([quantity.change[:, axis] - half, (quantity.change[:, axis] + half)[::-1]])
        assert edges == pytest.approx(wanted, abs=0.01 * np.ptp(wanted))
