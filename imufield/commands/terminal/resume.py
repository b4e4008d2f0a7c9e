"""Which session a capture goes on with, and what it takes over from it."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path

from imufield.acquire.instrument.connected import Connected, ConnectOptions
from imufield.acquire.recording.session import Session
from imufield.acquire.recording.session_record import GuideRecord
from imufield.acquire.registry import driver_names
from imufield.commands.terminal.questions import confirm
from imufield.dataclass import replace
from imufield.errors import Reason, RecordingError, UsageError
from imufield.files import Origin
from imufield.guide.lead.guide import Guide
from imufield.guide.positions import scheme
from imufield.pipeline.chain import Chain, ReadingPlan, replay_into
from imufield.sentences import Sentences

sentence = Sentences(__package__)

_IDENTITY = ("driver", "serial_number")
_ADDRESSES = ("socket://", "rfc2217://")
# What a session keeps of the options of the guide: the option and how its value is said.
_KEPT = {
    "hold_s": ("--hold-s", "holds of {:g} s"),
    "target_bias_ug": ("--target-bias-ug", "a bias wanted to {:g} ug"),
    "target_scale_ppm": ("--target-scale-ppm", "a scale wanted to {:g} ppm"),
    "rotations": ("--rotations", "turns about a {} axis"),
    "earlier_scale_raw": ("--preset", "an earlier scale of {:.9g} (raw)"),
}


def find_unfinished(
    folder: Path | None, root: Path, *, resume: bool, interactive: bool, retake: tuple[str, ...] = ()
) -> Session | None:
    """Return the session to go on with, or None for a new one.

    Parameters
    ----------
    folder : Path or None
        What ``--session`` names; None is the newest below ``root`` that is unfinished, or of any where positions are retaken.
    root : Path
    resume : bool
        Whether ``--resume`` was given.
    interactive : bool
        Whether somebody can be asked.
    retake : tuple of str
        Positions to be measured again, for which a finished session goes on.

    Raises
    ------
    RecordingError
        If ``folder`` holds an unfinished session and nobody said that it should go on, or one that cannot be read.
    UsageError
        If there is nothing to resume, ``folder`` is finished and nothing left to measure, or a position was never
        measured or is none of its plan.
    """
    if retake and not resume:
        raise UsageError(sentence("resume.retake_alone"))
    if folder is None and resume:
        folder = _newest(root, unfinished=not retake)
    if folder is None:
        return None
    if not (folder / "session.toml").exists():
        if resume:
            raise UsageError(sentence("resume.no_session", folder=folder))
        return None
    session = Session.open(folder)
    if session.finished:
        _check_goes_on(session, resume=resume, retake=retake)
        return session
    if not session.record.scheme:
        raise UsageError(sentence("resume.no_guide", folder=session.folder))
    _check_planned(session, retake)
    if not resume and not (interactive and confirm(f"Go on with the unfinished session {session.folder}?")):
        raise RecordingError(sentence("resume.unfinished", folder=str(session.folder)), Reason.UNFINISHED)
    return session


def _check_planned(session: Session, retake: tuple[str, ...]) -> None:
    planned = [name for name, _ in _positions(str(ReadingPlan.of(session).scheme), Origin.INSIDE)]
    for name in retake:
        if name not in planned:
            raise UsageError(sentence("resume.not_planned", folder=session.folder, name=name, planned=planned))


def _check_goes_on(session: Session, *, resume: bool, retake: tuple[str, ...]) -> None:
    """Raise ``UsageError`` where a finished session has nothing left to measure, or lacks a position to be measured again."""
    guide = _guide_of(session)
    early = guide is not None and guide.finished_early
    if guide is None or not resume or not (early or retake):
        key = "resume.unguided" if guide is None else "resume.finished_early" if early else "resume.finished"
        raise UsageError(sentence(key, folder=session.folder))
    measured = guide.snapshot().accepted
    for name in retake:
        if name not in measured:
            raise UsageError(sentence("resume.not_measured", folder=session.folder, name=name, measured=measured))


def _guide_of(session: Session) -> Guide | None:
    """Return the guide as a session left it, which only a replay tells; None for a session without one."""
    if session.record.scheme is None:
        return None
    chain = Chain(ReadingPlan.of(session))
    replay_into(chain, session, [])
    return chain.guide


def _newest(root: Path, *, unfinished: bool) -> Path:
    for folder in Session.newest_first(root):
        # A damaged session.toml of another session is no reason not to go on with this one.
        with suppress(RecordingError):
            session = Session.open(folder)
            if session.record.scheme and not (unfinished and session.finished):
                return session.folder
    raise UsageError(sentence("resume.none_unfinished" if unfinished else "resume.none", root=root))


def check_plan(session: Session, scheme_name: str | None, asked: GuideRecord) -> None:
    """Refuse a plan that is not the session's: it was chosen when the session began, and a replay follows it from the start.

    Parameters
    ----------
    session : Session
    scheme_name : str or None
    asked : GuideRecord
        What was given of the options that the session keeps.

    Raises
    ------
    UsageError
        If they differ.
    """
    planned = str(ReadingPlan.of(session).scheme)
    # By what they ask for and not by name: a copy of a file of positions is the same plan.
    if scheme_name is not None and _positions(scheme_name, Origin.TYPED) != _positions(planned, Origin.INSIDE):
        raise UsageError(sentence("resume.other_positions", folder=session.folder, planned=planned, asked=scheme_name))
    for name, (option, words) in _KEPT.items():
        wanted, begun = getattr(asked, name), getattr(session.record.guide, name)
        if wanted is not None and wanted != begun:
            now, before = words.format(wanted), "" if begun is None else words.format(begun)
            key = "resume.begun_without" if begun is None else "resume.begun_otherwise"
            raise UsageError(sentence(key, folder=session.folder, option=option, now=now, before=before))


def _positions(name: str, origin: Origin) -> list[tuple[str, list[float]]]:
    return [(position.name, position.direction.tolist()) for position in scheme(name, origin).positions]


def connect_as_before(options: ConnectOptions, session: Session) -> ConnectOptions:
    """Return the options with port or bus, bit rate, driver and settings of the session where they are not given."""
    record, link = session.record, session.record.link
    driver, text = options.driver, None
    if driver is None and options.protocol is None and options.dbc is None:
        if record.instrument.driver in driver_names():
            driver = record.instrument.driver
        else:
            # Of a driver that is not installed here, or a file of the user's own, the session holds a copy.
            text = record.protocol.text or None
    given, read = (
        {name: str(setting.value) for name, setting in record.settings.items() if setting.origin == origin}
        for origin in ("given", "read")
    )
    elsewhere = options.port is not None or options.bus is not None
    # Other kinds of pyserial's addresses write files or load code: those a person types.
    if not elsewhere and (link.port or "").partition("://")[1] and not (link.port or "").startswith(_ADDRESSES):
        raise UsageError(sentence("resume.port", folder=session.folder, port=link.port))
    same_place = (options.port, options.bus) == (link.port, link.bus)
    return replace(
        options,
        port=options.port if elsewhere else link.port,
        bus=options.bus if elsewhere else link.bus,
        # At another port the adapter may want another rate, so there it is looked for.
        baud=options.baud or (None if elsewhere and not same_place else link.baud or link.bit_rate),
        driver=driver,
        settings={**(given if options.protocol is None else {}), **options.settings},
        settings_read=read,
        protocol_text=text,
        rate_hz=options.rate_hz or link.rate_hz,
    )


def check_instrument(session: Session, connected: Connected) -> None:
    """Refuse another instrument than the one the session began with.

    Raises
    ------
    RecordingError
        If driver or serial number differ, as far as both are known.
    """
    found = {"driver": connected.driver, **connected.identity}
    # The model is not compared: firmware may call the same unit otherwise.
    for key in _IDENTITY:
        before, now = getattr(session.record.instrument, key), found.get(key)
        if before and now and before != now:
            values = {"what": key.replace("_", " "), "recorded": before, "found": now, "place": connected.link.name}
            raise RecordingError(sentence("resume.other_instrument", folder=session.folder, **values), Reason.FOREIGN)
