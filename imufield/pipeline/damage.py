"""What a damaged or empty recording means for the command that reads it: the error, and the sentence that names the damage."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from imufield.acquire.decode.statistics import DecoderStatistics, without_samples
from imufield.acquire.protocol.protocol import Protocol
from imufield.acquire.recording.reader import Damage
from imufield.acquire.recording.session import Session
from imufield.dataclass import replace
from imufield.errors import CalibrationError, Reason, RecordingError
from imufield.sentences import Sentences

sentence = Sentences(__package__)

NAMED = 2  # Places of damage that one sentence names; a recording with many holes would fill a page.
_BY_LOSS = (Reason.TOO_FEW, Reason.UNOBSERVABLE)  # What a recording with all its bytes might have been enough for.


def require_samples(
    session: Session, protocol: Protocol | None, statistics: Sequence[DecoderStatistics], damage: Sequence[Damage]
) -> None:
    """Refuse a session that was read to its end without a single sample; ``protocol`` is that of its last part.

    Raises
    ------
    RecordingError
        Naming its files, what is wrong with them and what is lost.
    """
    if any(part.samples for part in statistics):
        return
    # Four causes, each with a remedy of its own: the files are gone, hold other frames, are of another instrument, or cut.
    total = sum(part.bytes_total for part in statistics)
    understood = protocol is not None and any(part.is_understood for part in statistics)
    empty = sentence(
        "damage.gone"
        if not session.parts
        else "damage.other_frames"
        if understood
        else "damage.foreign"
        if total
        else "damage.lost",
        why="" if protocol is None else without_samples(protocol, statistics),
        folder=str(session.folder),
        bytes=total,
        frames_bad_checksum=sum(part.frames_bad_checksum for part in statistics),
        names=[path.name for path in session.parts],
        damage=_damage_clause(damage),
    )
    raise RecordingError(empty, Reason.BAD_DATA if total and not damage else Reason.DAMAGED)


def _damage_clause(damage: Sequence[Damage]) -> str:
    """Return ", FILE is cut off ..., ..." to be put into a sentence; empty without damage."""
    named = [entry.what.rstrip(".") for entry in damage[:NAMED]]
    if len(damage) > NAMED:
        named.append(f"and {len(damage) - NAMED} more like these")
    return "".join(f", {what}" for what in named)


def name_recording(damage: list[Damage], under_way: Path | None) -> None:
    """Name the missing end of the part that was being recorded as what it is."""
    for place, entry in enumerate(damage):
        if entry.torn_end and entry.path == under_way:
            damage[place] = replace(entry, what=sentence("damage.goes_on", path=entry.path))


@contextmanager
def naming_damage(session: Session, damage: Sequence[Damage]) -> Iterator[None]:
    """Let no calibration fail without a word of the damage of its recording.

    Raises
    ------
    RecordingError
        Instead of a CalibrationError where bytes are missing that may be what it lacks.
    CalibrationError
        Otherwise: the same with the damage named.
    """
    try:
        yield
    except CalibrationError as error:
        if not damage:
            raise
        said = {"damage": _damage_clause(damage).removeprefix(", "), "error": error.message}
        # A torn end is also what a program leaves that is killed: of its last part in a finished session bytes went later.
        torn = session.parts[-1:] if session.finished else []
        lost = any(not entry.torn_end or entry.path in torn for entry in damage)
        if error.reason in _BY_LOSS and lost:
            not_enough = sentence("damage.not_enough", folder=session.folder, **said)
            raise RecordingError(not_enough, Reason.DAMAGED, **error.values) from error
        raise CalibrationError(sentence("damage.beside", **said), error.reason, **error.values) from error
