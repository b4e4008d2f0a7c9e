"""Options of commands that compute from samples or use results: ``solve``, ``report``, ``verify``, ``history`` and others."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, get_args

from imufield.commands.options import completion
from imufield.commands.options.configuration import parse_zero
from imufield.commands.options.shared import (
    LARGEST_SEED,
    AsJson,
    ExportSettings,
    MethodSettings,
    NewestSession,
    PlaceOptions,
    RawZero,
    Scheduler,
    TableRateHz,
    Workers,
    argument,
    one_of,
    option,
    session_argument,
    unknown_site,
)
from imufield.dataclass import dataclass, field
from imufield.files import DEFAULT_ROOT
from imufield.limits import TARGET_RANGE
from imufield.sentences import Sentences

if TYPE_CHECKING:
    from imufield.pipeline.calibration import SolveSettings

sentence = Sentences(__package__)

ParameterFile = Annotated[Path, session_argument(help="Parameter file.")]


@dataclass(frozen=True, slots=True, kw_only=True)
class SolveOptions:
    """The options of ``solve``.

    With --together, all sessions of one instrument give one file; its uncertainty includes the change from day to day.

    Example: imufield solve --latitude 48.1 --height 520

    Example: imufield solve march april june --together
    """

    sessions: Annotated[
        list[Path] | None, session_argument(metavar="SESSION", help="Session folders (default: the newest).")
    ] = None
    observations: Annotated[Path | None, option(help="CSV of position means instead of a session.")] = None
    site: PlaceOptions = field(default_factory=unknown_site)
    model: Annotated[
        str,
        option(
            help="Accelerometer model: linear, quadratic, extended (cubic and cross terms), or auto, which "
            "chooses linear or quadratic by a test."
        ),
    ] = "auto"
    gauge: Annotated[
        str | None,
        option(
            help="Which axes are the body axes: lower (body x is the sensor's x axis; default), upper (body z is its z axis), "
            "symmetric (each pair of misalignments equal) or preset (nearest to the axes of --preset)."
        ),
    ] = None
    preset: Annotated[
        Path | None,
        option(help="Previous parameter file: compared with the result, and source of what this session cannot determine."),
    ] = None
    zero: RawZero = None
    temperature: Annotated[
        list[Path] | None,
        option(
            autocompletion=completion.sessions,
            help="Session at another temperature, or a ramp recorded in one pose, for bias and scale over temperature; may "
            "be repeated.",
        ),
    ] = None
    without: Annotated[list[str] | None, option(help="Name of a position to leave out; may be repeated.")] = None
    clock_sigma_ppm: Annotated[
        float | None, option(help="Uncertainty of the sample period, 1 sigma, ppm (default: depends on the clock).", low=0)
    ] = None
    method: Annotated[str, option(help="Solver: least-squares, bsas, ide and others (docs/study.md).")] = "least-squares"
    method_settings: MethodSettings = field(default_factory=dict)
    polish: Annotated[bool, option(help="If --method is not least-squares, refine its result by least squares.")] = True
    cross_check: Annotated[
        bool, option("--cross-check", help="Solve by bsas, ide and least squares, and compare the results.")
    ] = False
    gyroscope_model: Annotated[
        str,
        option(
            "--gyro-model", help="Gyroscope model: basic, g-sensitive (with g-sensitivity), or auto, which decides by a test."
        ),
    ] = "auto"
    grade: Annotated[
        str | None,
        option(
            help="Instrument grade: navigation, tactical, industrial or mems (default: as driver or --preset "
            "states, else mems). Sigma includes its typical errors where a session cannot measure them."
        ),
    ] = None
    seed: Annotated[int, option(help="Seed of all random numbers.", low=0, high=LARGEST_SEED)] = 0
    workers: Workers = None
    scheduler: Scheduler = None
    together: Annotated[
        bool, option("--together", help="Solve all sessions of one instrument as one; see docs/together.md.")
    ] = False
    serial_number: Annotated[
        str | None, option("--serial", help="Serial number; with --together, solve all its sessions in imufield-sessions.")
    ] = None
    output: Annotated[Path | None, option("-o", "--output", help="Where to write the parameter file.")] = None
    as_json: AsJson = False

    def settings(self) -> "SolveSettings":
        """Return how the user wants it calibrated.

        Raises
        ------
        UsageError
            If a choice or a setting is none of those there are, or ``zero`` is neither one number nor three.
        ParameterFileError
            If the preset cannot be read.
        """
        # Here, because this module is read at every start, for a help too.
        import numpy as np

        from imufield.calibrate.gyroscope.model_choice import GyroscopeModel
        from imufield.calibrate.model.grades import GRADES
        from imufield.calibrate.model.result import Gauge, ModelChoice
        from imufield.calibrate.solvers.registry import load_solver
        from imufield.deliver.parameters.file import load
        from imufield.pipeline.calibration import SolveSettings

        zero = parse_zero(self.zero)
        # Refused before a long session is read.
        load_solver(self.method, self.method_settings)
        return SolveSettings(
            model=one_of("model", self.model, get_args(ModelChoice)),
            gauge=None if self.gauge is None else one_of("gauge", self.gauge, get_args(Gauge)),
            method=self.method,
            method_settings=self.method_settings,
            polish=self.polish,
            cross_check=self.cross_check,
            gyroscope_model=one_of("gyro-model", self.gyroscope_model, get_args(GyroscopeModel)),
            preset=None if self.preset is None else load(self.preset),
            raw_zero=None if zero is None else np.array(zero),
            grade=None if self.grade is None else one_of("grade", self.grade, tuple(GRADES)),
            seed=self.seed,
            without=tuple(self.without or ()),
            is_of_several=bool(self.temperature),
            clock_sigma=None if self.clock_sigma_ppm is None else 1e-6 * self.clock_sigma_ppm,
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class NoiseOptions:
    """The options of ``noise``.

    Example: imufield noise my-standstill --plot allan.png
    """

    session: NewestSession = None
    to: Annotated[str, option(help="Format of --output: kalibr, openvins, vins or ros2.")] = "kalibr"
    output: Annotated[Path | None, option("-o", "--output", help="YAML for a navigation filter.")] = None
    plot: Annotated[Path | None, option(help="Draw the Allan deviation into this file (needs matplotlib).")] = None
    parameters: Annotated[
        Path | None,
        option(help="Parameter file: its scales convert the noise to SI units, and the table `noise` is written into it."),
    ] = None
    as_json: AsJson = False


@dataclass(frozen=True, slots=True, kw_only=True)
class StudyOptions:
    """The options of ``study``.

    BAS is beetle antennae search, BSAS its swarm version (with m beetles); IDE is improved differential evolution.

    The studies answers-* simulate one disturbance each and count how often verdict and warnings are right (docs/answers.md).

    Example: imufield study

    Example: imufield study bsas-table3 --quick
    """

    name: Annotated[
        str | None,
        argument(
            help="Name of one study or of a group: bsas, ide (the studies of one paper), all (both papers), answers (the "
            "studies answers-*). Default: list the names."
        ),
    ] = None
    quick: Annotated[bool, option("--quick", help="Few runs, to see that it works.")] = False
    seed: Annotated[int, option(help="Seed of all runs.", low=0, high=LARGEST_SEED)] = 0
    workers: Workers = None
    scheduler: Scheduler = None
    output: Annotated[Path | None, option("-o", "--output", help="Folder for CSV files and plots.")] = None
    document: Annotated[Path | None, option(help="Write all as one Markdown document.")] = None


@dataclass(frozen=True, slots=True, kw_only=True)
class ExportOptions:
    """The options of ``export``.

    Example: imufield export my-session/parameters.toml --to c -o calibration.h
    """

    parameters: Annotated[Path | None, session_argument(help="Parameter file.")] = None
    to: Annotated[
        str | None, option(help="Target, e.g. c, px4, vectornav (default: list them).", autocompletion=completion.targets)
    ] = None
    settings: ExportSettings = field(default_factory=dict)
    output: Annotated[
        Path | None,
        option(
            "-o", "--output", help="File or folder to write (default: the target's usual file names, in the current folder)."
        ),
    ] = None
    as_json: AsJson = False


@dataclass(frozen=True, slots=True, kw_only=True)
class ApplyOptions:
    """The options of ``apply``.

    Example: imufield apply my-session/parameters.toml my-session -o corrected.csv
    """

    parameters: ParameterFile
    source: Annotated[Path, session_argument(help="Session folder, or a table (CSV).")]
    output: Annotated[Path, option("-o", "--output", help="CSV to write.")]
    rate_hz: TableRateHz = None


@dataclass(frozen=True, slots=True, kw_only=True)
class ExportDataOptions:
    """The options of ``export-data``.

    Example: imufield export-data my-session --to csv -o samples.csv
    """

    session: NewestSession = None
    to: Annotated[
        str | None,
        option(
            help="Format: csv, parquet, hdf5, ros2 (MCAP), overview (minimum, mean and maximum of each "
            "interval, for plots), outline (like overview, from a few seconds of each minute; faster). Default: by the "
            "suffix of --output, else csv.",
        ),
    ] = None
    output: Annotated[Path | None, option("-o", "--output", help="File to write (default: SESSION/samples.*).")] = None


@dataclass(frozen=True, slots=True, kw_only=True)
class VerifyOptions:
    """The options of ``verify``.

    Example: imufield verify parameters.toml standstill-5h --require nav-nmi-per-h=1
    """

    parameters: Annotated[
        Path | None, session_argument(help="Parameter file under test (default: that of the newest session).")
    ] = None
    session: Annotated[Path | None, session_argument(help="Session to check them on (default: the newest).")] = None
    preset: Annotated[Path | None, option(help="Parameter file to compare with (default: the nominal scale).")] = None
    hold_out: Annotated[
        int | None,
        option(
            help="How many positions at a time are left out and predicted from the others (default: 4, or fewer where "
            "those left could not be calibrated from); only for the session the parameters came from.",
            low=1,
        ),
    ] = None
    turned: Annotated[
        bool, option("--turned", help="The instrument was turned upside down after the alignment and stayed so.")
    ] = False
    align_s: Annotated[float, option(help="Seconds of rest at the start to align with.", low=1)] = 600.0
    # From -360, as headings are written from 0 to 360 or from -180 to 180.
    heading_deg: Annotated[
        float | None,
        option("--heading", help="Known heading of the body x axis, degrees clockwise from north.", low=-360, high=360),
    ] = None
    heading_sigma_deg: Annotated[float, option("--heading-sigma", help="1 sigma of that heading, degrees.", low=0, high=30)] = (
        0.0
    )
    site: PlaceOptions = field(default_factory=unknown_site)
    require: Annotated[str | None, option(help="Limits, e.g. residual-ug=50,nav-nmi-per-h=1.")] = None
    turn_on_ug: Annotated[
        float | None,
        option(help="Turn-on bias of the accelerometer, 1 sigma, micro-g (default: as large as its bias instability).", low=0),
    ] = None
    turn_on_deg_per_h: Annotated[
        float | None,
        option(help="Turn-on bias of the gyroscope, 1 sigma, deg/h (default: as large as its bias instability).", low=0),
    ] = None
    seed: Annotated[
        int, option(help="Seed of the random runs that forecast the navigation error.", low=0, high=LARGEST_SEED)
    ] = 0
    output: Annotated[Path | None, option("-o", "--output", help="Where to keep the results for the report.")] = None
    as_json: AsJson = False


@dataclass(frozen=True, slots=True, kw_only=True)
class ReportOptions:
    """The options of ``report``.

    Example: imufield report my-session --operator "J. Doe"
    """

    session: NewestSession = None
    parameters: Annotated[Path | None, option(help="Parameter file (default: SESSION/parameters.toml).")] = None
    preset: Annotated[Path | None, option(help="Previous parameter file, to compare with.")] = None
    operator: Annotated[str, option(help="Person who calibrated; printed on the calibration record.")] = ""
    output: Annotated[
        Path | None,
        option("-o", "--output", help="Report page (default: SESSION/report.html; of parameters FILE.toml alone, FILE.html)."),
    ] = None
    record: Annotated[
        Path | None,
        option(help="Calibration record (default: calibration-record.html; beside another PAGE.html, PAGE-record.html)."),
    ] = None
    pdf: Annotated[bool, option("--pdf", help="Write both as PDF, too, beside them (takes some seconds).")] = False


@dataclass(frozen=True, slots=True, kw_only=True)
class CertificateOptions:
    """The options of ``certificate``.

    Example: imufield certificate my-session --laboratory "Our laboratory" --operator "J. Doe" --due-months 12
    """

    source: Annotated[
        Path | None,
        session_argument(metavar="SESSION", help="Session folder, or parameter file (default: the newest session)."),
    ] = None
    laboratory: Annotated[str, option(help="Laboratory that calibrates.")] = ""
    customer: Annotated[str, option(help="Who ordered the calibration.")] = ""
    operator: Annotated[str, option(help="Person who calibrated.")] = ""
    due_months: Annotated[int | None, option(help="Months until the next calibration.", low=1, high=1200)] = None
    output: Annotated[Path | None, option("-o", "--output", help="Folder to write to (default: that of the parameters).")] = (
        None
    )
    pdf: Annotated[bool, option("--pdf", help="Write a PDF as well, and embed it in the XML (takes some seconds).")] = False


@dataclass(frozen=True, slots=True, kw_only=True)
class HistoryOptions:
    """The options of ``history``.

    Example: imufield history calibrations --serial 1234 --plot drift.svg
    """

    folder: Annotated[Path, argument(help="Folder of parameter files; its subfolders are searched, too.")] = DEFAULT_ROOT
    serial_number: Annotated[str | None, option("--serial", help="Only this serial number.")] = None
    at: Annotated[str | None, option(help="Print only the file calibrated closest to this date, e.g. 2026-03-04.")] = None
    # A year, as calibrations are usually dated.
    stale_days: Annotated[float, option(help="Age in days from which a calibration is called old.", low=0)] = 365.0
    csv: Annotated[Path | None, option(help="Write every number of every calibration to this file.")] = None
    plot: Annotated[Path | None, option(help="Draw a control chart of every parameter as SVG, one file per instrument.")] = None
    target_bias_ug: Annotated[
        float | None,
        option(
            "--target-bias-ug",
            help="Accuracy wanted for the biases, 1 sigma, micro-g; `history` then forecasts when to calibrate again.",
            within=TARGET_RANGE,
        ),
    ] = None
    target_scale_ppm: Annotated[
        float | None,
        option("--target-scale-ppm", help="The same for the scale factors, ppm.", within=TARGET_RANGE),
    ] = None
    as_json: AsJson = False
