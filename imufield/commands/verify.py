"""``imufield verify``: what parameters are worth, on data they have not seen."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator

import numpy as np

from imufield.acquire.decoded_session import session_protocol
from imufield.acquire.protocol.protocol import Protocol
from imufield.acquire.recording.reader import Damage
from imufield.acquire.recording.session import Session, open_or_newest
from imufield.calibrate.model.observations import Observations, leave_out
from imufield.calibrate.model.result import AccelerometerParameters, GyroscopeParameters
from imufield.commands.options.result_commands import VerifyOptions
from imufield.commands.terminal.output import echo, say, say_each, tell_written
from imufield.deliver.navigation.alignment import Heading
from imufield.deliver.navigation.static_navigation import (
    SHORTEST_S,
    TURNED_DEG,
    Apply,
    CheckSettings,
    NavigationResult,
    StaticNavigation,
)
from imufield.deliver.parameters.apply import correct_accelerometer, correct_gyroscope
from imufield.deliver.parameters.file import Corrected, json_ready, load
from imufield.deliver.parameters.printed_numbers import DEG_PER_HOUR_RAD_S, beside, shown_on
from imufield.deliver.samples.apply_session import TemperatureFlags
from imufield.deliver.verification.left_out import LeftOutPositions, check_positions, contradiction, cross_validate
from imufield.deliver.verification.result import (
    Verification,
    judge,
    parse_requirements,
    to_document,
    verification_path,
    verification_text,
    write_verification,
)
from imufield.earth import MICRO_G_M_S2
from imufield.errors import CalibrationError, ImufieldError, ParameterFileError, Reason, UsageError, VerificationError
from imufield.files import refuse_overwriting
from imufield.guide.events import RefusalCode
from imufield.pipeline.chain import Chain, ReadingPlan, replay_into
from imufield.pipeline.damage import naming_damage
from imufield.pipeline.reading import Reading
from imufield.pipeline.reading_cache import cached_reading
from imufield.samples import Samples
from imufield.sentences import Sentences, printable

sentence = Sentences(__package__)

FEWEST_OF_ONE_SIGN = 4
"""Residuals that say something of gravity: fewer have one sign by chance too often."""
SAME_M_S2 = 1e-6
"""Gravity that differs by less is the same: an option is typed with as many digits as the summary prints."""
AFTER = "after"
BEFORE = "before"


class _Task:
    """What is verified, before the data are read."""

    def __init__(self, options: VerifyOptions) -> None:
        self.options = options
        self.limits = parse_requirements(options.require)
        given = options.parameters or Session.newest().folder
        self.parameters, self.path = load(given), given
        self.preset = None if options.preset is None else load(options.preset)
        # A folder stands for the parameters in it: alone it is the session as well.
        its_own = given if given.is_dir() else None
        self.session = open_or_newest(options.session or its_own)
        for checked in filter(None, (self.parameters, self.preset)):
            checked.check_instrument(self.session.serial_number)
        # By the bytes and not by the name: a folder may be renamed or copied. Parameters of no session have no hash.
        sha256 = self.parameters.context.session.sha256
        self.sha256 = own_sha256 = self.session.sha256()
        self.is_its_own = bool(sha256) and sha256 == own_sha256
        together = self.parameters.context.together
        if together is not None and own_sha256 in [session.sha256 for session in together.session]:
            raise UsageError(sentence("verify.one_of_them", session=self.session.name))
        self.asks_for_navigation = options.turned or options.heading_deg is not None
        self.wants_navigation = self.asks_for_navigation or "nav-nmi-per-h" in self.limits
        own, recorded = self.parameters.calibration.gravity, self.session.record.site
        # Where a session does not say where it was taken, what was typed to solve it goes before a default.
        uses_default = options.site.usual.is_known and not (self.is_its_own and own.source != "assumed")
        is_given = options.site.is_typed or uses_default or recorded.is_known
        self.gravity = options.site.gravity(recorded) if is_given else own
        # A session's own parameters know more of its place than the defaults; those of another session know less.
        others = (options.site.usual.latitude_deg, own.latitude_deg)
        latitudes = (self.gravity.latitude_deg, *(reversed(others) if self.is_its_own else others))
        self.latitude_deg = next((latitude for latitude in latitudes if latitude is not None), None)
        self._refuse_ignored()

    def _refuse_ignored(self) -> None:
        """Refuse options that would change nothing; raises ``UsageError``."""
        options, own, here = self.options, self.parameters.calibration.gravity, self.gravity.gravity_m_s2
        if options.hold_out is not None and not self.is_its_own:
            raise UsageError(sentence("verify.hold_out", hold_out=options.hold_out, session=self.session.name))
        # Navigation needs the place even of the parameters' own session, so there the options change something.
        is_typed = options.site.is_typed and not self.wants_navigation
        if is_typed and self.is_its_own and abs(here - own.gravity_m_s2) > SAME_M_S2:
            raise UsageError(sentence("verify.gravity_ignored", typed=here, solved=own.gravity_m_s2, source=own.source_words))


def run_verify(options: VerifyOptions) -> Verification:
    """Verify, print what was found, and keep it beside the parameter file for the report.

    Raises
    ------
    VerificationError
        If a requirement is not met.
    ImufieldError
        If a file or the session cannot be used.
    """
    task = _Task(options)
    parameters = task.parameters.path or task.path
    output = options.output or verification_path(parameters)
    # Before the replay: hours of navigation should not end at a file that is not to be written.
    refuse_overwriting(output, [parameters, *task.session.parts, *filter(None, [options.preset])])
    if not options.as_json:
        # Without arguments these are the newest, which a person may not expect.
        echo(beside(f"session {printable(task.session.name)}, parameters", parameters))
    found = _verify(task)
    document = to_document(found)
    joined = write_verification(output, document)
    if options.as_json:
        echo(json.dumps(json_ready(document)))
    else:
        echo(shown_on(sys.stdout, verification_text(found)), end="")
    tell_written(output, as_json=options.as_json)
    if joined["passed"] is False and found.passed is not False:
        earlier = [*(one["name"] for one in joined["requirement"] if not one["passed"]), *joined["objections"]]
        say(sentence("verify.earlier", name=output.name, earlier=earlier), err=options.as_json)
    # An objection goes first: parameters that contradict the data are refused whatever the limits.
    if found.objections:
        raise VerificationError(sentence("verify.objection", objection=found.objections[0]))
    for failed in found.requirements:
        if not failed.passed:
            key = "verify.not_measured" if np.isnan(failed.measured) else "verify.not_met"
            values = {"requirement": failed.name, "limit": failed.limit, "measured": failed.measured}
            raise VerificationError(sentence(key, **values))
    return found


def _verify(task: _Task) -> Verification:
    """Read the session once and do every check it allows; raises as ``run_verify``."""
    problems: list[ImufieldError] = []
    damage: list[Damage] = []
    navigation, flags = _Navigation(task), TemperatureFlags(task.parameters)
    untried = navigation.is_off
    # Positions alone are all in what is kept of an earlier replay.
    only_positions = untried and not task.parameters.temperature_models
    reading = cached_reading(task.session, task.sha256) if only_positions else None
    chain = Chain(ReadingPlan.of(task.session), (flags.count, navigation.feed))
    if reading is None:
        replay_into(chain, task.session, damage)
    with naming_damage(task.session, damage):
        left_out = _left_out(task, chain, reading, problems)
        navigated = navigation.finish()
        # A session of positions is named as such: where the navigation stopped says nothing.
        may_explain = navigated is None and left_out is not None and not task.wants_navigation
        is_explained = untried or (may_explain and left_out is not None and _shows_positions(left_out))
        if navigation.problem is not None and not is_explained:
            problems.append(navigation.problem)
        if left_out is None and navigated is None:
            # Without either there is a problem at least. A wrong unit, or gaps, cause the other problems, too.
            problems.sort(key=lambda error: error.reason not in (Reason.GRAVITY, Reason.DAMAGED))
            say_each((error.message for error in problems[1:]), err=True)
            raise problems[0]
    parameters = task.parameters
    # With requirements the last of them is an objection.
    about_file = (parameters.edited_note, parameters.gyroscope_note, "" if task.limits else parameters.verdict_note)
    found = () if left_out is None else (*_gravity_notes(task, left_out), *_instrument_notes(task))
    why_not = "verify.turned" if parameters.gyroscope_is_complete else "verify.no_gyroscope"
    why = (sentence(why_not, path=parameters.path, least_s=task.options.align_s + SHORTEST_S),) if is_explained else ()
    read = (*(entry.what for entry in damage), *(error.message for error in problems), *why)
    return Verification(
        parameters=parameters,
        session=task.session.name,
        left_out=left_out,
        navigation=navigated,
        requirements=judge(task.limits, left_out, navigated),
        notes=(*filter(None, about_file), *(chain if reading is None else reading).notes, *flags.notes(), *found, *read),
        has_preset=task.preset is not None,
    )


def _left_out(task: _Task, chain: Chain, reading: Reading | None, problems: list[ImufieldError]) -> LeftOutPositions | None:
    """Check the positions; what stands in the way goes to ``problems``, except where it is the user's mistake."""
    calibration = task.parameters.calibration
    protocol = chain.protocol if reading is None else session_protocol(task.session)
    try:
        for parameters in filter(None, (task.parameters, task.preset)):
            # For other raw units they are refused, as applying them would; without a protocol there is no sample.
            if protocol is not None:
                parameters.check_unit("accelerometer", protocol.units.accelerometer_rate_unit)
        observations = _observations_of(chain) if reading is None else reading.observations
        before = _before_accelerometer(task, protocol)
        if not task.is_its_own:
            # Its own positions were measured where the parameters hold; others may come from the cold.
            observations = task.parameters.observed_at_reference(observations)
            grade = task.parameters.context.instrument.grade
            return check_positions(calibration, observations, task.gravity, before, grade=grade)
        not_used = [table["name"] for table in task.parameters.document["position"] if not table["used"]]
        observations, _ = leave_out(observations, not_used)
        # Predicting positions from the others says nothing of parameters that did not come from these.
        changed = contradiction(calibration, observations, before)
        return changed or cross_validate(calibration, observations, task.options.hold_out, before)
    except CalibrationError as error:
        if task.options.hold_out is not None or "residual-ug" in task.limits:
            raise
        problems.append(error)
        return None


def _shows_positions(found: LeftOutPositions) -> bool:
    """Whether two positions at least differ from the first, and from that turned over: a standstill may be tipped once."""
    return int(np.count_nonzero(np.abs(found.up @ found.up[0]) < np.cos(np.radians(TURNED_DEG)))) > 1


def _observations_of(chain: Chain) -> Observations:
    """Return the observations of a replay; raise ``CalibrationError`` with the last refusal where every still was refused."""
    if chain.guide is not None:
        return chain.observations()
    found = chain.still_intervals()
    if found.refused and not len(found.observations):
        _, refusal = found.refused[-1]
        reason = Reason.GRAVITY if refusal.reason is RefusalCode.GRAVITY else Reason.TOO_FEW
        raise CalibrationError(sentence("verify.refused", words=refusal.words.removesuffix("."), remedy=refusal.remedy), reason)
    return found.observations


def _gravity_notes(task: _Task, found: LeftOutPositions) -> Iterator[str]:
    """Yield what it looks like when the axes agree with one another and not with gravity."""
    residual = found.residual_m_s2
    one_sign = bool(np.all(residual > 0) or np.all(residual < 0))
    # Of data that the parameters come from, or of residuals no larger than forecast, the sign says nothing of gravity.
    if found.as_forecast or found.is_own or not one_sign or len(residual) < FEWEST_OF_ONE_SIGN:
        return
    own, here = task.parameters.calibration.gravity, task.gravity
    yield sentence("verify.one_sign", mean_ug=residual.mean() / MICRO_G_M_S2, own=own, here=here)


def _instrument_notes(task: _Task) -> Iterator[str]:
    """Yield that nothing shows whether session and parameters are of one instrument, where that is so."""
    if note := task.parameters.instrument_note(task.session.record.instrument, lambda: task.sha256):
        yield note


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

    def __init__(self, task: _Task) -> None:
        self._task = task
        self.problem: ImufieldError | None = None
        self._check: StaticNavigation | None = None
        # A session that is guided, or was solved, is one of positions; without a gyroscope there is no navigation either. Who
        # wants it has to say so.
        is_of_positions = task.session.record.scheme is not None or task.is_its_own
        is_possible = not is_of_positions and task.parameters.gyroscope_is_complete
        self.is_off = not (is_possible or task.wants_navigation)

    def feed(self, samples: Samples) -> None:
        if self.is_off:
            return
        try:
            if self._check is None:
                self._check = self._start()
            self._check.feed(samples)
        except ImufieldError as error:
            self._give_up(error)

    def finish(self) -> NavigationResult | None:
        if self.is_off or self._check is None:
            return None
        try:
            return self._check.finish(self._task.parameters.calibration)
        except ImufieldError as error:
            self._give_up(error)
            return None

    def _give_up(self, error: ImufieldError) -> None:
        # Parameters in other units are wrong for any check; all else stands in the way of this one, which misses its limits.
        is_missing = isinstance(error, UsageError) and self._task.wants_navigation
        if self._task.asks_for_navigation or is_missing or isinstance(error, ParameterFileError):
            raise error
        self.problem = error
        self.is_off = True

    def _start(self) -> StaticNavigation:
        task, options = self._task, self._task.options
        if task.latitude_deg is None:
            raise UsageError(sentence("verify.no_latitude"))
        if not task.parameters.gyroscope_is_complete:
            raise ParameterFileError(sentence("verify.no_gyroscope", path=task.parameters.path), Reason.UNITS)
        sigma_rad = np.radians(options.heading_sigma_deg)
        # NaN where it is not given.
        given = np.array([options.turn_on_ug, options.turn_on_deg_per_h], dtype=float)
        turn_on = np.repeat(given * [MICRO_G_M_S2, DEG_PER_HOUR_RAD_S], 3)
        noise, instability = task.parameters.context.noise, None
        if noise is not None:
            instability = np.concatenate([noise.accelerometer_bias_instability_m_s2, noise.gyroscope_bias_instability_rad_s])
        settings = CheckSettings(
            latitude_deg=task.latitude_deg,
            height_m=task.gravity.height_m or 0.0,
            gravity_m_s2=task.gravity.gravity_m_s2,
            align_s=options.align_s,
            turned=options.turned,
            heading=None if options.heading_deg is None else Heading(np.radians(options.heading_deg), sigma_rad),
            turn_on=turn_on,
            # A figure that was never seen is NaN, and a forecast from five axes would be too good.
            instability=instability if instability is not None and np.isfinite(instability).all() else None,
            seed=options.seed,
        )
        # Held against what the instrument had until now: its earlier parameters, or what its maker says.
        preset = task.preset
        before: Apply | None = preset.apply if preset is not None and preset.gyroscope_is_complete else _nominal(task)
        after: dict[str, Apply] = {AFTER: task.parameters.apply}
        return StaticNavigation(after if before is None else {BEFORE: before, **after}, settings)


def _nominal(task: _Task) -> Apply | None:
    """Return the instrument's own output with nothing but its nominal scale; None where only the maker knows that."""
    protocol = session_protocol(task.session)
    accelerometer, scale = _before_accelerometer(task, protocol), protocol.nominal.gyroscope_scale
    gyroscope = task.parameters.calibration.gyroscope
    if accelerometer is None or scale is None or gyroscope is None:
        return None
    # As for the accelerometer: only the parameters know how the axes are wired.
    signed = np.abs(scale) * np.sign(gyroscope.parameters.scale)
    none = np.zeros((3, 3))
    plain = GyroscopeParameters(signed, none, np.zeros(3), none, raw_zero=gyroscope.parameters.raw_zero)

    def apply(samples: Samples) -> Corrected:
        force = correct_accelerometer(accelerometer, samples.accelerometer_rate())
        return Corrected(samples.time_s, force, correct_gyroscope(plain, samples.gyroscope_rate()))

    return apply
