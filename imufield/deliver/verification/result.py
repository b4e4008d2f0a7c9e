"""The results of a verification: requirements met or not, the file beside the parameters, and the text for a person.

``parameters.verification.json`` holds the results of the last check of left-out positions and of the last static
navigation, and the last requirement of each name with its result; the report reads it. It belongs to one content of the
parameter file, by its hash, and has a hash of its own: a verdict that was edited is not valid.
"""

from __future__ import annotations

import json
import math
import textwrap
from collections.abc import Collection, Iterator, Mapping
from pathlib import Path

import numpy as np

from imufield.dataclass import asdict, dataclass
from imufield.deliver.navigation.drift import QUANTITIES
from imufield.deliver.navigation.static_navigation import NavigationResult
from imufield.deliver.parameters.context import SOFTWARE, now_text
from imufield.deliver.parameters.file import Parameters, json_ready
from imufield.deliver.parameters.printed_numbers import acceleration_unit, line_width
from imufield.deliver.parameters.schema import Document
from imufield.deliver.parameters.write import content_sha256
from imufield.deliver.verification.left_out import LeftOutPositions
from imufield.earth import MICRO_G_M_S2
from imufield.errors import UsageError
from imufield.files import Origin, read_small_file, typed_write_errors, write_atomically
from imufield.sentences import Sentences, folded, printable_values
from imufield.toml_and_json import parse_json

sentence = Sentences(__package__)

FORMAT = "imufield-verification"
VERSION = 1  # A report leaves out results of another one.
# RMS residual of held-out positions, micro-g; largest position error over the time navigated, nautical miles an hour.
REQUIREMENTS = ("residual-ug", "nav-nmi-per-h")
_HOURS_FROM_S = 7200.0  # Shorter recordings are told in minutes: a sixth of them has one decimal in hours.
_POINTS = 600  # Of each curve in the file: more than a plot shows.


@dataclass(frozen=True, slots=True)
class Requirement:
    """One requirement and what was measured."""

    name: str
    limit: float
    measured: float

    @property
    def passed(self) -> bool:
        """Whether it is met; NaN is not."""
        return self.measured <= self.limit


@dataclass(frozen=True, slots=True, kw_only=True)
class Verification:
    """The results of one run of ``verify``."""

    parameters: Parameters
    session: str
    left_out: LeftOutPositions | None = None
    navigation: NavigationResult | None = None
    requirements: tuple[Requirement, ...] = ()
    notes: tuple[str, ...] = ()
    has_preset: bool = False
    """Whether a preset gave the residuals before; else the nominal scale."""

    @property
    def passed(self) -> bool | None:
        """Whether all requirements are met and nothing objects to the parameters; None without either."""
        return _verdict(self.objections, [requirement.passed for requirement in self.requirements])

    @property
    def objections(self) -> tuple[str, ...]:
        """Sentences that make it fail whatever was measured: from the left-out positions and from the file itself."""
        own = self.left_out.objection if self.left_out is not None else ""
        return tuple(filter(None, (own, self.parameters.verdict_note if self.requirements else "")))


def _verdict(objections: Collection[str], met: Collection[bool]) -> bool | None:
    return False if objections else all(met) if met else None


def parse_requirements(text: str | None) -> dict[str, float]:
    """Read ``NAME=LIMIT,NAME=LIMIT``.

    Raises
    ------
    UsageError
        If a name is not known or stands twice, a limit is no positive number, or nothing is required.
    """
    limits: dict[str, float] = {}
    for part in [] if text is None else text.split(","):
        name, _, value = (piece.strip() for piece in part.partition("="))
        if name not in REQUIREMENTS:
            raise UsageError(sentence("result.requirement", given=part.strip(), known=REQUIREMENTS))
        try:
            limit = float(value)
        except ValueError:
            limit = math.nan  # lies in no range, so that the next sentence is said of it too
        if not 0 < limit < math.inf:
            raise UsageError(sentence("result.limit", name=name, limit=value))
        if name in limits:
            raise UsageError(sentence("result.twice", name=name, first=limits[name], second=limit))
        limits[name] = limit
    return limits


def judge(
    limits: Mapping[str, float], left_out: LeftOutPositions | None, navigation: NavigationResult | None
) -> tuple[Requirement, ...]:
    """Return every requirement with what was measured, NaN where it was not."""
    # NaN meets no requirement: what was not measured is not proven, nor by positions at which an error may hide.
    measured: dict[str, float] = dict.fromkeys(REQUIREMENTS, math.nan)
    if left_out is not None and not left_out.hidden:
        measured["residual-ug"] = left_out.rms_m_s2 / MICRO_G_M_S2
    if navigation is not None:
        measured["nav-nmi-per-h"] = navigation.tested.rate_nmi_per_h
    return tuple(Requirement(name, limit, measured[name]) for name, limit in limits.items())


def to_document(verification: Verification) -> Document:
    """Return everything as plain values."""
    document: Document = {
        "format": FORMAT,
        "version": VERSION,
        "created": now_text(),
        "software": SOFTWARE,
        "parameters_sha256": content_sha256(verification.parameters.document),
        "session": verification.session,
        "passed": verification.passed,
        "requirement": [
            asdict(requirement) | {"passed": requirement.passed, "session": verification.session}
            for requirement in verification.requirements
        ],
        "objections": list(verification.objections),
        "notes": list(verification.notes),
    }
    # Each check and requirement names its session: the file keeps those of several runs, which may be of several recordings.
    if verification.left_out is not None:
        document["positions"] = _positions(verification.left_out) | {"session": verification.session}
    if verification.navigation is not None:
        document["navigation"] = _navigation(verification.navigation) | {"session": verification.session}
    return document


def _positions(left_out: LeftOutPositions) -> Document:
    figures = ("rms_m_s2", "before_rms_m_s2", "forecast_rms_m_s2", "misfit", "misfit_limit", "as_forecast", "chance")
    arrays = ("up", "residual_m_s2", "before_m_s2", "sigma_m_s2")
    return {
        **{key: getattr(left_out, key) for key in ("how", *figures, "words", "hidden")},
        "name": list(left_out.name),
        **{key: getattr(left_out, key).tolist() for key in arrays},
    }


def _navigation(result: NavigationResult) -> Document:
    settings, forecast = result.settings, result.forecast
    drifts = {}
    for name, drift in result.drifts.items():
        # The first and the last row always; a short recording has fewer rows than points, each of them once.
        rows = np.unique(np.linspace(0, len(drift.time_s) - 1, _POINTS).astype(np.int64))
        curves = {key: getattr(drift, key)[rows].tolist() for key in ("time_s", *QUANTITIES, "position_nmi")}
        drifts[name] = {"rate_nmi_per_h": drift.rate_nmi_per_h, "final_nmi": float(drift.position_nmi[-1]), **curves}
    document: Document = {
        "align_s": settings.align_s,
        "navigated_s": result.navigated_s,
        "turned": settings.turned,
        "heading_deg": None if settings.heading is None else math.degrees(settings.heading.angle_rad),
        "latitude_deg": settings.latitude_deg,
        "seed": settings.seed,
        "samples": result.samples,
        "lost": result.lost,
        "noise_density": result.noise.density.tolist(),
        "bias_instability": result.noise.instability.tolist(),
        "notes": list(result.notes),
        "drift": drifts,
    }
    if forecast is not None:
        figures = ("runs", "rate_median_nmi_per_h", "rate_95_nmi_per_h", "heading_sigma_rad")
        document["forecast"] = {
            **{key: getattr(forecast, key) for key in figures},
            "sources_nmi_per_h": forecast.sources,
            "as_forecast": forecast.holds(result.tested),
            "time_s": forecast.time_s.tolist(),
            **{band: {name: getattr(forecast, band)[name].tolist() for name in QUANTITIES} for band in ("low", "high")},
            **{key: getattr(forecast, key).tolist() for key in ("position_median_nmi", "position_95_nmi")},
        }
    return document


def verification_path(parameter_file: Path) -> Path:
    """Return the path of the results for a parameter file."""
    return parameter_file.with_name(f"{parameter_file.stem}.verification.json")


def write_verification(path: Path, document: Document) -> Document:
    """Write the results, with what they leave standing of earlier ones of the same parameters; return all that is written.

    Raises
    ------
    ParameterFileError
        If the file cannot be written; one that stood there is intact.
    """
    joined = _joined(read_verification(path, document["parameters_sha256"]) or {}, document)
    whole = joined | {"integrity": {"sha256": content_sha256(joined)}}
    with typed_write_errors(path):
        write_atomically(path, (json.dumps(json_ready(whole)) + "\n").encode("ascii"))
    return joined


def _joined(kept: Document, document: Document) -> Document:
    """Return new results with the earlier checks, requirements and objections that they do not replace."""
    # Positions and navigation are two runs of the command, and the report shows both.
    checks = {key: kept[key] for key in ("positions", "navigation") if key in kept}
    required = {one["name"]: one for one in (*kept.get("requirement", ()), *document["requirement"])}
    # That of positions is the sentence of their check, and goes when positions are checked again.
    replaced = kept["positions"].get("words") if "positions" in kept and "positions" in document else None
    standing = [objection for objection in kept.get("objections", ()) if objection != replaced]
    objections = [*dict.fromkeys([*standing, *document["objections"]])]
    passed = _verdict(objections, [one["passed"] for one in required.values()])
    return checks | document | {"passed": passed, "requirement": [*required.values()], "objections": objections}


def read_verification(path: Path, parameters_sha256: str) -> Document | None:
    """Return the results for parameters of this content; None where there are none, or ``verification_note`` has a reason."""
    try:
        document = parse_json(read_small_file(path, Origin.INSIDE))
    except (OSError, ValueError):
        return None
    if not isinstance(document, dict) or document.get("format") != FORMAT or document.get("version") != VERSION:
        return None
    # The hash covers the rest, as in the parameter file.
    whole = document.pop("integrity", None) == {"sha256": content_sha256(document)}
    if not whole or document.get("parameters_sha256") != parameters_sha256:
        return None
    return {key: printable_values(value) for key, value in document.items()}


def verification_note(path: Path, parameters_sha256: str) -> str:
    """Return a sentence where the results that lie there cannot be used for these parameters, else an empty one."""
    if not path.exists() or read_verification(path, parameters_sha256) is not None:
        return ""
    return sentence("result.left_out", name=path.name)


def verification_text(verification: Verification) -> str:
    """Return the results for a person at a terminal, in at most 80 columns."""
    lines: list[str] = []
    left_out = verification.left_out
    if left_out is not None:
        lines += [*_position_lines(left_out, has_preset=verification.has_preset), ""]
    if verification.navigation is not None:
        lines += [*_navigation_lines(verification.navigation), ""]
    for note in folded(verification.notes):
        lines += textwrap.wrap(f" · {note}", line_width(), subsequent_indent="   ")
    for objection in verification.objections:
        if left_out is None or objection != left_out.objection:  # which stands below its table
            lines += _wrapped(f"Objection: {objection}")
    for requirement in verification.requirements:
        word = "met" if requirement.passed else "NOT MET"
        measured = "not measured" if math.isnan(requirement.measured) else f"{requirement.measured:.4g}"
        lines.append(f"Requirement {requirement.name} <= {requirement.limit:g}: {measured}, {word}")
    if verification.passed is not None:
        lines.append(f"Verdict: {'PASS' if verification.passed else 'FAIL'}")
    return "\n".join(lines).rstrip("\n") + "\n"


def _wrapped(text: str) -> list[str]:
    return textwrap.wrap(text, line_width(), subsequent_indent="  ")


def _position_lines(left_out: LeftOutPositions, *, has_preset: bool) -> Iterator[str]:
    is_held_out = left_out.is_own and not left_out.objection
    yield from _wrapped(f"{'Held-out positions' if is_held_out else 'Positions'}: {left_out.how}")
    with_before = bool(np.isfinite(left_out.before_m_s2).all())
    largest = np.nanmax(np.abs([left_out.residual_m_s2, left_out.sigma_m_s2]), initial=0.0)
    unit, size = acceleration_unit(float(largest))
    width = max(8, *(len(name) for name in left_out.name))
    yield f"  {'position':<{width}} {'before' if with_before else '':>10} {'after':>10} {'forecast':>10}   {unit}"
    columns = (left_out.before_m_s2 / size, left_out.residual_m_s2 / size, left_out.sigma_m_s2 / size)
    for name, before, after, sigma in zip(left_out.name, *columns, strict=True):
        yield f"  {name:<{width}} {_cell(before):>10} {_cell(after):>10} {_cell(sigma, '±'):>10}"
    figures = (left_out.before_rms_m_s2, left_out.rms_m_s2, left_out.forecast_rms_m_s2)
    yield f"  {'RMS':<{width}} " + " ".join(f"{_cell(figure / size, ''):>10}" for figure in figures)
    if left_out.words:
        yield from _wrapped(f"  {left_out.words}")
    if left_out.hidden:
        yield from _wrapped(f"  {left_out.hidden}")
    if np.isfinite(left_out.misfit):
        yield from _wrapped(f"  {sentence('result.correlated')}")
    if with_before:
        before_words = sentence("result.by_preset" if has_preset else "result.by_nominal")
        yield from _wrapped(f"  {sentence('result.columns', before=before_words)}")


def _cell(value: float, sign: str = "+") -> str:
    if math.isnan(value):
        return ""
    shown = f"{value:.0f}" if abs(value) >= 100 else f"{value:.1f}" if abs(value) >= 10 else f"{value:.2f}"
    return f"±{shown}" if sign == "±" else f"+{shown}" if sign == "+" and value >= 0 else shown


def _navigation_lines(result: NavigationResult) -> Iterator[str]:
    settings, forecast = result.settings, result.forecast
    turned = sentence("result.turned") if settings.turned else ""
    heading = ""
    if settings.heading is not None:
        heading = sentence("result.heading", heading_deg=math.degrees(settings.heading.angle_rad))
    duration = duration_words(result.navigated_s)
    how = sentence("result.navigation", duration=duration, align_s=settings.align_s, heading=heading, turned=turned)
    yield from _wrapped(f"Static navigation: {how}")
    limit = "95 %" if forecast else ""
    yield f"  {'time':>8} {'latitude':>12} {'longitude':>12} {'v north':>9} {'v east':>9} {'position':>9}  {limit}".rstrip()
    unit, size_s = ("h", 3600) if result.navigated_s >= _HOURS_FROM_S else ("min", 60)
    yield f"  {unit:>8} {'deg':>12} {'deg':>12} {'m/s':>9} {'m/s':>9} {'nmi':>9}  {'nmi' if forecast else ''}".rstrip()
    for name, drift in result.drifts.items():
        yield f"  {name}"
        # Rows at six equal steps of time.
        steps = np.linspace(0, drift.time_s[-1], 7)[1:]
        for row in np.minimum(np.searchsorted(drift.time_s, steps), len(drift.time_s) - 1):
            most = ""
            if forecast is not None and drift is result.tested:
                most = f"{np.interp(drift.time_s[row], forecast.time_s, forecast.position_95_nmi):.3f}"
            line = (
                f"  {drift.time_s[row] / size_s:8.2f} {drift.latitude_deg[row]:+12.6f} {drift.longitude_deg[row]:+12.6f} "
                f"{drift.north_velocity_m_s[row]:+9.4f} {drift.east_velocity_m_s[row]:+9.4f} "
                f"{drift.position_nmi[row]:9.3f}  {most}"
            )
            yield line.rstrip()
    for name, drift in result.drifts.items():
        yield f"  drift {name}: {drift.rate_nmi_per_h:.3f} nmi/h"
    if forecast is None:
        for note in result.notes:
            yield from _wrapped(f"  {note}")
        return
    key = "result.as_forecast" if forecast.holds(result.tested) else "result.more_than_forecast"
    yield from _wrapped(f"  {sentence(key, rate_95_nmi_per_h=forecast.rate_95_nmi_per_h)}")
    for source, rate in sorted(forecast.sources.items(), key=lambda item: -item[1]):
        yield f"    {source:<26}{rate:8.3f}"
    if not settings.turned:
        yield from _wrapped(f"  {sentence('result.hidden')}")


def duration_words(duration_s: float) -> str:
    """Return hours, or minutes where they have more digits."""
    return f"{duration_s / 3600:.2f} h" if duration_s >= _HOURS_FROM_S else f"{duration_s / 60:.1f} min"
