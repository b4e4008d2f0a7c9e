"""``imufield verify``: what parameters are worth, on data they have not seen."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import typer
from rich.console import Console

from imufield.acquire.protocol.protocol import Protocol
from imufield.acquire.recording.reader import Damage
from imufield.acquire.recording.session import Session, open_or_newest
from imufield.acquire.recording.session_record import SiteRecord
from imufield.calibrate.model.observations import Observations
from imufield.calibrate.model.result import AccelerometerParameters, GyroscopeParameters
from imufield.commands.options.deliver import VerifyOptions
from imufield.deliver.navigation.alignment import Heading
from imufield.deliver.navigation.check import Apply, CheckSettings, NavigationResult, StaticNavigation
from imufield.deliver.parameters.apply import correct_accelerometer, correct_gyroscope
from imufield.deliver.parameters.file import Corrected, Parameters, json_ready, load
from imufield.deliver.parameters.numbers import DEG_PER_HOUR_RAD_S, to_ascii
from imufield.deliver.verification.left_out import LeftOutPositions, check_positions, contradiction, cross_validate
from imufield.deliver.verification.result import (
    Verification,
    doubt,
    judge,
    parse_requirements,
    to_document,
    verification_path,
    verification_text,
    write_verification,
)
from imufield.earth import MICRO_G_M_S2, Gravity
from imufield.errors import CalibrationError, ImufieldError, ParameterFileError, Reason, UsageError, VerificationError
from imufield.files import refuse_overwriting
from imufield.pipeline.chain import Chain, ReadingPlan, recorded_protocol, replay_into
from imufield.pipeline.damage import naming_damage
from imufield.pipeline.solving import session_sha256
from imufield.samples import FloatArray, Samples

HOLD_OUT = 4
"""Positions left out at a time, where the session is the one the parameters come from."""
FEWEST_OF_ONE_SIGN = 4
"""Residuals that say something of gravity: fewer have one sign by chance too often."""
SAME_M_S2 = 1e-6
"""Gravity that differs by less is the same: an option is typed with as many digits as the summary prints."""
AFTER = "after"
BEFORE = "before"


@dataclass(frozen=True, slots=True, kw_only=True)
class _Task:
    """What is verified, before the data are read."""

    options: VerifyOptions
    session: Session
    parameters: Parameters
    preset: Parameters | None
    limits: dict[str, float]
    gravity: Gravity
    latitude_deg: float | None
    is_its_own: bool  # Whether the parameters come from this session.

    @property
    def wants_navigation(self) -> bool:
        """Whether the user asked for it."""
        return self.options.turned or self.options.heading_deg is not None or "nav-nmi-per-h" in self.limits


def run_verify(options: VerifyOptions) -> Verification:
    """Verify, print what was found, and keep it beside the parameter file for the report.

    Raises
    ------
    VerificationError
        If a requirement is not met.
    ImufieldError
        If a file or the session cannot be used.
    """
    task = _task(options)
    parameters = task.parameters.path or options.parameters
    output = options.output or verification_path(parameters)
    # Before the replay: hours of navigation should not end at a file that is not to be written.
    refuse_overwriting(output, [parameters, *task.session.parts, *filter(None, [options.preset])])
    found = verify_session(task)
    document = to_document(found)
    write_verification(output, document)
    if options.as_json:
        typer.echo(json.dumps(json_ready(document)))
    else:
        text, console = verification_text(found), Console()
        console.out(to_ascii(text) if console.options.ascii_only else text, end="", highlight=False)
    _refuse_failed(found)
    return found


def verify_session(task: _Task) -> Verification:
    """Read the session once and do every check it allows; raises as ``run_verify``."""
    problems: list[ImufieldError] = []
    damage: list[Damage] = []
    navigation = _Navigation(task, problems)
    chain = Chain(ReadingPlan.of(task.session), (navigation.feed,))
    replay_into(chain, task.session, damage)
    with naming_damage(task.session, damage):
        left_out = _left_out(task, chain, problems)
        navigated = navigation.finish()
        if left_out is None and navigated is None:
            raise problems[0] if problems else CalibrationError("the session holds nothing to check", Reason.TOO_FEW)
    found = () if left_out is None else (*_gravity_notes(task, left_out), *_instrument_notes(task))
    notes = (
        *_file_notes(task),
        *chain.notes,
        *found,
        *(entry.what for entry in damage),
        *(error.message for error in problems),
    )
    requirements = judge(task.limits, left_out, navigated)
    return Verification(
        parameters=task.parameters,
        session=task.session.name,
        left_out=left_out,
        navigation=navigated,
        requirements=requirements,
        notes=notes,
    )


def _task(options: VerifyOptions) -> _Task:
    limits = parse_requirements(options.require)
    parameters = load(options.parameters)
    preset = None if options.preset is None else load(options.preset)
    session = open_or_newest(options.session)
    for checked in filter(None, (parameters, preset)):
        checked.check_instrument(session.serial_number)
    # By the bytes and not by the name: a folder may be renamed or copied. Parameters of no session have no hash.
    sha256 = parameters.context.session.sha256
    is_its_own = bool(sha256) and sha256 == session_sha256(session)
    gravity, latitude_deg = _site(options, parameters, session.record.site, is_its_own=is_its_own)
    task = _Task(
        options=options,
        session=session,
        parameters=parameters,
        preset=preset,
        limits=limits,
        gravity=gravity,
        latitude_deg=latitude_deg,
        is_its_own=is_its_own,
    )
    _refuse_ignored(task)
    return task


def _site(
    options: VerifyOptions, parameters: Parameters, recorded: SiteRecord, *, is_its_own: bool
) -> tuple[Gravity, float | None]:
    """Return gravity at the place of the session, and its latitude."""
    own = parameters.calibration.gravity
    # Where a session does not say where it was taken, what was typed to solve it goes before a default.
    is_typed = options.site.is_known and not (options.site.is_default and is_its_own and own.source != "assumed")
    known = is_typed or recorded != SiteRecord()
    gravity = options.site.gravity(recorded) if known else own
    latitude = gravity.latitude_deg if gravity.latitude_deg is not None else options.site.latitude_deg
    return gravity, own.latitude_deg if latitude is None else latitude


def _refuse_ignored(task: _Task) -> None:
    """Refuse options that would change nothing; raises ``UsageError``."""
    options, own = task.options, task.parameters.calibration.gravity
    if options.hold_out is not None and not task.is_its_own:
        raise UsageError(
            f"--hold-out {options.hold_out} is for the session the parameters come from, and {task.session.name} is another: "
            "there every position is one that they have not seen; leave it out",
            hold_out=options.hold_out,
        )
    here = task.gravity.gravity_m_s2
    typed = options.site.is_known and not options.site.is_default and not task.wants_navigation
    # Navigation needs the place even then, so there the options change something.
    if typed and task.is_its_own and abs(here - own.gravity_m_s2) > SAME_M_S2:
        raise UsageError(
            f"--gravity and --latitude, here {here:.6f} m/s^2, change nothing where the session is the one the parameters "
            f"come from, solved with {own.gravity_m_s2:.6f} m/s^2 ({own.source}); leave them out, or solve again with them",
            typed=here,
            solved=own.gravity_m_s2,
        )


def _left_out(task: _Task, chain: Chain, problems: list[ImufieldError]) -> LeftOutPositions | None:
    """Check the positions; what stands in the way goes to ``problems``, except where it is the user's mistake."""
    try:
        _check_unit(task, chain)
        observations = chain.observations() if chain.guide is not None else chain.still_intervals().observations
        return _check(task, observations, chain)
    except CalibrationError as error:
        if task.options.hold_out is not None or "residual-ug" in task.limits:
            raise
        problems.append(error)
        return None


def _gravity_notes(task: _Task, found: LeftOutPositions) -> Iterator[str]:
    """Yield what it looks like when the axes agree with one another and not with gravity."""
    residual = found.residual_m_s2
    one_sign = bool(np.all(residual > 0) or np.all(residual < 0))
    # Of data that the parameters come from, or of residuals no larger than forecast, the sign says nothing of gravity.
    if found.as_forecast or found.is_own or not one_sign or len(residual) < FEWEST_OF_ONE_SIGN:
        return
    own, here = task.parameters.calibration.gravity, task.gravity
    yield (
        f"all residuals have one sign, {residual.mean() / MICRO_G_M_S2:+.0f} ug on average, which is what a wrong gravity "
        f"does: the parameters were made with {own.gravity_m_s2:.6f} m/s^2 ({own.source}), the session is held against "
        f"{here.gravity_m_s2:.6f} m/s^2 ({here.source}); if it was taken elsewhere, say where with --latitude and --height, or "
        "--gravity"
    )


def _file_notes(task: _Task) -> Iterator[str]:
    """Yield what the parameter file says against itself; with requirements ``doubt`` is an objection."""
    if task.parameters.edited_note:
        yield task.parameters.edited_note
    if task.parameters.gyroscope_note:
        yield task.parameters.gyroscope_note
    said = doubt(task.parameters)
    if said and not task.limits:
        yield said


def _instrument_notes(task: _Task) -> Iterator[str]:
    """Yield that nothing shows whether session and parameters are of one instrument, where that is so."""
    stated, recorded = task.parameters.context.instrument.serial_number, task.session.serial_number
    if task.is_its_own or (stated and recorded):
        return
    where = "recording" if stated else "parameter file" if recorded else "recording and the parameter file"
    yield (
        f"the {where} {'names' if stated or recorded else 'name'} no serial number, so nothing shows that both are of one "
        "instrument; if the residuals are large, another unit is the likeliest cause"
    )


def _check(task: _Task, observations: Observations, chain: Chain) -> LeftOutPositions:
    before = _before_accelerometer(task, chain.protocol)
    calibration = task.parameters.calibration
    if not task.is_its_own:
        return check_positions(calibration, observations, task.gravity, before)
    # Predicting positions from the others says nothing of parameters that did not come from these.
    changed = contradiction(calibration, observations, before)
    return changed or cross_validate(calibration, observations, task.options.hold_out or HOLD_OUT, before)


def _check_unit(task: _Task, chain: Chain) -> None:
    """Refuse parameters for other raw units, as applying them would; raises ``ParameterFileError``."""
    if chain.protocol is None:
        return  # refused before: there is no sample
    units = chain.protocol.units
    for parameters in filter(None, (task.parameters, task.preset)):
        parameters.check_unit("accelerometer", units.accelerometer_rate_unit)


def _before_accelerometer(task: _Task, protocol: Protocol | None) -> AccelerometerParameters | None:
    if task.preset is not None:
        return task.preset.calibration.accelerometer
    scale = None if protocol is None else protocol.nominal.accelerometer_scale
    if scale is None or protocol is None:
        return None
    # A nominal scale has no sign of its own where the wiring has; the parameters know it.
    own = task.parameters.calibration.accelerometer
    return AccelerometerParameters(
        scale=np.abs(scale) * np.sign(own.scale),
        bias_m_s2=np.zeros(3),
        misalignment_rad=np.zeros((3, 3)),
        raw_zero=own.raw_zero,
    )


class _Navigation:
    """Static navigation along with the replay, where the session and the parameters allow it."""

    def __init__(self, task: _Task, problems: list[ImufieldError]) -> None:
        self._task = task
        self._problems = problems
        self._check: StaticNavigation | None = None
        # A guided session is turned all the time; who wants navigation on it has to say so.
        self._off = task.session.record.scheme is not None and not task.wants_navigation

    def feed(self, samples: Samples) -> None:
        if self._off:
            return
        try:
            if self._check is None:
                self._check = self._start()
            self._check.feed(samples)
        except ImufieldError as error:
            self._give_up(error)

    def finish(self) -> NavigationResult | None:
        if self._off or self._check is None:
            return None
        try:
            return self._check.finish(self._task.parameters.calibration)
        except ImufieldError as error:
            self._give_up(error)
            return None

    def _give_up(self, error: ImufieldError) -> None:
        # Parameters in other units are wrong for any check; all else only stands in the way of this one.
        if self._task.wants_navigation or isinstance(error, ParameterFileError):
            raise error
        self._problems.append(error)
        self._off = True

    def _start(self) -> StaticNavigation:
        task, options = self._task, self._task.options
        if task.latitude_deg is None:
            raise UsageError(
                "static navigation needs the latitude, which neither session nor parameter file has; give --latitude"
            )
        if not task.parameters.gyroscope_is_complete:
            raise ParameterFileError(
                f"{task.parameters.path} has no complete gyroscope, which static navigation needs; calibrate from "
                "a session whose instrument sends its gyroscope",
                Reason.UNITS,
            )
        settings = CheckSettings(
            latitude_deg=task.latitude_deg,
            height_m=task.gravity.height_m or 0.0,
            gravity_m_s2=task.gravity.gravity_m_s2,
            align_s=options.align_s,
            turned=options.turned,
            heading=_heading(options),
            turn_on=_turn_on(options),
            instability=_instability(task.parameters),
            seed=options.seed,
        )
        # Held against what the instrument had until now: its earlier parameters, or what its maker says.
        preset = task.preset
        before: Apply | None = preset.apply if preset is not None and preset.gyroscope_is_complete else _nominal(task)
        after: dict[str, Apply] = {AFTER: task.parameters.apply}
        return StaticNavigation(after if before is None else {BEFORE: before, **after}, settings)


def _nominal(task: _Task) -> Apply | None:
    """Return the instrument's own output with nothing but its nominal scale; None where only the maker knows that."""
    protocol = recorded_protocol({}, task.session)
    accelerometer, scale = _before_accelerometer(task, protocol), protocol.nominal.gyroscope_scale
    gyroscope = task.parameters.calibration.gyroscope
    if accelerometer is None or scale is None or gyroscope is None:
        return None
    # As for the accelerometer: only the parameters know how the axes are wired.
    signed = np.abs(scale) * np.sign(gyroscope.parameters.scale)
    plain = GyroscopeParameters(signed, np.zeros((3, 3)), np.zeros(3), np.zeros((3, 3)))

    def apply(samples: Samples) -> Corrected:
        force = correct_accelerometer(accelerometer, samples.accelerometer_rate())
        return Corrected(samples.time_s, force, correct_gyroscope(plain, samples.gyroscope_rate()))

    return apply


def _heading(options: VerifyOptions) -> Heading | None:
    if options.heading_deg is None:
        return None
    return Heading(np.radians(options.heading_deg), np.radians(options.heading_sigma_deg))


def _turn_on(options: VerifyOptions) -> FloatArray | None:
    """Return the turn-on bias the user gave, shape (6,); None where neither was given."""
    if options.turn_on_ug is None and options.turn_on_deg_per_h is None:
        return None
    return np.repeat([(options.turn_on_ug or 0.0) * MICRO_G_M_S2, (options.turn_on_deg_per_h or 0.0) * DEG_PER_HOUR_RAD_S], 3)


def _instability(parameters: Parameters) -> FloatArray | None:
    """Return the bias instability in the parameter file, shape (6,); None where it is not known for every axis."""
    noise = parameters.context.noise
    if noise is None:
        return None
    # A figure that was never seen is NaN, and a forecast from five axes would be too good.
    figures = np.concatenate([noise.accelerometer_bias_instability_m_s2, noise.gyroscope_bias_instability_rad_s])
    return figures if np.isfinite(figures).all() else None


def _refuse_failed(found: Verification) -> None:
    # An objection goes first: parameters that contradict the data are refused whatever the limits.
    if found.objections:
        raise VerificationError(f"FAIL: {found.objections[0]}")
    failed = [requirement for requirement in found.requirements if not requirement.passed]
    if not failed:
        return
    worst = failed[0]
    measured = "was not measured" if np.isnan(worst.measured) else f"is {worst.measured:.4g}"
    raise VerificationError(
        f"FAIL: {worst.name} {measured} where at most {worst.limit:g} is required; calibrate again, or see the "
        "table for what is large",
        requirement=worst.name,
        limit=worst.limit,
        measured=worst.measured,
    )
