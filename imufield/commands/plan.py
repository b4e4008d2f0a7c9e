"""``imufield plan``: how long a session takes, and how good it becomes, before it begins."""

from __future__ import annotations

import json

from imufield.calibrate.model.grades import DEFAULT_GRADE, find_grade, grade_by_noise
from imufield.commands.options.acquire_commands import PlanOptions
from imufield.commands.terminal.output import echo, say
from imufield.dataclass import asdict
from imufield.earth import MICRO_G_M_S2
from imufield.guide.lead.session_time import session_time
from imufield.guide.lead.settings import GuideSettings
from imufield.guide.positions import DEFAULT_SCHEME, REVISIT_FROM, scheme
from imufield.sentences import Sentences

sentence = Sentences(__package__)


def run_plan(options: PlanOptions) -> None:
    """Say how long it takes by the guide's own forecast, and what was assumed for it.

    Raises
    ------
    UsageError
        If there is no such scheme, driver, grade or place.
    CalibrationError
        If gravity is nowhere on Earth what was given.
    """
    positions = scheme(DEFAULT_SCHEME if options.positions is None else options.positions)
    settings = GuideSettings(
        hold_s=options.hold_s,
        target_bias_ug=options.target_bias_ug,
        target_scale_ppm=options.target_scale_ppm,
        revisit_first=len(positions) >= REVISIT_FROM,
        gravity=options.site.gravity(),
    )
    noise = None if options.noise_ug is None else options.noise_ug * MICRO_G_M_S2
    by_driver = _stated_grade(options.driver)
    if options.grade is None and noise is not None:
        grade = grade_by_noise("accelerometer", noise)
    else:
        grade = find_grade(options.grade or by_driver or DEFAULT_GRADE)
    noise = noise or grade.accelerometer.noise_density
    time = session_time(positions, settings, noise=noise, grade=grade)
    sizes = {"noise_ug": noise / MICRO_G_M_S2, "scatter_ug": grade.scatter_m_s2 / MICRO_G_M_S2}
    is_known = bool(options.noise_ug or options.grade or by_driver)
    source = time.gravity.source_words
    if time.gravity.source == "assumed":
        source = sentence("plan.place_unknown" if options.site.place().gravity_m_s2 is None else "plan.textbook")
    gravity = {"gravity_ppm": time.gravity_ppm, "source": source}
    assumed = sentence("plan.known" if is_known else "plan.assumed", grade=grade.name, **gravity, **sizes)
    lacking = "plan.no_place" if time.gravity.source == "assumed" else "plan.no_height" if time.gravity.lacks_height else ""
    place = f" {sentence(lacking)}" if lacking else ""
    remedy = time.remedy if time.wanted and not time.is_met else ""
    if options.as_json:
        facts = {**asdict(time), **sizes, "grade": grade.name, "is_met": time.is_met}
        echo(json.dumps({**facts, "words": time.words, "remedy": remedy, "assumed": assumed + place}))
    else:
        say(time.words)
        if remedy:
            say(remedy)
        say(assumed + place)


def _stated_grade(driver: str | None) -> str:
    """Return the grade that a driver states of its instruments; empty without a driver, or where they differ."""
    if driver is None:
        return ""
    from imufield.acquire.registry import load_driver  # Late: most plans are made before there is an instrument.

    return load_driver(driver).load_protocol().nominal.grade
