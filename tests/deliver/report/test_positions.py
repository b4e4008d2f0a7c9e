"""The positions on the page: how the instrument stood, its residual, and which one is suspect."""

from __future__ import annotations

import re
from dataclasses import replace
from xml.etree import ElementTree as ET

import numpy as np
import pytest

from imufield.calibrate.model.observations import Observations
from imufield.calibrate.model.result import Calibration
from imufield.deliver.parameters.context import Context
from imufield.deliver.parameters.file import Parameters, from_document, to_document
from imufield.deliver.report.data import ReportData
from imufield.deliver.report.page import render_report
from imufield.deliver.report.positions import draw_position, position_cards, short_name, with_minus
from imufield.guide.positions import cube_directions

DIRECTIONS = cube_directions()
MICRO_G_M_S2 = 9.80665e-6


@pytest.fixture
def suspected(calibration: Calibration, observations: Observations, context: Context) -> Parameters:
    """Return parameters with a suspect, a position that was left out, and a residual of next to nothing."""
    used, residual = np.ones(len(observations), dtype=np.bool_), calibration.positions.residual_m_s2.copy()
    used[4], residual[4], residual[5] = False, np.nan, -1e-12
    positions = replace(calibration.positions, used=used, residual_m_s2=residual)
    quality = replace(calibration.quality, suspects=(observations.name[17],))
    return from_document(to_document(replace(calibration, positions=positions, quality=quality), observations, context))


@pytest.mark.parametrize("name", DIRECTIONS)
def test_a_picture_names_the_sides_that_look_up_and_shades_them(name: str) -> None:
    drawn = ET.fromstring(draw_position(DIRECTIONS[name]))  # noqa: S314 - our own text
    shades = [side.get("fill") for side in drawn.iter("polygon")]
    names = [text.text or "" for text in drawn.iter("text")]
    upwards = {side for side, shade in zip(names, shades, strict=True) if shade != "#fff"}
    every = {name[k : k + 2] for k in range(0, len(name), 2)}
    # Of a corner the onlooker sees two of its three sides.
    assert upwards <= every
    assert len(upwards) >= min(len(every), 2)
    sides = [side.get("points", "").replace(",", " ").split() for side in drawn.iter("polygon")]
    places = np.array(sides, dtype=np.float64)
    assert places.min() > 0
    assert places.max() < 100


def test_every_position_has_its_picture_and_its_numbers(suspected: Parameters) -> None:
    text = render_report(ReportData(parameters=suspected))
    rows = re.findall(r"<li.*?</li>", text[text.index("<ol") : text.index("</ol>")], re.DOTALL)
    tables = suspected.document["position"]
    assert len(rows) == len(tables)
    for row, table in zip(rows, tables, strict=True):
        assert len(list(ET.fromstring(row).iter("svg"))) == 1  # noqa: S314 - our own text
        assert f"<b>{table['name']}</b>" in row
    marked = [("suspect" in row, "not used" in row) for row in rows]
    assert marked == [(k == 17, k == 4) for k in range(len(tables))]
    assert 'class="suspect"' in rows[17]


def test_numbers_are_in_line_and_none_is_minus_zero(suspected: Parameters) -> None:
    cards, unit = position_cards(suspected)
    assert unit == "µg"
    for column in ("residual", "sigma", "left_out"):
        assert len({len(text) for card in cards if (text := getattr(card, column))}) == 1
    assert cards[5].residual.strip("\u2007") == "+0"
    assert (cards[4].residual, cards[4].share) == ("", 0)
    residual = suspected.calibration.positions.residual_m_s2
    for k in (0, 17):
        assert float(cards[k].residual.replace("\u2212", "-")) == pytest.approx(residual[k] / MICRO_G_M_S2, abs=0.51)
    assert max(card.share for card in cards) == cards[17].share == 100


def test_sigma_is_that_of_the_residual(suspected: Parameters) -> None:
    """Half of the variance of a position is in its residual where the leverage is a half; 0.19 mm/s^2 between positions."""
    cards, _ = position_cards(suspected)
    sigma_m_s2 = np.sqrt(0.5 * (1.9e-4**2 + 2e-8))
    assert float(cards[0].sigma) == pytest.approx(sigma_m_s2 / MICRO_G_M_S2, abs=3)


@pytest.mark.parametrize(
    ("words", "shown"),
    [
        ("near -y", "near \u2212y"), ("+x-y+z (2)", "+x\u2212y+z (2)"), ("-z-y up, on -y", "\u2212z\u2212y up, on \u2212y"),
        ("x-45", "x-45"), ("'--without=free 2: near -y+z'", "'--without=free 2: near -y+z'"), ("--without=-y", "--without=-y"),
        ("left-side", "left-side"), ("--zero", "--zero"), ("unit-x", "unit-x"), ("--axes -x,+y", "--axes -x,+y"),
    ],
)  # fmt: skip
def test_a_side_has_a_minus_that_ends_no_line(words: str, shown: str) -> None:
    assert with_minus(words) == shown


def test_a_free_position_is_named_by_its_number_and_side() -> None:
    assert short_name("free 7: near -y+z") == "7 \u2212y+z"
