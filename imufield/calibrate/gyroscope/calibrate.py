"""Calibrate a gyroscope with whatever the session holds: the one call behind the gyroscope half of ``imufield solve``.

Paths, all in one weighted fit with one covariance:

a   static bias: the still means, Earth rate accounted for
b   static norm: for instruments that see the Earth turn and a session without moves (``gyroscope_static``)
c   moves between still positions, against gravity
d   whole turns by hand: rolled ones are moves, those about the vertical close against a stop
e   turntable rates, both ways

The model "auto" keeps the g-sensitivity G where an F test on its nine entries together says 95 %; where it does not, the
best guess of what it hides goes into the covariance, as for the accelerometer's quadratic term.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from imufield.calibrate.gyroscope.fit import EarthKnowledge, JointFit, fit_jointly
from imufield.calibrate.gyroscope.model import VERTICAL, GyroscopeData, chains_of, no_table
from imufield.calibrate.gyroscope.move_integration import INVERSE, PARAMETERS, SENSITIVITY, centre, rough_inverse
from imufield.calibrate.gyroscope.moves import Moves
from imufield.calibrate.gyroscope.noise import ForceErrors, accelerometer_force, force_errors
from imufield.calibrate.gyroscope.report import (
    Described,
    GyroscopeResult,
    StaticNorm,
    describe,
    static_norm_result,
    static_result,
)
from imufield.calibrate.gyroscope.sight import Sight, look
from imufield.calibrate.gyroscope.static_bias import static_bias
from imufield.calibrate.gyroscope.static_norm import (
    StaticData,
    StaticFree,
    fit_static,
    latitude_words,
    sees_earth,
    static_columns,
    static_start,
)
from imufield.calibrate.gyroscope.turntable import TurntableRun, pair_runs
from imufield.calibrate.gyroscope.whole_turns import Stop, find_stops, whole_stops
from imufield.calibrate.model.models import recover
from imufield.calibrate.model.observations import Observations
from imufield.calibrate.model.result import Calibration, GyroscopeParameters
from imufield.calibrate.model.uncertainty import f_limit_95, told_apart
from imufield.errors import CalibrationError, Reason, counted
from imufield.samples import FloatArray

GyroscopeModel = Literal["auto", "basic", "g-sensitive"]
FEWEST_STILLS = 2
"""One alone says nothing about its scatter."""
BASIC = np.arange(12)
FULL = np.arange(PARAMETERS)
# The preset's scale is not believed where the rough one differs by more than this factor: the raw unit is another.
_WRONG_START = 3.0
_MOVED = 0.05  # Share of all turning that an axis must have to be compared.
# Of the output at rest: more than sums of equal numbers differ by, and less than the last bit of any instrument.
_CONSTANT = 1e-9
_NOISE_ONLY = 3.0  # Turns of the slots beyond what noise gives; a hand that turns a unit is hundreds of times beyond.
_TURNED = 0.98  # Cosine of 11 deg between the directions of gravity before and after a move.


@dataclass(frozen=True, slots=True, kw_only=True)
class GyroscopeInput:
    """What a session knows about its gyroscope.

    Attributes
    ----------
    observations : Observations
        The stills, the same that ``calibration`` came from, and after them ``rests`` more.
    moves : Moves
        Between these stills (``MoveCollector``), rows of ``observations``.
    calibration : Calibration
        Of the accelerometer; its body frame and gauge are the gyroscope's.
    latitude_deg : float, optional
    preset : GyroscopeParameters, optional
        In force before, in the body frame of the calibration.
    nominal_scale : float, optional
        Raw unit per rad/s, from the driver.
    stops : sequence of Stop
        Whole turns about the vertical, against a stop.
    turntable : sequence of TurntableRun
    static_free : {"bias", "all"}
        What the static norm path fits.
    rests : int
        Stills between whole turns, which had no say in ``calibration``.
    """

    observations: Observations
    moves: Moves
    calibration: Calibration
    latitude_deg: float | None = None
    preset: GyroscopeParameters | None = None
    nominal_scale: float | None = None
    stops: Sequence[Stop] = ()
    turntable: Sequence[TurntableRun] = ()
    static_free: StaticFree = "bias"
    rests: int = 0


def calibrate_gyroscope(given: GyroscopeInput, model: GyroscopeModel = "auto") -> GyroscopeResult:
    """Calibrate the gyroscope by every path the session allows.

    Parameters
    ----------
    given : GyroscopeInput
    model : {"auto", "basic", "g-sensitive"}
        Without or with the g-sensitivity G; "auto" keeps it where it proves itself.

    Returns
    -------
    GyroscopeResult
        ``calibration`` has scale (raw unit per rad/s), misalignment (rad), bias (raw unit) and their sigmas;
        ``join`` puts it into the calibration of the accelerometer.

    Raises
    ------
    CalibrationError
        If the stills have no gyroscope output, or the moves contradict the accelerometer's handedness.
    UsageError
        If a stop belongs to no move.
    """
    there: NDArray[np.bool_] = np.asarray(np.isfinite(given.observations.gyroscope_mean_raw).all(axis=1))
    if there.sum() < FEWEST_STILLS:
        raise CalibrationError(
            f"{int(there.sum())} still positions have a gyroscope mean, {FEWEST_STILLS} are needed; record the gyroscope too",
            Reason.TOO_FEW,
            positions=int(there.sum()),
        )
    if not there.all():
        raise _half_there(given, there)
    if not len(given.moves) and not given.turntable:
        return _static(given)
    data = make_data(given)
    _refuse_dead(given, data)
    errors = force_errors(given.observations, given.calibration, given.rests)
    earth = EarthKnowledge.at(given.latitude_deg)
    start, sight = _start(given, data, errors)
    data, refused = _with_stops(given, data, errors, start, sight=sight, earth=earth)
    chosen = _choose(data, errors, start, sight, earth=earth, model=model)
    words = (*chosen.words, *refused, *_check_latitude(given, data, errors, chosen))
    return describe(
        Described(
            given=given,
            data=data,
            fit=chosen.fit,
            start=start,
            sight=sight,
            fit_g=chosen.fit_g,
            doubt=chosen.doubt,
            words=words,
            earth=earth,
        )
    )


def make_data(given: GyroscopeInput) -> GyroscopeData:
    """Return stills and moves with the output at rest taken off."""
    observations, moves = given.observations, given.moves
    parameters = given.calibration.accelerometer
    rest = observations.gyroscope_mean_raw.mean(axis=0)
    covariance = observations.gyroscope_covariance_raw
    density = np.sqrt(np.median(np.diagonal(covariance, 0, 1, 2) * observations.duration_s[:, None], axis=0))
    duration = np.maximum(moves.slots.duration_s, 1e-9)[:, None]
    return GyroscopeData(
        rate_raw=observations.gyroscope_mean_raw - rest,
        rate_covariance=covariance,
        force=recover(parameters, observations.mean_raw),
        slots=centre(moves, rest, accelerometer_force(parameters, moves.slots.force / duration)),
        before=moves.before,
        after=moves.after,
        chain=chains_of(len(observations), moves.before, moves.after),
        noise_density_raw=density,
        rest_raw=rest,
        time_s=observations.start_s + observations.duration_s / 2,
        table=pair_runs(given.turntable) if given.turntable else no_table(),
    )


def _refuse_dead(given: GyroscopeInput, data: GyroscopeData) -> None:
    """Refuse an axis whose output is the same number in all moves and at rest, which no rotating gyroscope gives."""
    if not len(given.moves):
        return
    rest = np.abs(given.observations.gyroscope_mean_raw.mean(axis=0))
    largest = np.abs(data.slots.turn).max(axis=0, initial=0.0)
    dead = largest <= _CONSTANT * np.maximum(rest, np.finfo(float).tiny)
    if not dead.any():
        _refuse_noise(given, data)
        return
    axes = ", ".join(axis for axis, is_dead in zip("xyz", dead, strict=True) if is_dead)
    raise CalibrationError(
        f"the gyroscope shows no rotation on {axes}: its output is the same number at rest and during all "
        f"{counted(len(given.moves), 'move')}; check that it is switched on, and the columns or fields it is read from",
        Reason.UNOBSERVABLE,
        axes=axes,
    )


def _refuse_noise(given: GyroscopeInput, data: GyroscopeData) -> None:
    """Refuse a gyroscope that shows nothing but its noise at rest while gravity shows that the unit was turned."""
    noise = data.noise_density_raw * np.sqrt(data.slots.duration_s.sum())
    noisy = np.sqrt(np.sum(data.slots.turn**2, axis=0)) <= _NOISE_ONLY * noise
    up = data.force / np.linalg.norm(data.force, axis=1)[:, None]
    along = np.sum(up[data.before] * up[data.after], axis=1)
    if not noisy.all() or along.min(initial=1.0) > _TURNED:
        return
    raise CalibrationError(
        "the gyroscope shows no rotation on any axis: during all "
        f"{counted(len(given.moves), 'move')} it has the noise that it has at rest, although gravity shows that the unit was "
        f"turned by up to {np.degrees(np.arccos(along.min())):.0f} deg; check the columns or fields it is read from",
        Reason.UNOBSERVABLE,
        axes="x, y, z",
    )


def _half_there(given: GyroscopeInput, there: NDArray[np.bool_]) -> CalibrationError:
    return CalibrationError(
        f"position {given.observations.name[int(np.flatnonzero(~there)[0])]} has no gyroscope mean although others have one; "
        "remove or retake it",
        Reason.NOT_FINITE,
        positions=int((~there).sum()),
    )


def _static(given: GyroscopeInput) -> GyroscopeResult:
    before, observations = given.preset, given.observations
    dropped = tuple(one.sentence for one in given.moves.dropped)
    A = _preset_inverse(given)
    if A is not None and given.latitude_deg is not None and sees_earth(observations.gyroscope_covariance_raw, A):
        rest = observations.gyroscope_mean_raw.mean(axis=0)
        force = recover(given.calibration.accelerometer, observations.mean_raw)
        up = force / np.linalg.norm(force, axis=1)[:, None]
        middle_s = observations.start_s + observations.duration_s / 2
        data = StaticData(observations.gyroscope_mean_raw - rest, observations.gyroscope_covariance_raw, up, middle_s)
        fitted = fit_static(data, A, given.latitude_deg, given.static_free)
        start = static_start(data, A, given.latitude_deg)
        return static_norm_result(
            StaticNorm(
                given=given, data=data, start=start, columns=static_columns(given.static_free), fitted=fitted, rest_raw=rest
            )
        )
    gyroscope = static_bias(
        given.observations,
        given.nominal_scale if before is None else before.scale,
        misalignment_rad=None if before is None else before.misalignment_rad,
        up=recover(given.calibration.accelerometer, given.observations.mean_raw),
        latitude_deg=given.latitude_deg,
    )
    return static_result(gyroscope, dropped)


def _start(given: GyroscopeInput, data: GyroscopeData, errors: ForceErrors) -> tuple[FloatArray, Sight]:
    """Return where to start, holding the preset's values of what cannot be seen, and what can be seen."""
    preset = _preset_inverse(given)
    rough = _rough(data)
    p = np.zeros(data.parameters)
    begin = rough if preset is None else preset
    if begin is None:
        raise CalibrationError(
            "nothing says what the scale of the gyroscope is: there are no moves, no preset and no driver; give a preset",
            Reason.UNOBSERVABLE,
        )
    p[INVERSE] = begin.ravel()
    if preset is not None and rough is not None:
        _refuse_foreign(data, rough, preset)
    elif np.linalg.det(begin) <= 0:
        raise _handedness()
    sight = look(p, data, errors, known=preset is not None)
    return p, sight


def _preset_inverse(given: GyroscopeInput) -> FloatArray | None:
    if given.preset is not None and np.isfinite(given.preset.scale).all():
        M: FloatArray = given.preset.scale[:, None] * (np.eye(3) + given.preset.misalignment_rad)
        return np.asarray(np.linalg.inv(M), dtype=np.float64)
    if given.nominal_scale is not None:
        return np.eye(3) / given.nominal_scale
    unit = given.observations.units.gyroscope_rate_unit
    return np.eye(3) if unit == "rad/s" else None


def _rough(data: GyroscopeData) -> FloatArray | None:
    if not len(data.before):
        return None
    return rough_inverse(data.slots)


def _refuse_foreign(data: GyroscopeData, rough: FloatArray, preset: FloatArray) -> None:
    """Refuse a preset that turns clearly slower, faster or the other way than the accelerometer sees."""
    expected, seen = data.slots.turn @ preset.T, data.slots.turn @ rough.T
    energy = np.sum(expected**2, axis=0)
    moved = energy > _MOVED * energy.sum()
    ratio = np.sum(expected * seen, axis=0)[moved] / energy[moved]
    if np.count_nonzero(ratio < -1 / _WRONG_START) % 2:
        raise _handedness()
    if np.any(ratio < 1 / _WRONG_START) or np.any(ratio > _WRONG_START):
        raise CalibrationError(
            f"during the moves the unit turns {', '.join(f'{value:.3g}' for value in ratio)} times as fast as the gyroscope "
            f"says with the preset or the driver's scale (1/{_WRONG_START:g} to {_WRONG_START:g} is accepted); check unit, "
            "range and the order of the axes",
            Reason.UNITS,
            ratio=ratio.tolist(),
        )


def _handedness() -> CalibrationError:
    return CalibrationError(
        "gyroscope and accelerometer have different handedness: during the moves an axis of the gyroscope turns the other way; "
        "reverse one axis of one of them in the protocol",
        Reason.HANDEDNESS,
    )


def _with_stops(
    given: GyroscopeInput, data: GyroscopeData, errors: ForceErrors, start: FloatArray, *, sight: Sight, earth: EarthKnowledge
) -> tuple[GyroscopeData, tuple[str, ...]]:
    """Return the data with the turns against a stop that did close, and sentences about those that did not."""
    if not given.stops:
        return data, ()
    moves, sigma = find_stops(given.stops, given.moves.start_s, given.moves.end_s)
    first = fit_jointly(data, errors, start, sight.free(FULL if sight.sensitivity else BASIC), earth=earth)
    whole, missed = whole_stops(first.evaluation, data, moves, sigma)
    sentences = tuple(
        f"the turn against a stop at {given.moves.start_s[moves[k]]:.1f} s was not whole: it misses by "
        f"{np.degrees(missed[k]):+.2f} deg and is used as a move only; repeat it"
        for k in np.flatnonzero(~whole)
    )
    return replace(data, stops=moves[whole], stop_sigma_rad=sigma[whole]), sentences


def _check_latitude(given: GyroscopeInput, data: GyroscopeData, errors: ForceErrors, chosen: _Chosen) -> tuple[str, ...]:
    """Return what the specific force times the Earth's rate says of the latitude.

    With a g-sensitivity fitted it says nothing: the vertical Earth rate is an exact alias of G = (rate sin(latitude) / g) I.
    """
    if given.latitude_deg is None or not chosen.fit.heading_fitted or chosen.fit_g:
        return ()
    free = np.array([k for k in chosen.fit.free if k < PARAMETERS])
    loose = fit_jointly(data, errors, chosen.fit.p, free, earth=EarthKnowledge.at(None), scatter=chosen.fit.scatter)
    place = int(np.flatnonzero(loose.free == VERTICAL)[0])
    return latitude_words(given.latitude_deg, float(loose.p[VERTICAL]), float(np.sqrt(loose.covariance[place, place])))


@dataclass(frozen=True, slots=True)
class _Chosen:
    fit: JointFit
    fit_g: bool
    doubt: FloatArray
    words: tuple[str, ...]


def _choose(
    data: GyroscopeData, errors: ForceErrors, start: FloatArray, sight: Sight, *, earth: EarthKnowledge, model: GyroscopeModel
) -> _Chosen:
    nothing = np.zeros(data.parameters)
    if model == "basic" or not sight.sensitivity:
        if model == "g-sensitive":
            raise CalibrationError(
                "these positions cannot show the g-sensitivity of the gyroscope: the stills do not point every way; add "
                "positions, or use the basic model",
                Reason.UNOBSERVABLE,
            )
        why = "as asked" if model == "basic" else "because the stills do not show it"
        words = f"g-sensitivity is left out, {why}"
        return _Chosen(fit_jointly(data, errors, start, sight.free(BASIC), earth=earth), False, nothing, (words,))
    full = fit_jointly(data, errors, start, sight.free(FULL), earth=earth)
    if model == "g-sensitive":
        return _Chosen(full, True, nothing, ("g-sensitivity is fitted, as asked",))
    F, limit = _significance(full)
    compared = "F = {}, limit {}".format(*told_apart(F, limit))
    if limit < F:
        return _Chosen(full, True, nothing, (f"g-sensitivity is kept: it is significant ({compared})",))
    basic = fit_jointly(data, errors, start, sight.free(BASIC), earth=earth)
    doubt = np.sqrt(max(0.0, 1 - 1 / F)) * (full.p - basic.p)
    doubt[SENSITIVITY] = 0.0
    words = f"g-sensitivity is left out: it is not significant ({compared})"
    return _Chosen(basic, False, doubt, (words,))


def _significance(full: JointFit) -> tuple[float, float]:
    """Return the F statistic of the g-sensitivity against zero, and its 95 % limit."""
    places = np.flatnonzero((full.free >= SENSITIVITY.start) & (full.free < SENSITIVITY.stop))
    values = full.p[full.free[places]]
    F = float(values @ np.linalg.pinv(full.covariance[np.ix_(places, places)], hermitian=True) @ values) / len(places)
    return max(F, np.finfo(float).tiny), f_limit_95(len(places), full.degrees_of_freedom)
