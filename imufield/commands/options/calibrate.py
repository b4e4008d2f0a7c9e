"""Options of the commands that turn samples into numbers."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, get_args

from imufield.commands.configuration import parse_zero
from imufield.commands.options.shared import (
    LARGEST_SEED,
    AsJson,
    NewestSession,
    PlaceOptions,
    Scheduler,
    Workers,
    argument,
    option,
    unknown_site,
)

if TYPE_CHECKING:
    from imufield.pipeline.calibration import SolveSettings


@dataclass(frozen=True, slots=True, kw_only=True)
class SolveOptions:
    """Solve a session: parameters with uncertainty, and a verdict in words. Several: on all cores, with a table of verdicts.

    Example: imufield solve --latitude 48.1 --height 520
    """

    sessions: Annotated[list[Path] | None, argument(metavar="[SESSION]...", help="Session folders (default: the newest).")] = (
        None
    )
    observations: Annotated[Path | None, option(help="CSV of position means instead of a session.")] = None
    site: PlaceOptions = field(default_factory=unknown_site)
    model: Annotated[str, option(help="auto, linear or quadratic.")] = "auto"
    gauge: Annotated[str | None, option(help="preset, lower, upper or symmetric.")] = None
    preset: Annotated[Path | None, option(help="Parameter file in force before.")] = None
    zero: Annotated[str | None, option(help="Raw output at zero input, one or three numbers.")] = None
    method: Annotated[str, option(help="least-squares, bsas, ide and others, see docs/study.md.")] = "least-squares"
    polish: Annotated[bool, option(help="Finish another method by least squares.")] = True
    cross_check: Annotated[bool, option("--cross-check", help="Solve by bsas, ide and least squares, compare.")] = False
    gyroscope_model: Annotated[str, option("--gyro-model", help="auto, basic or g-sensitive.")] = "auto"
    seed: Annotated[int, option(help="Seed of everything random.", low=0, high=LARGEST_SEED)] = 0
    workers: Workers = None
    scheduler: Scheduler = None
    output: Annotated[Path | None, option("-o", "--output", help="Where to write the parameter file.")] = None
    as_json: AsJson = False

    def settings(self) -> "SolveSettings":
        """Return how the user wants it calibrated.

        Raises
        ------
        UsageError
            If a choice is none of those there are, or ``zero`` is neither one number nor three.
        ParameterFileError
            If the preset cannot be read.
        """
        # Here, because this module is read at every start, for a help too.
        import numpy as np

        from imufield.calibrate.gyroscope.model_choice import GyroscopeModel
        from imufield.calibrate.model.result import Gauge, ModelChoice
        from imufield.deliver.parameters.file import load
        from imufield.pipeline.calibration import SolveSettings, one_of

        zero = parse_zero(self.zero)
        return SolveSettings(
            model=one_of("model", self.model, get_args(ModelChoice)),
            gauge=None if self.gauge is None else one_of("gauge", self.gauge, get_args(Gauge)),
            method=self.method,
            polish=self.polish,
            cross_check=self.cross_check,
            gyroscope_model=one_of("gyro-model", self.gyroscope_model, get_args(GyroscopeModel)),
            preset=None if self.preset is None else load(self.preset),
            raw_zero=None if zero is None else np.array(zero),
            seed=self.seed,
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class NoiseOptions:
    """Measure the noise of hours of standstill by Allan deviation.

    Example: imufield noise my-standstill --plot allan.png
    """

    session: NewestSession = None
    to: Annotated[str, option(help="Form of --output: kalibr, openvins, vins or ros2.")] = "kalibr"
    output: Annotated[Path | None, option("-o", "--output", help="YAML for a navigation filter.")] = None
    plot: Annotated[Path | None, option(help="Draw the Allan deviation into this file (needs matplotlib).")] = None
    parameters: Annotated[Path | None, option(help="Parameter file to write the table `noise` into.")] = None
    as_json: AsJson = False


@dataclass(frozen=True, slots=True, kw_only=True)
class StudyOptions:
    """Reproduce a table or figure of the papers, paper's and our figures side by side.

    BAS is beetle antennae search, BSAS the swarm of it (with m beetles); IDE is improved differential evolution.

    Studies: bsas-table1, bsas-table2, bsas-fig3, bsas-fig4, bsas-fig5, bsas-fig6, bsas-fig7, bsas-table3,
    bsas-staged, bsas-whitened, bsas-bound, bsas-table4, bsas-table5, bsas-fig9, bsas-table6, bsas-fig10,
    bsas-fig11, ide-table1, ide-fig2, ide-fig3, ide-fig4, ide-fig5, ide-table2, ide-table3, ide-fig6, ide-fig8,
    ide-table4, ide-table5, ide-fig10.

    Example: imufield study bsas-table3 --quick
    """

    name: Annotated[str, argument(help="One of the studies below, a paper (bsas, ide), or all.")]
    quick: Annotated[bool, option("--quick", help="Few runs, to see that it works.")] = False
    seed: Annotated[int, option(help="Seed of all runs.", low=0, high=LARGEST_SEED)] = 0
    workers: Workers = None
    scheduler: Scheduler = None
    output: Annotated[Path | None, option("-o", "--output", help="Folder for CSV files and plots.")] = None
    document: Annotated[Path | None, option(help="Write all as one Markdown document.")] = None
