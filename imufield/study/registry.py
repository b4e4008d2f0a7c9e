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
    title: str
    module: str
    function: str


_ALL = (
    Study("bsas-table1", "true values", "setups", "bsas_table_1"),
    Study("bsas-table2", "settings of the swarm", "setups", "bsas_table_2"),
    Study("bsas-fig3", "convergence of BSAS with m, p_pos, p_st", "bsas_stages", "figure_3"),
    Study("bsas-fig4", "convergence of BSAS and BAS", "bsas_stages", "figure_4"),
    Study("bsas-fig5", "final costs of BSAS", "bsas_runs", "figure_5"),
    Study("bsas-fig6", "final costs of BAS", "bsas_runs", "figure_6"),
    Study("bsas-fig7", "errors of the scale factors", "bsas_runs", "figure_7"),
    Study("bsas-table3", "15 parameters over many runs", "bsas_runs", "table_3"),
    Study("bsas-staged", "the staged procedure with presets off the truth", "bsas_stages", "staged"),
    Study("bsas-whitened", "all parameters at once, in whitened coordinates", "bsas_runs", "whitened"),
    Study("bsas-bound", "least squares against the Cramér-Rao bound", "bsas_bound", "least_squares_bound"),
    Study("bsas-table4", "the instrument", "setups", "bsas_table_4"),
    Study("bsas-table5", "36-position check", "bsas_hardware", "table_5"),
    Study("bsas-fig9", "36-position check, one instrument", "bsas_hardware", "figure_9"),
    Study("bsas-table6", "navigation at rest", "bsas_hardware", "table_6"),
    Study("bsas-fig10", "latitude and longitude error", "bsas_hardware", "figure_10"),
    Study("bsas-fig11", "position error", "bsas_hardware", "figure_11"),
    Study("ide-table1", "accelerometer and bounds", "setups", "ide_table_1"),
    Study("ide-fig2", "DE/rand/1", "ide_runs", "figure_2"),
    Study("ide-fig3", "DE/current-to-best/1", "ide_runs", "figure_3"),
    Study("ide-fig4", "the combined strategy", "ide_runs", "figure_4"),
    Study("ide-fig5", "IDE", "ide_runs", "figure_5"),
    Study("ide-table2", "L_a by strategy", "ide_runs", "table_2"),
    Study("ide-table3", "gyroscope and bounds", "setups", "ide_table_3"),
    Study("ide-fig6", "gyroscope at rest", "ide_gyroscope", "figure_6"),
    Study("ide-fig8", "gyroscope, dynamic path", "ide_gyroscope", "figure_8"),
    Study("ide-table4", "gyroscope, static and dynamic path", "ide_gyroscope", "table_4"),
    Study("ide-table5", "GA, PSO and IDE", "ide_comparison", "table_5"),
    Study("ide-fig10", "navigation by method", "ide_comparison", "figure_10"),
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
