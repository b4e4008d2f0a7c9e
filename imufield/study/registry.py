"""Every study by name. Listing imports nothing; loading imports one module."""

from __future__ import annotations

import importlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import cast

from imufield.errors import Reason, UsageError
from imufield.study.context import StudyContext
from imufield.study.report import StudyReport


@dataclass(frozen=True, slots=True)
class Study:
    """Where a study is."""

    name: str
    module: str
    function: str


# In the order of the papers, which is that of the document.
_ALL = (
    Study("bsas-table1", "setups", "bsas_table_1"),
    Study("bsas-table2", "setups", "bsas_table_2"),
    Study("bsas-fig3", "bsas_stages", "figure_3"),
    Study("bsas-fig4", "bsas_stages", "figure_4"),
    Study("bsas-fig5", "bsas_runs", "figure_5"),
    Study("bsas-fig6", "bsas_runs", "figure_6"),
    Study("bsas-fig7", "bsas_runs", "figure_7"),
    Study("bsas-table3", "bsas_runs", "table_3"),
    Study("bsas-staged", "bsas_stages", "staged"),
    Study("bsas-whitened", "bsas_runs", "whitened"),
    Study("bsas-bound", "bsas_bound", "least_squares_bound"),
    Study("bsas-table4", "setups", "bsas_table_4"),
    Study("bsas-table5", "bsas_hardware", "table_5"),
    Study("bsas-fig9", "bsas_hardware", "figure_9"),
    Study("bsas-table6", "bsas_hardware", "table_6"),
    Study("bsas-fig10", "bsas_hardware", "figure_10"),
    Study("bsas-fig11", "bsas_hardware", "figure_11"),
    Study("ide-table1", "setups", "ide_table_1"),
    Study("ide-fig2", "ide_runs", "figure_2"),
    Study("ide-fig3", "ide_runs", "figure_3"),
    Study("ide-fig4", "ide_runs", "figure_4"),
    Study("ide-fig5", "ide_runs", "figure_5"),
    Study("ide-table2", "ide_runs", "table_2"),
    Study("ide-table3", "setups", "ide_table_3"),
    Study("ide-fig6", "ide_gyroscope", "figure_6"),
    Study("ide-fig8", "ide_gyroscope", "figure_8"),
    Study("ide-table4", "ide_gyroscope", "table_4"),
    Study("ide-table5", "ide_comparison", "table_5"),
    Study("ide-fig10", "ide_comparison", "figure_10"),
)
STUDIES: Mapping[str, Study] = MappingProxyType({study.name: study for study in _ALL})
ALL = "all"


def find_studies(name: str) -> tuple[Study, ...]:
    """Return the studies of a name: one, "all", or all of a paper ("bsas", "ide").

    Raises
    ------
    UsageError
        If there is none.
    """
    found = tuple(study for study in _ALL if name in (study.name, ALL, study.name.partition("-")[0]))
    if not found:
        raise UsageError(
            f"there is no study {name!r}; use all, bsas, ide, or one of {', '.join(STUDIES)}", Reason.USAGE, study=name
        )
    return found


def load_study(study: Study) -> Callable[[StudyContext], StudyReport]:
    """Return the function behind a study."""
    module = importlib.import_module(f"imufield.study.{study.module}")
    return cast("Callable[[StudyContext], StudyReport]", getattr(module, study.function))
