"""Sessions of one instrument solved together: read, refused where they cannot be joined, adjusted, and put into one result.

Each session is solved by itself. What is joined are its gauge-free numbers (``deliver/parameters/gauge_free``), which no choice
of the body frame changes, so sessions may come from any gauge; scales count as shares of those of one session.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np

from imufield.acquire.decoded_session import session_protocol
from imufield.acquire.recording.session import SETTINGS_FILE, Session
from imufield.calibrate.model.grades import find_grade
from imufield.calibrate.model.observations import require_named
from imufield.calibrate.model.result import of_session
from imufield.calibrate.sessions.joint import FEWEST, FEWEST_WITHOUT_PRIOR, Joint, SessionNumbers, adjust
from imufield.calibrate.sessions.kinds import kind_of
from imufield.campaign import run_campaign
from imufield.dataclass import dataclass, replace
from imufield.deliver.parameters.file import Parameters
from imufield.deliver.parameters.gauge_free import GaugeFree, unit_of
from imufield.deliver.parameters.joined import JoinedFrom, joined_parameters, numbers_of, prior_scales
from imufield.errors import CalibrationError, ImufieldError, Reason, UsageError
from imufield.pipeline.calibration import SolveSettings
from imufield.pipeline.same_recording import RecordingMarks, without_copies
from imufield.pipeline.site import SiteOptions
from imufield.pipeline.solving import solve_session
from imufield.sentences import Sentences

sentence = Sentences(__package__)

_LARGEST_CHANGE = 0.05  # Of a scale, ten times what the worst instruments do; another range is a factor of two.
_FREE_SETTINGS = ("rate_hz",)  # Of a protocol: what changes no value.


@dataclass(frozen=True, slots=True)
class SolveJob:
    """One session to be solved."""

    session: Session
    settings: SolveSettings
    site: SiteOptions | None


@dataclass(frozen=True, slots=True)
class SolvedSession:
    """One session that was."""

    session: Session
    parameters: Parameters
    numbers: GaugeFree
    marks: RecordingMarks

    @property
    def name(self) -> str:
        """That of the session."""
        return self.session.name

    @property
    def raw_zero(self) -> list[float]:
        """What the biases are counted from: of the accelerometer, then of the gyroscope where there is one."""
        calibration = self.parameters.calibration
        gyroscope = [calibration.gyroscope.parameters.raw_zero] if calibration.gyroscope else []
        return [zero for triad in (calibration.accelerometer.raw_zero, *gyroscope) for zero in triad.tolist()]


def solve_job(job: SolveJob, _rng: np.random.Generator) -> SolvedSession | ImufieldError:
    """Solve one session; the function that workers are sent.

    What refuses it is a result, so that of several the first is told, whichever ended first.
    """
    marks = RecordingMarks()
    try:
        parameters = solve_session(job.session, job.settings, job.site, (marks.feed,))
        return SolvedSession(job.session, parameters, parameters.gauge_free(), marks)
    except ImufieldError as error:
        return error


def sessions_of(serial_number: str, root: Path) -> list[Session]:
    """Return all sessions of an instrument below a folder, the oldest first.

    Raises
    ------
    UsageError
        If there is none.
    """
    found = []
    for path in root.glob(f"*/{SETTINGS_FILE}"):
        try:
            session = Session.open(path.parent)
        except ImufieldError:
            continue  # `imufield sessions` lists it as damaged; whose it is, it does not say
        if session.serial_number == serial_number:
            found.append(session)
    if not found:
        raise UsageError(sentence("together.none_of_serial", serial_number=serial_number, folder=root))
    return sorted(found, key=lambda session: (session.record.recorded or session.record.created, session.name))


def solve_together(
    sessions: Sequence[Session],
    settings: SolveSettings,
    site: SiteOptions | None = None,
    workers: int | None = None,
) -> Parameters:
    """Solve sessions of one instrument together.

    Parameters
    ----------
    sessions : sequence of Session
    settings : SolveSettings
        How each is solved.
    site : SiteOptions, optional
        What was typed of the place of all of them; by default each has its own.
    workers : int, optional
        Processes; default one per core.

    Raises
    ------
    UsageError
        If a setting is for single sessions only.
    CalibrationError
        If fewer than two remain, or they cannot be joined.
    ImufieldError
        As ``solve_session``.
    """
    refuse_of_single(
        {
            "--preset": settings.preset is not None,
            "--model extended": settings.model == "extended",
            "--gauge": settings.gauge not in (None, "lower"),
        }
    )
    _require_two(len(sessions))
    _check_instruments(sessions)
    for session in sessions[1:]:
        _check_protocols(sessions[0], session)
    # In order of time where all have one; else as they were named.
    if all(session.record.recorded for session in sessions):
        sessions = sorted(sessions, key=lambda session: session.record.recorded)
    settings = replace(settings, is_of_several=True)
    every = _solved([SolveJob(session, settings, site) for session in sessions], workers)
    require_named((table["name"] for each in every for table in each.parameters.document["position"]), settings.without)
    # Of copies the most complete counts.
    kept, copies = without_copies(sorted(every, key=lambda each: -len(each.parameters.document["position"])))
    solved = sorted(kept, key=every.index)
    _require_two(len(solved))
    for other in solved[1:]:
        _check_numbers(solved[0], other)
    solved = _with_one_model(solved, settings, site, workers)
    # The one with the most numbers, of several the newest, states what no adjustment changes.
    base = max(reversed(solved), key=lambda each: len(each.numbers.numbers))
    gathered = [numbers_of(each.parameters.calibration, each.numbers, base.numbers) for each in solved]
    grade = base.parameters.context.instrument.grade
    joint = adjust([each.own for each in gathered], prior_scales(find_grade(grade)))
    return joined_parameters(
        JoinedFrom(
            parameters=[each.parameters for each in solved],
            base=solved.index(base),
            shared=[each.shared for each in gathered],
            prior_grade=grade if len(solved) < FEWEST_WITHOUT_PRIOR else "",
            sha256=hashlib.sha256(
                "".join(sorted(each.parameters.context.session.sha256 for each in solved)).encode()
            ).hexdigest(),
        ),
        joint,
        base.numbers,
        warnings=[*_warnings(solved, joint)],
        notes=[*copies, *_notes(solved, joint, [each.own for each in gathered], grade)],
    )


def refuse_of_single(options: Mapping[str, bool]) -> None:
    """Raise ``UsageError`` where an option of single sessions is given."""
    for option, is_given in options.items():
        if is_given:
            raise UsageError(sentence("together.option", option=option))


def _require_two(found: int) -> None:
    if found < FEWEST:
        raise CalibrationError(sentence("together.too_few", found=found, limit=FEWEST), Reason.TOO_FEW)


def _check_instruments(sessions: Sequence[Session]) -> None:
    known = [session for session in sessions if session.serial_number]
    for session in known[1:]:
        if session.serial_number != known[0].serial_number:
            serial_numbers = [known[0].serial_number, session.serial_number]
            names = [known[0].name, session.name]
            raise CalibrationError(sentence("together.instruments", names=names, serial_numbers=serial_numbers), Reason.FOREIGN)


def _solved(jobs: Sequence[SolveJob], workers: int | None) -> list[SolvedSession]:
    """Return the sessions solved; raises as ``solve_session``."""
    solved = []
    for found in run_campaign(solve_job, jobs, seed=0, workers=workers):
        if isinstance(found, ImufieldError):
            raise found
        solved.append(found)
    return solved


def _check_protocols(first: Session, other: Session) -> None:
    """Refuse sessions whose values do not mean the same; raises CalibrationError."""
    names, protocols = [first.name, other.name], [session_protocol(session) for session in (first, other)]
    units = [protocol.units.words for protocol in protocols]
    if units[0] != units[1]:
        raise CalibrationError(sentence("together.units", names=names, units=units), Reason.UNITS)
    settings = [{key: value.value for key, value in protocol.settings.items()} for protocol in protocols]
    for key in sorted(settings[0].keys() | settings[1].keys()):
        values = [each.get(key) for each in settings]
        if key not in _FREE_SETTINGS and values[0] != values[1]:
            raise CalibrationError(sentence("together.setting", names=names, key=key, values=values), Reason.UNITS)
    if protocols[0].samples != protocols[1].samples or protocols[0].can != protocols[1].can:
        raise CalibrationError(sentence("together.axes", names=names), Reason.UNITS)


def _check_numbers(first: SolvedSession, other: SolvedSession) -> None:
    """Refuse sessions whose biases are from different raw zeros, or whose range or signs changed; raises CalibrationError."""
    names, zeros = [first.name, other.name], [each.raw_zero for each in (first, other)]
    # Where one of them has no gyroscope, its zero is compared with nothing.
    if any(one != another for one, another in zip(*zeros, strict=False)):
        raise CalibrationError(sentence("together.setting", names=names, key="zero", values=zeros), Reason.UNITS)
    before = {number.name: number.value for number in first.numbers.numbers}
    for number in other.numbers.numbers:
        change = number.value / before.get(number.name, number.value) - 1 if number.is_scale else 0.0
        if abs(change) > _LARGEST_CHANGE:
            told = {"names": names, "number": number.name, "change": change, "limit": _LARGEST_CHANGE}
            raise CalibrationError(sentence("together.scale", **told), Reason.UNITS)


def _with_one_model(
    solved: list[SolvedSession], settings: SolveSettings, site: SiteOptions | None, workers: int | None
) -> list[SolvedSession]:
    """Return the sessions with every term that one of them shows: a term left out of some would pose as a change."""
    is_quadratic = any(each.parameters.calibration.quadratic_fitted for each in solved)
    is_sensitive = any(_is_sensitive(each.numbers) for each in solved)
    model = "quadratic" if is_quadratic else settings.model
    gyroscope_model = "g-sensitive" if is_sensitive else settings.gyroscope_model
    whole = replace(settings, model=model, gyroscope_model=gyroscope_model)
    lacking = [
        k
        for k, each in enumerate(solved)
        if (is_quadratic and not each.parameters.calibration.quadratic_fitted)
        or (is_sensitive and not _is_sensitive(each.numbers))
    ]
    again = dict(zip(lacking, _solved([SolveJob(solved[k].session, whole, site) for k in lacking], workers), strict=True))
    return [again.get(k, each) for k, each in enumerate(solved)]


def _is_sensitive(numbers: GaugeFree) -> bool:
    return any(kind_of(number.name) == "g-sensitivity" for number in numbers.numbers)


def _warnings(solved: Sequence[SolvedSession], joint: Joint) -> Iterator[str]:
    """Yield what between the sessions keeps the verdict from being good."""
    for number in joint.outlying:
        yield sentence("together.outlying", session=solved[number.session].name, number=number.name, off_sigma=number.off_sigma)
    if joint.differs:
        yield sentence("together.differs")


def _notes(solved: Sequence[SolvedSession], joint: Joint, numbers: Sequence[SessionNumbers], grade: str) -> Iterator[str]:
    """Yield what belongs to the result and lowers no verdict."""
    for each in solved:
        for reason in each.parameters.of_recording:
            yield of_session(each.name, reason)
    unnamed = [each.name for each in solved if not each.session.serial_number]
    if unnamed:
        yield sentence("together.no_serial", names=unnamed)
    if len(solved) < FEWEST_WITHOUT_PRIOR:
        freedom = max((kind.repeatability.freedom for kind in joint.daily.values()), default=0)
        yield sentence("together.few", sessions=len(solved), freedom=freedom, limit=FEWEST_WITHOUT_PRIOR, grade=grade)
    for name in joint.trends:
        values = [float(each.values[each.names.index(name)]) for each in numbers if name in each.names]
        change, unit = values[-1] - values[0], unit_of(name)
        yield sentence("together.trend", number=name, sessions=len(values), change=change, unit=unit)
