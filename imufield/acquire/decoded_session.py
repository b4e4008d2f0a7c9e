"""A recorded session, decoded step by step: its samples, and between them where its parts begin and what was said."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from imufield.acquire.protocol.protocol import Protocol, parse_protocol
from imufield.acquire.recording.reader import Damage, PartStart, RecordedBlock, RecordedEvent, read_blocks, read_session
from imufield.acquire.recording.session import Session
from imufield.acquire.session_decoder import SessionDecoder
from imufield.dataclass import dataclass
from imufield.errors import ProtocolError, RecordingError, SettingError
from imufield.samples import Samples
from imufield.sentences import Sentences

sentence = Sentences(__package__)

UNPLUGGED = "unplugged"
"""Name of a recorded event: the link was lost, and what comes behind it is read anew. Recordings that are older have only what
the guide said of it, ``link_lost``."""

# Of a replay that nobody watches: as much as the decoder works off at once. More would not stay in the cache, and of what comes
# slowly a hundred samples cost as much as one.
_BLOCK_BYTES = 1 << 18
_BLOCK_SPAN_S = 16.0

Items = Iterator[PartStart | RecordedBlock | RecordedEvent]


@dataclass(frozen=True, slots=True)
class Step:
    """What one item of a recording gives.

    Attributes
    ----------
    samples : Samples or None
        At least one.
    item : PartStart, RecordedEvent or None
        What stands behind the samples; None of a block.
    is_anew : bool
        The event is a lost link, behind which the decoder began anew.
    """

    samples: Samples | None
    item: PartStart | RecordedEvent | None = None
    is_anew: bool = False


def session_blocks(session: Session, damage: list[Damage]) -> Items:
    """Read a session as fast as possible; what could not be read is added to ``damage``."""
    return read_blocks(session, damage, block_bytes=_BLOCK_BYTES, span_s=_BLOCK_SPAN_S)


def decoded(items: Items, session: Session, decoder: SessionDecoder) -> Iterator[Step]:
    """Decode the items of ``read_blocks``; what the decoder holds back at their end stays in it.

    Raises
    ------
    RecordingError, ProtocolError
        If they cannot be read.
    """
    for item in items:
        if isinstance(item, PartStart):
            yield Step(decoder.start_part(recorded_protocol(item.metadata, session)), item)
        elif isinstance(item, RecordedBlock):
            yield Step(decoder.feed(item))
        else:
            # A decoder that has read nothing is a new one: a loss that is told twice, as recordings do, is one.
            is_anew = item.event.get("event") in (UNPLUGGED, "link_lost") and decoder.has_read
            yield Step(decoder.start_anew() if is_anew else None, item, is_anew)


def recorded_protocol(metadata: Mapping[str, object], session: Session) -> Protocol:
    """Return the protocol a part was recorded with; the session's own where the part's start is damaged.

    Raises
    ------
    RecordingError
        If neither holds one.
    """
    # The part goes first: session.toml can be edited, and the bytes are what their part says.
    text = metadata.get("protocol_text") or session.record.protocol.text
    if not isinstance(text, str) or not text:
        raise RecordingError(sentence("decoded_session.no_protocol", folder=session.folder))
    try:
        settings = recorded_settings(metadata) or session.record.setting_values
        return parse_protocol(text, settings, label=f"protocol of {session.name}")
    except SettingError as error:
        # Nobody typed it: it stands in the recording.
        raise ProtocolError(error.message, error.reason, **error.values) from error


def recorded_settings(metadata: Mapping[str, object]) -> Mapping[str, object]:
    """Return the settings that a part was recorded with; empty where its start is damaged."""
    settings = metadata.get("settings")
    return settings if isinstance(settings, dict) else {}


def session_protocol(session: Session) -> Protocol:
    """Return the protocol of a session's first part, which is what its samples are decoded with; as ``recorded_protocol``."""
    part = next((item for item in read_session(session) if isinstance(item, PartStart)), None)
    return recorded_protocol({} if part is None else part.metadata, session)
