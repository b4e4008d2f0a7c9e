"""How sessions are counted: by the mean of each column, or another statistic, row by row."""

from __future__ import annotations

from functools import partial

import numpy as np

from imufield.calibrate.model.uncertainty import rms
from imufield.study.answers.tables import Study, Table, least
from imufield.study.context import StudyContext

QUICK = StudyContext(quick=True, workers=1)


def session(value: float, rng: np.random.Generator) -> dict[str, float | list[bool]]:
    """A session that shows its value, and two numbers of which one is inside its limits where the value is positive."""
    assert rng.random() < 1
    return {"mean": value, "square": value, "inside": [value > 0, True], "least": [value > 0, True]}


def table(campaign: str, *values: float) -> Table:
    return Table(
        name="values",
        label="value",
        campaign=campaign,
        rows={campaign: [partial(session, value) for value in values]},
        runs=(1000, 3),
        statistics={"square": rms, "least": least},
    )


def test_a_column_is_counted_over_all_kinds_of_a_row() -> None:
    assert table("a", 1.0, -7.0).count(QUICK) == {"a": {"mean": -3.0, "square": 5.0, "inside": 0.75, "least": 0.5}}


def test_tables_of_one_name_are_one() -> None:
    found = Study(table("a", 1.0), table("b", 2.0), bars=("mean",), unit="m")(QUICK)
    assert found.values["values"] == {
        "a": {"mean": 1.0, "square": 1.0, "inside": 1.0, "least": 1.0},
        "b": {"mean": 2.0, "square": 2.0, "inside": 1.0, "least": 1.0},
    }
    assert (found.values["values_runs"], found.values["unit"]) == (3, "m")
    (only,) = found.tables
    assert only.columns == ("value", "mean", "square", "inside", "least")
    assert [row[0] for row in only.rows] == ["a", "b"]
    assert found.draw is not None
