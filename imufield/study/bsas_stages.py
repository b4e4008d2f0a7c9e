"""BSAS Figs. 3 and 4 and the staged procedure: how the swarm converges, category by category.

References
----------
.. [1] P. Wang et al., "In-Field Calibration of Triaxial Accelerometer Based on Beetle Swarm Antenna Search Algorithm",
   Sensors, 2020: section 4.1, Figs. 3 and 4.
"""

from __future__ import annotations

from functools import cache, partial

import numpy as np

from imufield.calibrate.model.models import PARAMETERS
from imufield.calibrate.solvers.beetles import BasSettings, BsasSettings, solve_bas, solve_bsas
from imufield.calibrate.solvers.norm_problem import NormProblem
from imufield.calibrate.solvers.staged import PAPER_CATEGORIES, solve_bsas_staged, solve_stages
from imufield.dataclass import dataclass, field, replace
from imufield.earth import MICRO_G_M_S2
from imufield.samples import FloatArray
from imufield.study import figures
from imufield.study.context import StudyContext
from imufield.study.instruments import (
    BSAS_AXES,
    BSAS_GRAVITY_M_S2,
    BSAS_NOISE_M_S2,
    BSAS_TRUTH,
    FIELD_PRESET,
    PresetError,
    bsas_outputs,
    bsas_preset,
)
from imufield.study.report import Findings, curves_table, texts

CATEGORIES = ("scale factors", "biases", "misalignments", "quadratic terms")
CATEGORY_OFF = (0.5, 0.5e-3, 1e-5, 0.002)
"""How far the preset of a category is off: raw/(m/s^2), m/s^2, rad, raw/(m/s^2)^2."""
_PANELS = (0, 1, 3, 2)  # Categories in the order of the paper's panels.
_AT_NOISE = 1.2  # Times the cost of the truth up to which a category counts as down at the noise.
_ARRIVED = 1.1  # Times its final cost at which a curve has arrived.
_VARIED = (0.2, 0.5, 0.8)  # Probabilities tried; the paper prints them in its legends only.


def stage_problem(preset: FloatArray, raw: FloatArray) -> NormProblem:
    """Return eq. 13 in the paper's own coordinates: the 15 parameters in their own units, without bounds."""
    return NormProblem(
        raw=raw,
        gravity_m_s2=BSAS_GRAVITY_M_S2,
        sigma_m_s2=np.ones(len(raw)),
        origin=preset,
        basis=np.eye(PARAMETERS),
        quadratic_axes=BSAS_AXES,
        cost_name="absolute",
    )


@dataclass(frozen=True, slots=True)
class Stage:
    """One category, the others at the truth."""

    category: int
    swarm: BsasSettings = field(default_factory=BsasSettings)
    single: bool = False
    """One beetle (BAS) instead of a swarm."""


def run_stage(stage: Stage, rng: np.random.Generator) -> FloatArray:
    """Return the best cost after each iteration."""
    members = PAPER_CATEGORIES[stage.category]
    preset = BSAS_TRUTH.copy()
    preset[list(members)] += CATEGORY_OFF[stage.category] * rng.uniform(-1, 1, len(members))
    problem = stage_problem(preset, bsas_outputs(rng))
    # A single beetle takes the same steps as one of the swarm.
    solver = partial(solve_bas, settings=BasSettings()) if stage.single else partial(solve_bsas, settings=stage.swarm)
    history = solve_stages(problem, (members,), rng=rng, solver=solver)[0].history
    # A swarm that stopped early stays where it is.
    return np.concatenate([history, np.full(stage.swarm.k_max - len(history), history[-1])])


def _medians(context: StudyContext, name: str, stages: dict[str, Stage], runs: int) -> dict[str, FloatArray]:
    """Return for each stage the median of the histories of its runs."""
    found = context.campaign_of_each(name, run_stage, [*stages.values()], runs)
    return {label: np.median(histories, axis=0) for label, histories in zip(stages, found, strict=True)}


def _arrival(curve: FloatArray) -> int:
    """Return the first iteration with a cost near the final one."""
    return int(np.argmax(curve <= _ARRIVED * curve[-1])) + 1


def figure_3(context: StudyContext) -> Findings:
    """Show convergence with different numbers of beetles and probabilities."""
    runs = context.runs(50, 1)
    plain = BsasSettings()
    variants = {f"m = {m}": replace(plain, m=m) for m in (2, 6, 10)}
    variants |= {f"p_st = {p:g}": replace(plain, p_st=p) for p in _VARIED}
    variants |= {f"p_pos = {p:g}": replace(plain, p_pos=p) for p in _VARIED}
    stages = {f"{CATEGORIES[p]}, {label}": Stage(p, swarm) for p in _PANELS for label, swarm in variants.items()}
    curves = _medians(context, "bsas-fig3", stages, runs)
    panels = {CATEGORIES[p]: {label: curves[f"{CATEGORIES[p]}, {label}"] for label in variants} for p in _PANELS}
    of_beetles = {m: {CATEGORIES[p]: curves[f"{CATEGORIES[p]}, m = {m}"][-1] for p in _PANELS} for m in (10, 6, 2)}
    final = {f"{category}, m = {m}": cost for m, of_m in of_beetles.items() for category, cost in of_m.items()}
    varied = {name: (curve[-1], _arrival(curve)) for name, curve in curves.items() if " m = " not in name}
    # The costs of all numbers of beetles over that of the truth: 24 absolute values of normal noise.
    truth_cost = 24 * np.sqrt(2 / np.pi) * BSAS_NOISE_M_S2
    highest = {name: max(of_m[name] for of_m in of_beetles.values()) / truth_cost for name in of_beetles[10]}
    above = [name for name, ratio in highest.items() if ratio > _AT_NOISE]
    paper = np.array(texts()["bsas-fig3"]["paper"]["final"]) / np.array([*final.values()])
    return Findings(
        values={
            "final": final,
            "varied": varied,
            "off": CATEGORY_OFF,
            "runs": runs,
            "truth_cost": truth_cost,
            "at_noise": " and ".join(name for name in highest if name not in above),
            "above_noise": " and ".join(f"{name} ({highest[name]:.1f} times it)" for name in above),
            "turns_above": above == ["misalignments"],
            "fewer": paper[4:],
            "fewer_worse": np.all(paper[4:] > 1),
        },
        tables=(curves_table("convergence", "iteration", curves),),
        draw=figures.convergence(panels, "cost, m/s²"),
    )


def figure_4(context: StudyContext) -> Findings:
    """Compare BSAS with BAS by category."""
    runs = context.runs(50, 1)
    methods = {"BSAS": False, "BAS": True}
    stages = {f"{CATEGORIES[p]}, {label}": Stage(p, single=single) for p in _PANELS for label, single in methods.items()}
    curves = _medians(context, "bsas-fig4", stages, runs)
    panels = {CATEGORIES[p]: {label: curves[f"{CATEGORIES[p]}, {label}"] for label in methods} for p in _PANELS}
    final = {category: [curve[-1] for curve in of_method.values()] for category, of_method in panels.items()}
    ratio = {category: bas / bsas for category, (bsas, bas) in final.items()}
    worst = max(ratio, key=lambda category: ratio[category])
    return Findings(
        values={
            "final": final,
            "runs": runs,
            "worst": worst,
            "ratio": ratio[worst],
            "others": np.array([ratio[category] for category in ratio if category != worst]),
            "as_paper": worst == "misalignments",
        },
        tables=(curves_table("convergence", "iteration", curves),),
        draw=figures.convergence(panels, "cost, m/s²"),
    )


_ROUNDS = 8, 2  # Full and quick. The paper repeats "until the requirements are met" and gives no number.
_MODERATE = PresetError(0.5 / 734.9, 0.5e-3, 1e-5, 1.0)


def run_staged(job: tuple[PresetError, int], rng: np.random.Generator) -> FloatArray:
    """Return the cost after each round of the four categories, and whether it claims to have converged (last entry).

    A job is how far the preset may be off, and the number of rounds.
    """
    error, rounds = job
    raw, preset = bsas_outputs(rng), bsas_preset(rng, error)
    solver = partial(solve_bsas, settings=BsasSettings())
    stages = solve_stages(stage_problem(preset, raw), PAPER_CATEGORIES, rng=rng, rounds=rounds, solver=solver)
    # The cost after the last category of each round.
    costs = [stages[4 * k + 3].cost for k in range(rounds)]
    claimed = solve_bsas_staged(stage_problem(preset, raw), rng=rng).converged
    return np.array([*costs, float(claimed)])


def run_scale_stage_with_bias_off(off_m_s2: float, rng: np.random.Generator) -> float:
    """Return the best cost of the scale stage where the bias preset is off."""
    members = PAPER_CATEGORIES[0]
    # Only the bias is off, which the scale stage cannot move: what cost is left is what it cannot reach.
    preset = BSAS_TRUTH.copy()
    preset[3:6] += off_m_s2 * rng.choice([-1.0, 1.0], 3)
    problem = stage_problem(preset, bsas_outputs(rng))
    return solve_stages(problem, (members,), rng=rng, solver=partial(solve_bsas, settings=BsasSettings()))[0].cost


@cache
def _staged(context: StudyContext) -> dict[str, FloatArray]:
    runs = context.runs(50, 1)
    found = {
        name: np.array(context.campaign(f"bsas-staged {name}", run_staged, [(error, context.runs(*_ROUNDS))] * runs))
        for name, error in (("moderate", _MODERATE), ("field", FIELD_PRESET))
    }
    off = context.campaign("bsas-staged bias", run_scale_stage_with_bias_off, [10 * MICRO_G_M_S2] * runs)
    return {**found, "bias off": np.array(off)}


def staged(context: StudyContext) -> Findings:
    """Follow the staged procedure from presets as they are in the field."""
    found = _staged(context)
    runs = len(found["field"])
    moderate, field = (np.median(found[name][:, :-1], axis=0) for name in ("moderate", "field"))
    curves = {"moderate presets": moderate, "field presets": field}
    return Findings(
        values={
            "moderate": moderate[[0, -1]],
            "field": field[[0, -1]],
            "bias_off": found["bias off"],
            "claims": int(sum(found[name][:, -1].sum() for name in ("moderate", "field"))),
            "claimants": 2 * runs,
            "none": not any(found[name][:, -1].any() for name in ("moderate", "field")),
            "rounds": len(field),
            "runs": runs,
        },
        tables=(curves_table("rounds", "round", curves),),
        draw=figures.convergence({"median cost": curves}, "cost, m/s²", xlabel="round"),
    )
