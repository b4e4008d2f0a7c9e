"""The decimal points of a column of results stand below one another, in a browser, too."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
from html import unescape
from pathlib import Path

import numpy as np
import pytest

from imufield.calibrate.model.observations import Observations
from imufield.calibrate.model.result import Calibration
from imufield.deliver.certificate.certificate import Certificate, Parties
from imufield.deliver.certificate.page import after_points, render_certificate
from imufield.deliver.parameters.context import Context
from imufield.deliver.parameters.file import from_document, to_document

BROWSER = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
# Of each plain number in a column: where its last digit before the point ends.
MEASURE = """<script>
  const ends = [[], []];
  for (const row of document.querySelectorAll(".results tbody tr"))
    ends.forEach((column, k) => {
      const cell = row.cells[2 + k], text = document.createTreeWalker(cell, NodeFilter.SHOW_TEXT).nextNode();
      if (!/^[+-]?\\d+(\\.\\d+)?$/.test(cell.textContent)) return;
      const range = document.createRange(), whole = cell.textContent.split(".")[0].length;
      range.setStart(text, whole - 1);
      range.setEnd(text, whole);
      column.push(range.getBoundingClientRect().right);
    });
  document.title = JSON.stringify(ends);
</script>"""


@pytest.mark.parametrize(
    ("column", "space"),
    [
        (["+1.25", "-12.5", "3"], [0.0, 1.0, 2.5]),
        (["12", "3"], [0.0, 0.0]),
        (["1.5", "1.0003 count per m/s²", "2.3e+08", "", "∞", "12"], [0.0, 0.0, 0.0, 0.0, 0.0, 1.5]),
        ([], []),
    ],
)
def test_the_space_is_that_of_the_missing_digits_and_point(column: list[str], space: list[float]) -> None:
    assert after_points(column) == space


# A browser is no part of the program.
@pytest.mark.skipif(BROWSER is None, reason="install chromium to look at the page as a browser does")
def test_a_browser_draws_the_points_below_one_another(
    tmp_path: Path, calibration: Calibration, observations: Observations, context: Context
) -> None:
    parameters = from_document(to_document(calibration, observations, context))
    certificate = Certificate(parameters=parameters, parties=Parties(), issued="2026-02-01")
    page = tmp_path / "certificate.html"
    page.write_text(render_certificate(certificate, "").replace("</body>", f"{MEASURE}</body>"), encoding="utf-8")
    options = ["--headless", "--no-sandbox", "--disable-gpu", f"--user-data-dir={tmp_path}/browser", "--dump-dom"]
    done = subprocess.run(
        [str(BROWSER), *options, page.as_uri()], capture_output=True, text=True, encoding="utf-8", timeout=250, check=True
    )
    title = re.search("<title>(.*?)</title>", done.stdout)
    assert title is not None
    for ends in json.loads(unescape(title[1])):
        assert len(ends) > 6
        # A pixel is an eighth of a digit; a digit too many or too few is seven.
        assert np.ptp(ends) < 1
