"""The positions of a session for the page: a picture of how the instrument stood, and what its residual says of each."""

from __future__ import annotations

import math
import re

import numpy as np

from imufield.calibrate.model.rotation import unit_vectors
from imufield.dataclass import dataclass
from imufield.deliver.parameters.file import Parameters
from imufield.deliver.parameters.printed_numbers import acceleration_unit, decimals
from imufield.drawing.box import turn_shortest, visible_faces
from imufield.drawing.style import INK
from imufield.samples import FloatArray

_SIZE = 100.0  # Of a picture, in units of its own.
_SCALE = _SIZE / 2 / 1.36  # From the box to those: half its diagonal is 1.30.
_MOST_DECIMALS = 3  # Residuals of ideal outputs are nothing but rounding.
_HEADINGS = tuple(np.radians(45.0) * k for k in range(8))
_UPWARDS = 0.5  # Cosine to the vertical of the sides that are shaded: one on a face, two on an edge, three on a corner.
# As on the pages (``texts.js``): not in the quotes of a shell, nor of an option, which is found first.
_SIDES = re.compile(r"--[\w-]+ \S+|(?<![\w+=-])(?:[+-][xyz])+(?![\w'+-])")


@dataclass(frozen=True, slots=True, kw_only=True)
class PositionCard:
    """One position as text; what is not known is empty."""

    name: str
    svg: str
    residual: str
    sigma: str
    """By the scatter within and between positions and the leverage."""
    left_out: str
    share: int
    """Of the largest residual, percent."""
    word: str
    """"suspect", "not used", or nothing."""


def position_cards(parameters: Parameters) -> tuple[list[PositionCard], str]:
    """Return the positions in the order they were taken, and the unit of their numbers."""
    tables = parameters.document["position"]
    calibration = parameters.calibration
    results, quality = calibration.positions, calibration.quality
    raw, sigma_raw = (np.array([table[key] for table in tables]).reshape(-1, 3) for key in ("mean_raw", "sigma_raw"))
    up = directions(parameters, raw)
    within = np.nan_to_num(np.linalg.norm(up * sigma_raw / calibration.accelerometer.scale, axis=1))
    sigma = np.hypot(within, quality.between_position_sigma_m_s2) * np.sqrt(np.maximum(1 - results.leverage, 0.0))
    # What the others cannot predict has a residual of nothing but rounding.
    sigma[np.isnan(results.leave_one_out_m_s2)] = np.nan
    shown = np.array([results.residual_m_s2, sigma, results.leave_one_out_m_s2])
    unit, size = acceleration_unit(float(np.nanmax(np.abs(shown), initial=0.0)))
    largest = float(np.nanmax(np.abs(results.residual_m_s2), initial=1e-12))
    places = min(max(decimals(largest / size), 0), _MOST_DECIMALS)
    lengths = np.nan_to_num(np.abs(results.residual_m_s2) / largest)
    columns = (_numbers(values / size, places, sign=sign) for values, sign in zip(shown, "+-+", strict=True))
    words = ["not used" if not table["used"] else "suspect" * (table["name"] in quality.suspects) for table in tables]
    cards = [
        PositionCard(
            name=short_name(table["name"]),
            svg=draw_position(up[k]),
            residual=residual,
            sigma=spread,
            left_out=left_out,
            share=round(100 * lengths[k]),
            word=words[k],
        )
        for k, (table, residual, spread, left_out) in enumerate(zip(tables, *columns, strict=True))
    ]
    return cards, unit


def directions(parameters: Parameters, raw: FloatArray) -> FloatArray:
    """Return the measured directions of up in the body frame from mean outputs, both of shape (m, 3)."""
    return unit_vectors(parameters.apply_accelerometer(raw))


def short_name(name: str) -> str:
    """Return "7 +x" for "free 7: near +x", which stands for a position nobody planned."""
    return with_minus(name.removeprefix("free ").replace(": near", ""))


def with_minus(words: str) -> str:
    """Return words whose sides have a minus, which ends no line as a hyphen does; what is to be typed keeps its own."""
    return _SIDES.sub(lambda found: found[0] if found[0].startswith("--") else found[0].replace("-", "\u2212"), words)


def draw_position(up: FloatArray) -> str:
    """Return the box with ``up`` (body, shape (3,)) at the top as an ``<svg>`` element; the sides that look up are shaded."""
    turned = turn_shortest(np.eye(3), up)
    # Of a position only "up" is known: the heading is the one that shows most of the sides that look up.
    seen = [[*visible_faces(_heading(angle) @ turned)] for angle in _HEADINGS]
    faces = max(seen, key=lambda faces: (sum(face.up > _UPWARDS for face in faces), len(faces)))
    sides, names = [], []
    for face in faces:
        x, y = (_SIZE / 2 + _SCALE * face.corners[:, [0, 2]] * (1, -1)).T
        points = " ".join(f"{across:.1f},{down:.1f}" for across, down in zip(x, y, strict=True))
        fill = "#cfe0f2" if face.up > _UPWARDS else "#fff"
        sides.append(f'<polygon points="{points}" fill="{fill}" stroke="{INK}" stroke-width="1.5"/>')
        names.append(f'<text x="{x.mean():.1f}" y="{y.mean() + 6:.1f}">{face.name}</text>')
    attributes = f'viewBox="0 0 {_SIZE:g} {_SIZE:g}" font-size="17" text-anchor="middle" stroke-linejoin="round"'
    return f'<svg {attributes} aria-hidden="true">{"".join(sides + names)}</svg>'


def _heading(angle: float) -> FloatArray:
    return np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])


def _numbers(values: FloatArray, places: int, *, sign: str) -> list[str]:
    """Return numbers of one width, in line at the decimal point, empty where unknown; the minus is one as wide as the plus."""
    texts = [f"{value:{sign}z.{places}f}".replace("-", "\u2212") if math.isfinite(value) else "" for value in values.tolist()]
    width = max(map(len, texts), default=0)
    return [text and text.rjust(width, "\u2007") for text in texts]
