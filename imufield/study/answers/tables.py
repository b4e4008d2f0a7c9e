"""One mechanism for all studies of answers: which sessions are simulated, how often, and how their values are counted.

A session is simulated by a function that returns its values by the names of the columns. What is counted of a column is the
mean over all sessions of a row, which is a share where the values are true or false, or another statistic.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np
from numpy.typing import ArrayLike

from imufield.dataclass import dataclass, field
from imufield.samples import FloatArray
from imufield.study import figures
from imufield.study.context import StudyContext
from imufield.study.report import Findings, keyed_table

Session = Callable[[np.random.Generator], Mapping[str, ArrayLike]]
Rows = Mapping[str, Session | Sequence[Session]]
Statistics = Mapping[str, Callable[[FloatArray], ArrayLike]]
Row = dict[str, float]


def least(values: FloatArray) -> float:
    """Return the mean of the kind of sessions that has the smallest."""
    return float(values.reshape(len(values), -1).mean(axis=1).min())


@dataclass(frozen=True, slots=True, kw_only=True)
class Table:
    """Rows of sessions.

    Attributes
    ----------
    name, label : str
        Of the table, and of its first column; tables of one name are one.
    campaign : str
        Whose random numbers these are.
    rows : mapping
        Name to one kind of session, or several that count alike, of which a quick study takes the first and the last; as
        ``partial`` of a function of a module, which is sent to other processes by its name.
    runs : (int, int)
        Of each kind, in full and quick.
    statistics : mapping
        Of columns that are not counted by their mean: a function of an array, the shape of which begins with kinds and runs.
    """

    name: str = "shares"
    label: str
    campaign: str
    rows: Rows
    runs: tuple[int, int]
    statistics: Statistics = field(default_factory=dict)

    def count(self, context: StudyContext) -> dict[str, Row]:
        """Simulate all sessions and return what is counted, row by row."""
        kinds = {name: [kind] if callable(kind) else [*kind] for name, kind in self.rows.items()}
        if context.quick:
            kinds = {name: [*dict.fromkeys((of_row[0], of_row[-1]))] for name, of_row in kinds.items()}
        every = [kind for of_row in kinds.values() for kind in of_row]
        found = iter(context.campaign_of_each(self.campaign, _simulate, every, context.runs(*self.runs)))
        return {name: self._row([next(found) for _ in of_row]) for name, of_row in kinds.items()}

    def _row(self, found: list[list[Mapping[str, ArrayLike]]]) -> Row:
        values = {column: np.array([[run[column] for run in of_kind] for of_kind in found]) for column in found[0][0]}
        return {column: np.asarray(self.statistics.get(column, np.mean)(of)).item() for column, of in values.items()}


def _simulate(session: Session, rng: np.random.Generator) -> Mapping[str, ArrayLike]:
    return session(rng)


class Study:
    """A study of some tables, the first of which may be drawn.

    Its words name the rows by the name of their table, its number of runs as ``NAME_runs``, and the facts.

    Parameters
    ----------
    *tables : Table
    bars : sequence of str
        Columns of the first table that are drawn.
    **facts : object
    """

    def __init__(self, *tables: Table, bars: Sequence[str] = (), **facts: object) -> None:
        self._tables, self._bars, self._facts = tables, bars, facts

    def __call__(self, context: StudyContext) -> Findings:
        """Run the study."""
        rows: dict[str, dict[str, Row]] = {}
        for table in self._tables:
            rows.setdefault(table.name, {}).update(table.count(context))
        labels = {table.name: table.label for table in self._tables}
        first = rows[self._tables[0].name]
        series = {column: np.array([row[column] for row in first.values()]) for column in self._bars}
        runs = {f"{table.name}_runs": context.runs(*table.runs) for table in self._tables}
        return Findings(
            values={**rows, **runs, **self._facts},
            tables=tuple(keyed_table(name, labels[name], of_table) for name, of_table in rows.items()),
            draw=figures.bars(tuple(first), series, "share") if self._bars else None,
        )
