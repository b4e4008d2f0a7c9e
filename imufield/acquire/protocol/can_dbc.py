"""DBC files through cantools, and their signals read by NumPy for all frames of one message at once.

cantools parses the file and nothing more: its objects do not leave this module, except for ``describe``, which shows
single frames to people. Bits are numbered as in a DBC file: little-endian ("Intel") signals start at their least significant
bit, big-endian ("Motorola") ones at their most significant.
"""

from __future__ import annotations

import logging
import math
import re
from collections.abc import Iterable, Mapping
from typing import Self

import cantools
import numpy as np
from cantools.database import Database, Message, Signal
from numpy.typing import NDArray

from imufield.acquire.protocol.can_frame import EXTENDED, ID_MASK, MOST_DATA
from imufield.acquire.protocol.layout import MessageValue, Numbers, from_zero
from imufield.acquire.protocol.toml import LARGEST, LEAST_SCALE, near
from imufield.dataclass import dataclass
from imufield.errors import ProtocolError, Reason
from imufield.samples import IntArray
from imufield.sentences import Sentences, shortened

sentence = Sentences(__package__)

Rows = NDArray[np.uint8]

CLASSICAL_BYTES = 8
_MOST_BITS = 64
_ROUNDING = 1e-9  # Relative: files state ranges with as many digits as they need.
COUNTER_BITS = 62
"""Of which a counter is read at most: arithmetic is done in 64 bits with a sign."""
_FLOAT_BITS = (16, 32, 64)
# cantools logs names of a file as they are; what it finds is checked below.
logging.getLogger("cantools").setLevel(logging.CRITICAL)
MOST_ENTRIES = 20_000
"""Messages and signals: twice those of whole vehicles. cantools takes 0.1 ms for each."""
MOST_FORMS = 1 << 16
"""Of multiplexed messages, all together: a selector of 16 bits. cantools makes each of them, in 20 us and 2 kB."""
_FURTHEST_BIT = 8 * 1785
"""Of a message of J1939 that takes several frames (J1939-21). cantools makes numbers with as many bits as a signal has."""
_DEEPEST = 8  # Multiplexers in each other: files of vehicles have two or three.
_TEXT_OR_COMMENT = re.compile(r'"(?:[^"\\]++|\\"?+)*+"?+|//[^\n]*+')
_LONGEST_TEXT = 1 << 16  # Comments have up to some hundred characters; cantools takes 240 bytes for each.
# Nothing that was taken is given back, and what stands between is of few characters: a file that is made to be slow would have
# each of its characters looked at from each of the others on.
_ENTRY = re.compile(r"\b(?:BO_\s++\d++\s*+\w++|SG_\s++\w++(?:\s++\w++)?+)\s*+:")
_BITS = re.compile(r":\s*+(\d++)\s*+\|\s*+(\d++)\s*+@")
_MULTIPLEXED = re.compile(r"\bSG_MUL_VAL_\s++\+?(\d++)\s*+(\w++)\s++(\w++)\s*+([\d\s,+-]*+);")
# The largest double has 309 digits, and Python makes no integer of more than 4300.
_LONG_NUMBER = re.compile(r"(?<!\d)\d{1000}\d*+")
_CHOICES = re.compile(r"\bVAL_\s++\+?(\d++)\s*+(\w++)([\d\s\"+-]*+);")
# J1939: below this PDU format 240 the lower byte is a destination address and no part of the group number.
_PDU1_BELOW = 0xF000
# Parts texts of value tables into words, as the patterns that follow want them: SensorError, SENSOR_ERROR.
_BETWEEN_WORDS = re.compile(r"(?<=[a-z\d])(?=[A-Z])|(?<=[A-Z])(?=[A-Z][a-z])|[_-]+")
_NOT_AVAILABLE = re.compile(
    r"not ?(avail|valid)|\bn[/ ]?a\b|invalid|\bsna\b|unavail|undefined|\breserved|\bno ?(data|signal)", re.IGNORECASE
)
_DAMAGE = (ValueError, KeyError, TypeError, AttributeError, IndexError, AssertionError, RecursionError)
_ERROR = re.compile(
    r"((?<!\bt)err(ors?|oneous)?|(?<!\bde)fault(s|y|ed)?|fail(s|ed|ing|ures?)?|defect(s|ive)?)(?![a-z])", re.IGNORECASE
)
_NO_ERROR = re.compile(r"\b(no|not|without)( \w+)? ?(err|fault|fail|defect)|\bok\b", re.IGNORECASE)


@dataclass(frozen=True, slots=True)
class Code:
    """Raw values, ends included, that are no measurement."""

    low: float
    high: float
    is_error: bool = False
    """The instrument reports a fault; otherwise there is simply no value."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CanSignal:
    """One signal: where its bits are and what they mean. value = raw * factor + offset in ``unit``."""

    name: str
    start: int
    length: int
    big_endian: bool
    is_signed: bool
    is_float: bool
    factor: float
    offset: float
    unit: str
    minimum: float = -math.inf
    maximum: float = math.inf
    """The range that the file states, as values."""
    codes: tuple[Code, ...] = ()

    @property
    def first_byte(self) -> int:
        """Offset of the first byte it touches."""
        return self.start // 8

    @property
    def bytes_needed(self) -> int:
        """How many bytes a frame must have to hold it."""
        if self.big_endian:
            return (self._first_bit_in_order + self.length + 7) // 8
        return (self.start + self.length + 7) // 8

    @property
    def stated_modulus(self) -> int:
        """How many raw numbers a counter or a time stamp has: by the stated range where that has 0 and 1, else by the bits."""
        first, last = ((end - self.offset) / self.factor for end in (self.minimum, self.maximum))
        if not -self.modulus < first <= 0 < 1 <= last < self.modulus:
            return self.modulus
        # A count that a factor of 0.1 makes to a decimal fraction is whole but for rounding.
        is_whole = all(abs(end - round(end)) <= _ROUNDING * abs(end) for end in (first, last))
        return min(round(last) - round(first) + 1, self.modulus) if is_whole else self.modulus

    @property
    def _first_bit_in_order(self) -> int:
        """Place of the most significant bit of a big-endian signal, counted from the first bit on the wire."""
        return 8 * (self.start // 8) + 7 - self.start % 8

    @property
    def type(self) -> str:
        """Type of the numbers, as those of fields are called: u16, f32, also i12."""
        return f"{'f' if self.is_float else 'i' if self.is_signed else 'u'}{self.length}"

    @property
    def modulus(self) -> int:
        """How many values whole numbers of so many bits have, with a sign or without; 0 for others."""
        return 0 if self.is_float else 1 << self.length

    @property
    def number_type(self) -> str | None:
        """NumPy's type where the signal fills whole bytes of one; None where bits must be cut out."""
        whole = self._first_bit_in_order % 8 == 0 if self.big_endian else self.start % 8 == 0
        if not whole or self.length not in (8, 16, 32, 64):
            return None
        return f"{'>' if self.big_endian else '<'}{self.type[0]}{self.length // 8}"

    def raw(self, rows: Rows) -> Numbers:
        """Return the numbers as sent, shape (n,).

        Parameters
        ----------
        rows : ndarray of uint8, shape (n, width)
            Data of n frames; bytes of a row contiguous.
        """
        kind = self.number_type
        if kind is not None:
            return rows[:, self.first_byte : self.first_byte + self.length // 8].view(kind)[:, 0]
        bits = self._bits(rows)
        if self.is_float:
            # Only half precision is left: 32 and 64 bits that begin inside a byte.
            return bits.astype(f"u{self.length // 8}").view(f"f{self.length // 8}")
        if not self.is_signed:
            return bits
        shift = 64 - self.length
        return (bits << np.uint64(shift)).view(np.int64) >> np.int64(shift)

    def count(self, rows: Rows, modulus: int = 1 << COUNTER_BITS) -> IntArray:
        """Return the numbers of a counter that begins anew after ``modulus`` of them, from 0 on. Shape (n,)."""
        return from_zero(self.raw(rows).astype(np.int64), modulus) & ((1 << min(self.length, COUNTER_BITS)) - 1)

    def _bits(self, rows: Rows) -> NDArray[np.uint64]:
        """Cut the bits out of a window of 8 bytes, and of a ninth where the signal reaches into it."""
        begin = self.first_byte
        mask = np.uint64((1 << self.length) - 1)
        if self.start % 8 + self.length <= 8 and not self.big_endian:
            return rows[:, begin].astype(np.uint64) >> np.uint64(self.start % 8) & mask
        window = rows[:, begin : begin + 8]
        if window.shape[1] < 8:
            window = np.pad(window, ((0, 0), (0, 8 - window.shape[1])))
        word = window.view(">u8" if self.big_endian else "<u8")[:, 0].astype(np.uint64, copy=False)
        shift = 64 - self._first_bit_in_order % 8 - self.length if self.big_endian else self.start % 8
        if self.bytes_needed - begin <= 8:
            return word >> np.uint64(shift) & mask
        ninth = rows[:, begin + 8].astype(np.uint64)
        if self.big_endian:
            return (word << np.uint64(-shift) | ninth >> np.uint64(8 + shift)) & mask
        return (word >> np.uint64(shift) | ninth << np.uint64(64 - shift)) & mask

    def gaps(self, raw: Numbers) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
        """Return where there is no value, and where that is because of a fault. Shape (n,) each."""
        missing = ~np.isfinite(raw) if self.is_float else np.zeros(len(raw), dtype=np.bool_)
        fault = np.zeros(len(raw), dtype=np.bool_)
        for code in self.codes:
            hit = (raw >= code.low) & (raw <= code.high)
            missing |= hit
            if code.is_error:
                fault |= hit
        return missing, fault


Selectors = tuple[tuple[CanSignal, tuple[int, ...]], ...]
"""Multiplexer signals and the values they must have."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CanMessage:
    """One message of a DBC file, or one multiplexed form of it."""

    name: str
    can_id: int
    """With ``EXTENDED``."""
    mask: int
    """Bits of an identifier that must agree."""
    is_j1939: bool
    selectors: Selectors = ()
    """Multiplexer signals and the values they must have."""

    def meets(self, other: CanMessage) -> bool:
        """Whether a frame may be of either message by its identifier."""
        return (self.can_id ^ other.can_id) & self.mask & other.mask == 0

    @classmethod
    def of(cls, message: Message, selectors: Selectors, is_j1939: bool) -> Self:
        """Return a message of cantools."""
        number, extended = message.frame_id, EXTENDED if message.is_extended_frame else 0
        mask = ID_MASK
        if is_j1939:
            # Priority and source address may be any; below PDU format 240 the destination too.
            mask, extended = 0x03FFFF00 if number >> 8 & 0xFFFF >= _PDU1_BELOW else 0x03FF0000, EXTENDED
        return cls(
            name=message.name,
            can_id=number & mask | extended,
            mask=EXTENDED | mask,
            is_j1939=is_j1939,
            selectors=selectors,
        )


class DbcFile:
    """A parsed DBC file.

    Parameters
    ----------
    text : str
    label : str
        What to call it in messages.
    identifiers : str
        "exact", "j1939", or "auto": J1939 for the messages whose attributes say so.

    Raises
    ------
    ProtocolError
        If it cannot be parsed.
    """

    def __init__(self, text: str, label: str, identifiers: str = "auto") -> None:
        self.label = label
        self._identifiers = identifiers
        try:
            _check_extent(text, label)
            # Makers' files often have signals that overlap or end behind their message: what is used of them is checked below.
            # Without a line end behind the last comment it looks for one from each of its slashes on.
            found = cantools.database.load_string(f"{text}\n", database_format="dbc", strict=False)
        except ProtocolError:
            raise
        # cantools raises its own errors, and others where a file is damaged in a place it did not think of.
        except (cantools.Error, *_DAMAGE) as error:
            # It quotes the line.
            cause = shortened((str(error) or repr(error)).splitlines()[0])
            raise ProtocolError(sentence("can_dbc.unreadable", label=label, cause=cause)) from error
        if not isinstance(found, Database) or not found.messages:
            raise ProtocolError(sentence("can_dbc.no_message", label=label))
        self._database = found

    def find(self, name: str) -> tuple[CanMessage, CanSignal]:
        """Return the signal called ``SIGNAL`` or ``MESSAGE.SIGNAL``, and the message (or form of one) it is in.

        Raises
        ------
        ProtocolError
            If there is none, or more than one, of that name, or no frame holds it whole.
        """
        wanted_message, _, wanted = name.rpartition(".")
        candidates = [message for message in self._database.messages if wanted_message in ("", message.name)]
        if not candidates:
            raise self._unknown("message", wanted_message, self._database.messages)
        found = [(message, signal) for message in candidates for signal in message.signals if signal.name == wanted]
        if not found:
            raise self._unknown("signal", name, [signal for message in candidates for signal in message.signals])
        if len(found) > 1:
            where = [f"{message.name}.{wanted}" for message, _ in found]
            raise ProtocolError(sentence("can_dbc.several", label=self.label, count=len(found), name=wanted, where=where))
        self._check_whole(found[0][0])
        return self._compile(*found[0])

    def message(self, name: str) -> CanMessage:
        """Return a message by its name.

        Raises
        ------
        ProtocolError
            If there is none, or no frame holds it whole.
        """
        for message in self._database.messages:
            if message.name == name:
                self._check_whole(message)
                return CanMessage.of(message, (), self._is_j1939(message))
        raise self._unknown("message", name, self._database.messages)

    def signals(self) -> list[tuple[CanMessage, CanSignal]]:
        """Return every signal of the file."""
        return [self._compile(message, signal) for message in self._database.messages for signal in message.signals]

    def describe(self, name: str, data: bytes) -> dict[str, MessageValue]:
        """Return one frame of message ``name`` as plain values: numbers in their units, choices by their names."""
        try:
            decoded = self._database.get_message_by_name(name).decode(data, allow_truncated=True)
        except (cantools.Error, ValueError, KeyError) as error:
            return {"undecoded": data.hex(), "error": str(error)}
        values = decoded.items() if isinstance(decoded, dict) else ()
        return {key: value if isinstance(value, (int, float)) else str(value) for key, value in values}

    def identifier(self, name: str, source_address: int | None = None) -> int:
        """Return the identifier message ``name`` is sent with: priority as in the file, J1939 from ``source_address``."""
        message = self._database.get_message_by_name(name)
        number: int = message.frame_id | (EXTENDED if message.is_extended_frame else 0)
        if source_address is not None and self._is_j1939(message):
            return number & ~0xFF | source_address
        return number

    def encode(self, name: str, raw: Mapping[str, float]) -> bytes:
        """Return the data of message ``name`` with raw values by signal; 0 for those not given, cantools at work."""
        message = self._database.get_message_by_name(name)
        values = {signal.name: 0 for signal in message.signals} | dict(raw)
        return bytes(message.encode(values, scaling=False, strict=False))

    def is_fd(self, name: str) -> bool:
        """Return whether message ``name`` has more data than a classical frame holds."""
        return bool(self._database.get_message_by_name(name).length > CLASSICAL_BYTES)

    def _is_j1939(self, message: Message) -> bool:
        if self._identifiers == "auto":
            return bool(message.protocol == "j1939")
        return self._identifiers == "j1939" and bool(message.is_extended_frame)

    def _compile(self, message: Message, signal: Signal) -> tuple[CanMessage, CanSignal]:
        is_j1939 = self._is_j1939(message)
        compiled, selectors = compile_signal(signal, is_j1939), _selectors(message, signal, self.label)
        for each in (compiled, *(selector for selector, _ in selectors)):
            self._check(message, each)
        return CanMessage.of(message, selectors, is_j1939), compiled

    def _check_whole(self, message: Message) -> None:
        """Refuse a message of several frames: the transport protocol of J1939-21 is not read."""
        if self._is_j1939(message) and message.length > CLASSICAL_BYTES and not message.is_fd:
            names = {"label": self.label, "message": message.name}
            raise ProtocolError(sentence("can_dbc.transported", size=message.length, most=CLASSICAL_BYTES, **names))

    def _check(self, message: Message, signal: CanSignal) -> None:
        """Refuse a signal that no frame can hold, or that nothing can be computed with."""
        names = {"label": self.label, "message": message.name, "signal": signal.name}
        if not 1 <= signal.length <= _MOST_BITS or signal.start < 0 or (signal.is_float and signal.length not in _FLOAT_BITS):
            raise ProtocolError(sentence("can_dbc.bits", start=signal.start, length=signal.length, most=_MOST_BITS, **names))
        size = min(message.length, MOST_DATA)
        if signal.bytes_needed > size:
            raise ProtocolError(sentence("can_dbc.too_long", byte=signal.bytes_needed, size=size, **names))
        # Written so that nan is outside.
        if not (LEAST_SCALE <= abs(signal.factor) <= LARGEST and abs(signal.offset) <= LARGEST):
            raise ProtocolError(sentence("can_dbc.factor", factor=signal.factor, offset=signal.offset, **names))

    def _unknown(self, what: str, name: str, there: Iterable[Message | Signal]) -> ProtocolError:
        known = list(dict.fromkeys(each.name for each in there))
        shown = ", ".join(known[:20]) + (f" and {len(known) - 20} more" if len(known) > 20 else "")
        unknown = sentence("can_dbc.unknown", label=self.label, what=what, name=name, near=near(name, known), known=shown)
        return ProtocolError(unknown, Reason.UNKNOWN_KEY)


def compile_signal(signal: Signal, is_j1939: bool = False) -> CanSignal:
    """Return a signal of cantools in our form."""
    codes = [*_codes_of_table(signal), *(_codes_of_j1939(signal) if is_j1939 else ())]
    return CanSignal(
        name=signal.name,
        start=signal.start,
        length=signal.length,
        big_endian=signal.byte_order == "big_endian",
        is_signed=bool(signal.is_signed),
        is_float=bool(signal.is_float),
        factor=_number(signal.scale),
        offset=_number(signal.offset),
        unit=signal.unit or "",
        minimum=-math.inf if signal.minimum is None else _number(signal.minimum),
        maximum=math.inf if signal.maximum is None else _number(signal.maximum),
        codes=tuple(codes),
    )


def _number(found: float) -> float:
    # By its text, as the float of a whole number of 400 digits is an error and that of its text is infinite.
    return float(str(found))


def _check_extent(text: str, label: str) -> None:
    """Refuse too many messages and signals, texts, numbers and signals too long, and what ``_check_forms`` refuses."""
    longest = max((len(found) for found in _TEXT_OR_COMMENT.findall(text) if found.startswith('"')), default=0)
    if longest > _LONGEST_TEXT:
        raise ProtocolError(sentence("can_dbc.long_text", label=label, length=longest, limit=_LONGEST_TEXT))
    bare = _TEXT_OR_COMMENT.sub(lambda found: '""' if found[0].startswith('"') else " ", text)
    entries = sum(1 for _ in _ENTRY.finditer(bare))
    if entries > MOST_ENTRIES:
        raise ProtocolError(sentence("can_dbc.many_entries", label=label, entries=entries, limit=MOST_ENTRIES))
    if number := _LONG_NUMBER.search(bare):
        raise ProtocolError(sentence("can_dbc.long_number", label=label, digits=len(number[0]), begin=shortened(number[0])))
    for bits in _BITS.findall(bare):
        start, length = map(int, bits)
        if start + length > _FURTHEST_BIT:
            raise ProtocolError(sentence("can_dbc.far_bit", label=label, start=start, length=length, limit=_FURTHEST_BIT))
    _check_forms(bare, label)


def _check_forms(bare: str, label: str) -> None:
    """Refuse multiplexers in a circle or with too many forms; ``bare`` is a file without texts and comments."""
    above: dict[tuple[int, str], tuple[str, int]] = {}
    for frame, signal, multiplexer, ranges in _MULTIPLEXED.findall(bare):
        # The second of a range has the sign that parts them.
        ends = [abs(int(number)) for number in re.findall(r"[-+]?\d+", ranges)]
        values = sum(max(0, last - first + 1) for first, last in zip(ends[::2], ends[1::2], strict=False))
        earlier, known = above.get((int(frame), signal), (multiplexer, 0))
        if earlier != multiplexer:
            raise ProtocolError(sentence("can_dbc.two_multiplexers", label=label, signal=signal, names=[earlier, multiplexer]))
        above[int(frame), signal] = multiplexer, known + values
    named = {(int(frame), signal): texts.count('""') for frame, signal, texts in _CHOICES.findall(bare)} if above else {}
    total = 0
    for frame, signal in above:
        forms, name, depth = named.get((frame, signal), 0) + 1, signal, 0
        while (frame, name) in above:
            name, values = above[frame, name]
            forms, depth = forms * values, depth + 1
            if depth > _DEEPEST:
                raise ProtocolError(sentence("can_dbc.multiplexed_deep", label=label, signal=signal, limit=_DEEPEST))
        total += forms
    if total > MOST_FORMS:
        raise ProtocolError(sentence("can_dbc.many_forms", label=label, forms=total, limit=MOST_FORMS))


def _selectors(message: Message, signal: Signal, label: str) -> Selectors:
    """Return the multiplexers above a signal, outermost last."""
    found = []
    while signal.multiplexer_signal and signal.multiplexer_ids is not None:
        above = next((each for each in message.signals if each.name == signal.multiplexer_signal), None)
        if above is None:
            names = {"message": message.name, "signal": signal.name, "multiplexer": signal.multiplexer_signal}
            raise ProtocolError(sentence("can_dbc.no_multiplexer", label=label, **names))
        found.append((compile_signal(above), tuple(signal.multiplexer_ids)))
        signal = above
    return tuple(found)


def _codes_of_j1939(signal: Signal) -> list[Code]:
    """Return the top of an unsigned number of 8 bits or more: 0xFB reserved, 0xFE error, 0xFF not available (J1939-71)."""
    if signal.is_signed or signal.is_float or signal.length < 8:
        return []
    shift = signal.length - 8
    top = (1 << signal.length) - 1
    return [
        Code(0xFB << shift, (0xFE << shift) - 1),
        Code(0xFE << shift, (0xFF << shift) - 1, is_error=True),
        Code(0xFF << shift, top),
    ]


def _codes_of_table(signal: Signal) -> list[Code]:
    """Return the values that the file's value table calls invalid, not available or an error."""
    codes = []
    for value, text in (signal.choices or {}).items():
        if abs(value) >> _MOST_BITS:
            continue  # No signal has it.
        words = _BETWEEN_WORDS.sub(" ", str(text))
        is_error = bool(_ERROR.search(words) and not _NO_ERROR.search(words))
        if is_error or _NOT_AVAILABLE.search(words):
            codes.append(Code(value, value, is_error))
    return codes
