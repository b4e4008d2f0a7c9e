"""All studies, quick; and what their texts claim, where it can be checked by a second route."""

from __future__ import annotations

import csv
import re
from collections.abc import Callable
from dataclasses import replace
from functools import cache, partial
from pathlib import Path

import numpy as np
import pytest

from imufield.calibrate.solvers.beetles import BasSettings, BsasSettings
from imufield.errors import Reason, UsageError
from imufield.study import bsas_bound, bsas_runs, bsas_stages, ide_comparison, instruments
from imufield.study.context import StudyContext
from imufield.study.instruments import BSAS_TRUTH, bsas_preset, static_rates_deg_s
from imufield.study.report import Comparison, CsvTable, Findings, StudyReport, as_markdown, as_text, make_report, save
from imufield.study.run import STUDIES, find_studies, run_study, write_document
from tests.refused import refused

# The papers' tables and figures (docs/study.md), and the papers' input tables.
ASKED_FOR = {
    *(f"bsas-table{n}" for n in range(1, 7)),
    *(f"bsas-fig{n}" for n in (3, 4, 5, 6, 7, 9, 10, 11)),
    *(f"ide-table{n}" for n in range(1, 6)),
    *(f"ide-fig{n}" for n in (2, 3, 4, 5, 6, 8, 10)),
    "ide-complexity",
    "answers-pairs",
}
QUICK = StudyContext(seed=3, quick=True, workers=1)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("studies")


@pytest.fixture(scope="module")
def report_of(folder: Path) -> Callable[[str], StudyReport]:
    # One at a time: each test waits for its own study, and studies of the same runs share them.
    for package in ("pymoo", "pyins", "matplotlib"):
        pytest.importorskip(package, reason="needs the study and nav extras")

    @cache
    def report(name: str) -> StudyReport:
        # A fifth of the iterations fills tables and figures as well; what a number is held against below has all of them.
        with pytest.MonkeyPatch.context() as shorter:
            for swarming in (bsas_runs, bsas_stages):
                shorter.setattr(swarming, "BsasSettings", partial(BsasSettings, k_max=60))
                shorter.setattr(swarming, "BasSettings", partial(BasSettings, k_max=60))
            shorter.setattr(ide_comparison, "_QUICK_GENERATIONS", 5)
            return next(run_study(name, QUICK, folder=folder))

    return report


def test_every_table_and_figure_is_there() -> None:
    assert set(STUDIES) >= ASKED_FOR


@pytest.mark.parametrize("name", list(STUDIES))
def test_a_report_compares_and_explains(report_of: Callable[[str], StudyReport], name: str) -> None:
    report = report_of(name)
    assert report.comparisons
    assert all(c.what and c.paper and c.ours for c in report.comparisons)
    assert "nan" not in " ".join(c.ours for c in report.comparisons).lower()
    assert report.name == name
    assert report.title
    assert report.setting
    assert report.differences or name == "bsas-table4"


@pytest.mark.parametrize("name", list(STUDIES))
def test_a_report_leaves_csv_and_plot(report_of: Callable[[str], StudyReport], folder: Path, name: str) -> None:
    report = report_of(name)
    with (folder / f"{name}.csv").open(newline="") as file:
        rows = list(csv.reader(file))
    assert len(rows) == 1 + len(report.comparisons)
    tables = list(folder.glob(f"{name}-*.csv"))
    assert len(tables) == len(report.tables)
    assert all(len(row) == len(table.columns) for table in report.tables for row in table.rows)
    if report.draw is not None:
        assert (folder / f"{name}.png").read_bytes()[:8] == b"\x89PNG\r\n\x1a\n"


def test_the_answers_have_a_document_of_their_own(tmp_path: Path) -> None:
    write_document([EXAMPLE], tmp_path / "answers.md", QUICK, "answers")
    assert (tmp_path / "answers.md").read_text().startswith("# Answers that stay right\n")


def test_the_document_has_every_report_with_seed_and_version(report_of: Callable[[str], StudyReport], tmp_path: Path) -> None:
    path = tmp_path / "study.md"
    write_document([report_of("bsas-table1"), report_of("ide-table2")], path, QUICK)
    text = path.read_text()
    assert all(f"## {name}: " in text for name in ("bsas-table1", "ide-table2"))
    assert "seed 3" in text
    assert "quick run" in text


def test_one_seed_gives_one_report_whoever_works(report_of: Callable[[str], StudyReport]) -> None:
    together = next(run_study("bsas-table5", StudyContext(seed=3, quick=True, workers=2)))
    assert together.comparisons == report_of("bsas-table5").comparisons


def test_the_whitened_swarm_ends_at_the_exact_minimum_where_the_staged_one_stalls(
    report_of: Callable[[str], StudyReport],
) -> None:
    within = {c.what: c.ours for c in report_of("bsas-whitened").comparisons}
    assert within["runs within 1.1 times"] == "2 of 2"
    assert within["runs that converged"] == "2 of 2"
    staged = {c.what: c.ours for c in report_of("bsas-staged").comparisons}
    assert staged["runs that claim to have converged"] == "0 of 2"


def test_least_squares_is_efficient_in_one_frame_with_the_truth() -> None:
    rng = np.random.default_rng(0)
    runs = [bsas_bound.run_bound(number, rng) for number in range(75)]
    assert all(run.converged for run in runs)
    ratio = np.sqrt(np.mean([run.in_true_frame**2 for run in runs], axis=0)) / bsas_bound.bound()
    # 75 runs tell a ratio to 8 %, and the largest of twelve is three sigma off.
    assert ratio == pytest.approx(np.ones(12), abs=0.25)


def test_a_quick_run_says_how_many_runs_it_had(report_of: Callable[[str], StudyReport]) -> None:
    for name in ("bsas-fig5", "bsas-fig6", "bsas-table3", "bsas-whitened", "ide-fig6"):
        report = report_of(name)
        # The papers' own numbers of runs stand in their column.
        rows = (f"{c.what} {c.ours}" for c in report.comparisons)
        ours = " ".join([report.title, report.setting, *rows, *report.differences])
        assert not re.search(r"\b(?:50|200) runs\b", ours), name


def test_a_note_stands_only_where_its_condition_holds() -> None:
    final = dict.fromkeys("abcd", (1.0, 2.0))
    values = {"final": final, "runs": 3, "worst": "misalignments", "ratio": 5.0, "others": np.array([1.0, 1.2])}
    notes = [make_report("bsas-fig4", Findings(values={**values, "as_paper": holds})).differences for holds in (True, False)]
    assert len(notes[0]) == len(notes[1]) + 1
    assert "5 times the cost" in notes[0][0]


def test_the_paper_s_own_parameters_cost_more_than_it_prints() -> None:
    # Eq. 13 by hand: |a| of its mean parameters (Table 3), for the outputs of those of Table 1 without noise.
    assert bsas_runs._printed_cost("mean") == pytest.approx(1.04e-5, rel=0.01)
    assert bsas_runs._printed_cost("bas_scale") == pytest.approx(0.6, rel=0.05)


def test_the_effort_of_evolution_is_counted(report_of: Callable[[str], StudyReport]) -> None:
    found = {c.what: c.ours for c in report_of("ide-complexity").comparisons}
    assert found["evaluations are NP (G + 1)"] == "in 24 of 24"


def test_ide_ends_at_the_global_optimum(report_of: Callable[[str], StudyReport]) -> None:
    found = {c.what: c.ours for c in report_of("ide-table2").comparisons}
    assert found["ide within 1e-6 of the global optimum"] == "2 of 2"


def test_equation_26_is_said_to_be_rank_3(report_of: Callable[[str], StudyReport]) -> None:
    found = {c.what: c.ours for c in report_of("ide-table4").comparisons}
    assert found["rank of the Jacobian: static, eq. 26, vector"] == "9, 3, 9"


def test_estimates_keep_their_own_presets() -> None:
    # The vector of a run is truth plus what the stage found, not plus its preset's error.
    run = bsas_runs.run_categories(False, np.random.default_rng(1))
    assert np.abs(run.vectors[0, :3] - BSAS_TRUTH[:3]).max() < 1e-5
    assert np.abs(run.vectors[0, 3:6] - BSAS_TRUTH[3:6]).max() < 1e-6


def test_presets_stay_within_what_is_said() -> None:
    rng = np.random.default_rng(0)
    off = np.array([bsas_preset(rng) - BSAS_TRUTH for _ in range(300)])
    limit = np.abs(np.concatenate([5e-4 * BSAS_TRUTH[:3], [9.80665e-3] * 3, [1e-4] * 6, BSAS_TRUTH[12:]]))
    assert np.all(np.abs(off) <= limit)
    assert np.all(np.abs(off).max(axis=0) > 0.9 * limit)


def test_the_earth_turns_once_a_sidereal_day_at_every_position() -> None:
    rates = static_rates_deg_s(30.0)
    assert np.linalg.norm(rates, axis=1) == pytest.approx(np.full(24, 360 / 86164.1), rel=1e-5)
    # Up is at sin(latitude) of the rate.
    assert np.einsum("ij,ij->i", rates, instruments.bsas_directions()) == pytest.approx(np.full(24, 180 / 86164.1), rel=1e-5)


def test_names_of_studies() -> None:
    assert find_studies("ide-fig5") == ("ide-fig5",)
    assert find_studies("bsas") == tuple(name for name in STUDIES if name.startswith("bsas"))
    answers = find_studies("answers")
    assert set(answers) == set(STUDIES) - set(find_studies("all")) == {name for name in STUDIES if name.startswith("answers-")}
    with refused(UsageError, Reason.USAGE, "all, bsas, ide, answers", "bsas-table1, bsas-table2", key="run.no_study") as caught:
        find_studies("table9")
    assert caught.value.values["study"] == "table9"


def test_words_name_figures_of_what_was_found() -> None:
    five = np.array([1.0, 2.0, 3.0, 4.0, 10.0])
    errors = {"old": [five, five], "new": [five / 2, five], "turntable": [five, five]}
    counts = {"falls": 1, "below": 1, "mostly": True, "runs": 1, "shared": 6}
    report = make_report("bsas-table5", Findings(values={**errors, **counts}))
    # Quantiles by hand: 5 % of four intervals is a fifth of the first, 95 % four fifths of the last.
    expected = Comparison("mean error, old parameters (ug)", "12.025", "3.00 (5 to 95 %: 1.20 to 8.80)")
    assert report.comparisons[0] == expected
    assert report.comparisons[6].ours == "1 of 1"
    spread = {f"K_{n}": np.array([3.0, -4.0]) for n in "xyz"}
    ours = {"ours": np.full(3, np.sqrt(12.5)), "smaller": False}
    scale = make_report("bsas-fig7", Findings(values={"errors": spread, "runs": 2, **ours}))
    assert [c.ours for c in scale.comparisons] == ["RMSE 3.54"] * 3
    assert [c.paper for c in scale.comparisons] == [f"RMSE {x:.3g}" for x in (3.535e-5, 4.945e-5, 2.523e-5)]


EXAMPLE = StudyReport(
    name="x-1",
    title="an example",
    setting="A setting.",
    comparisons=(Comparison("cost", "1|2", "3"),),
    differences=("It differs.",),
    tables=(CsvTable("A b", ("n",), ((1,),)),),
)


def test_text_lines_up() -> None:
    assert as_text(EXAMPLE) == (
        "x-1: an example\n---------------\nA setting.\n\n      paper  ours\ncost  1|2    3\n\n* It differs.\n"
    )


def test_markdown_escapes_bars() -> None:
    assert "| cost | 1\\|2 | 3 |" in as_markdown(EXAMPLE)


def test_files_are_named_after_study_and_table(tmp_path: Path) -> None:
    written = save(EXAMPLE, tmp_path / "new")
    assert [path.name for path in written] == ["x-1.csv", "x-1-a-b.csv"]
    assert written[1].read_text() == "n\n1\n"


def test_text_that_is_wide_is_folded_to_80_columns() -> None:
    long = "RMSE 3.53e-05, SD 4.72e-09; fresh noise 1.00e-07; BAS 2.9442"
    text = as_text(
        replace(EXAMPLE, comparisons=(Comparison("K_ax", long, long),), setting=f"{long} " * 3, differences=(long * 2,))
    )
    assert f"K_ax\n  paper  {long}\n  ours   {long}\n" in text
    assert max(map(len, text.splitlines())) <= 80
