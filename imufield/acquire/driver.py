"""What a driver is: the facts about one instrument family that are not on the wire."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, ClassVar, Literal

from imufield.dataclass import KW_ONLY, dataclass
from imufield.errors import UsageError
from imufield.sentences import Sentences

if TYPE_CHECKING:  # Whoever lists instruments should not wait for NumPy.
    from imufield.acquire.protocol.protocol import Protocol

sentence = Sentences(__package__)

Evidence = Literal["verified on real bytes", "document only"]
Wire = Literal["serial", "can"]
Ability = Literal["identify", "start and stop", "rate"]
# What a frame without samples holds is written in its protocol: numbers, texts or lists, by the name of the field.
Message = Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class Command:
    """Something to send, and how its answer is known.

    Attributes
    ----------
    name : str
        What it is for; stands under ``asked`` in the answer.
    data : bytes
    answer : callable or None
        Tells whether a message answers it; None: nothing does, and nothing is waited for.
    refusal : callable
        What an answer says against it, empty for consent.
    is_last : bool
        It ends what the commands before it began, and is sent even where one of those failed.
    read : callable or None
        Finds the answer in the bytes since sending, where it is no message of the protocol; None: not there yet.
    """

    name: str
    data: bytes
    answer: Callable[[Message], bool] | None = None
    refusal: Callable[[Message], str] = lambda _: ""
    _: KW_ONLY
    is_last: bool = False
    read: Callable[[bytes], Message | None] | None = None

    @property
    def is_answered(self) -> bool:
        """Whether the instrument says something to it."""
        return self.answer is not None or self.read is not None


def any_message(message: Message) -> bool:  # noqa: ARG001  every message will do
    """Take whatever comes for an answer."""
    return True


BY_DOCUMENT: Mapping[Ability, Evidence] = {
    "identify": "document only",
    "start and stop": "document only",
    "rate": "document only",
}
"""Abilities of an instrument all of whose commands are written from its manual alone."""


class Driver:
    """Base of all drivers. A driver file ends with ``DRIVER = <its class>``.

    A driver is constants and, where the instrument can be asked, commands as bytes and what their answers mean: functions
    without a link, which ``Instrument`` plays. Wire formats are protocols. No command of a driver writes to memory that
    outlives the power.
    """

    name: ClassVar[str]
    """The name one types; the name of the file."""
    title: ClassVar[str]
    """Maker and model."""
    protocol: ClassVar[str]
    """Name of the protocol it speaks."""
    wire: ClassVar[Wire] = "serial"
    """What it is connected by; ``bauds`` are baud rates or bit rates accordingly, and commands on CAN are packed frames."""
    default_baud: ClassVar[int]
    """The first of ``bauds`` where it is not stated."""
    bauds: ClassVar[tuple[int, ...]]
    """All rates it can be set to, the likeliest first."""
    wiring: ClassVar[str] = "RS-232, RS-422 or logic level, as its manual says"
    """Interface and levels of a serial port: which adapter it takes."""
    status: ClassVar[Evidence]
    """Whether the protocol was tried on bytes of a real instrument."""
    manual: ClassVar[str]
    """Title, revision and section."""
    settings: ClassVar[Mapping[str, object]] = {}
    """Settings of the protocol that differ from its defaults for this instrument."""
    variants: ClassVar[tuple[Mapping[str, object], ...]] = ()
    """Settings for other forms of the stream, which nothing in it announces; each is tried where the form is not given."""
    identity_commands: ClassVar[tuple[bytes, ...]] = ()
    """Commands whose answers tell model, serial number and settings. They change nothing in the instrument."""
    abilities: ClassVar[Mapping[Ability, Evidence]] = {}
    """What the instrument can be told by imufield, and whether such commands and answers were seen on a real one."""
    answers: ClassVar[str] = ""
    """Name of the protocol of its answers, where it is not that of its samples."""
    answers_replace_samples: ClassVar[bool] = False
    """An answer takes the place of samples; otherwise it comes between two."""
    no_rate: ClassVar[str] = "imufield knows no command for it"
    """Why its rate cannot be set, where it cannot."""

    def __init_subclass__(cls) -> None:
        if "default_baud" not in vars(cls) and vars(cls).get("bauds"):
            cls.default_baud = cls.bauds[0]

    @classmethod
    def load_protocol(
        cls,
        given: Mapping[str, object] | None = None,
        *,
        messages: Iterable[Message] = (),
        read: Mapping[str, object] | None = None,
    ) -> Protocol:
        """Return the protocol with this instrument's settings, those its messages tell, and those given.

        ``read`` are settings that it told earlier: they hold where the messages do not tell otherwise.

        Raises
        ------
        ProtocolError
            If a given setting is not known or not allowed.
        """
        from imufield.acquire.protocol.protocol import load_protocol

        told = {**cls.settings, **(read or {}), **cls.read_settings(messages)}
        return load_protocol(cls.protocol, given, read=told)

    @classmethod
    def read_settings(cls, messages: Iterable[Message]) -> dict[str, object]:  # noqa: ARG003  for drivers to use
        """Return the settings that messages of the instrument tell."""
        return {}

    @classmethod
    def identity(cls, messages: Iterable[Message]) -> dict[str, str]:  # noqa: ARG003  for drivers to use
        """Return what messages of the instrument tell of ``model``, ``serial_number`` and ``firmware``."""
        return {}

    @classmethod
    def identity_questions(cls, heard: Collection[str]) -> Sequence[Command]:  # noqa: ARG003  for drivers to use
        """Return the commands whose answers ``identity`` and ``read_settings`` understand.

        Parameters
        ----------
        heard : collection of str
            Kinds of frames that the instrument sends.
        """
        return [Command(name="identity", data=data, answer=any_message) for data in cls.identity_commands]

    @classmethod
    def state_questions(cls, heard: Collection[str]) -> Sequence[Command]:  # noqa: ARG003  for drivers to use
        """Return the commands whose answers tell what ``rate_orders`` would change."""
        return ()

    @classmethod
    def rate_hz(cls, state: Sequence[Message]) -> float | None:  # noqa: ARG003  for drivers to use
        """Return the output rate by the answers to ``state_questions``; None where they do not tell."""
        return None

    @classmethod
    def rate_orders(cls, rate_hz: float, state: Sequence[Message]) -> Sequence[Command]:  # noqa: ARG003  for drivers to use
        """Return the commands that set the output rate until power-off.

        Raises
        ------
        UsageError
            If the instrument cannot have this rate, or any.
        """
        raise UsageError(sentence("driver.fixed_rate", title=cls.title, cause=cls.no_rate))

    @classmethod
    def restore_orders(cls, state: Sequence[Message]) -> Sequence[Command]:
        """Return the commands that bring back the state that was read."""
        rate_hz = cls.rate_hz(state)
        return () if rate_hz is None else cls.rate_orders(rate_hz, state)

    @classmethod
    def start_orders(cls, state: Sequence[Message]) -> Sequence[Command]:  # noqa: ARG003  for drivers to use
        """Return the commands that make a silent instrument send samples: as ``state`` tells, else as delivered."""
        return ()

    @classmethod
    def stop_orders(cls, state: Sequence[Message] = ()) -> Sequence[Command]:  # noqa: ARG003  for drivers to use
        """Return the commands that silence it until ``start_orders`` or the next power-on; none where ``state`` is missing."""
        return ()


def checksum_of(algorithm: str, message: bytes, *, start: int | None = None) -> int:
    """Return the checksum of a command; arguments as of ``protocol.checksum.make_checksum``, which is made when one is sent."""
    from imufield.acquire.protocol.checksum import make_checksum

    return make_checksum(algorithm, start=start).of(message)


def choose_rate(title: str, rate_hz: float, rates_hz: Collection[float]) -> float:
    """Return the one of ``rates_hz`` that is meant.

    Raises
    ------
    UsageError
        If none is within 0.1 %, so that 66.7 is taken for 200 / 3.
    """
    for rate in rates_hz:
        if abs(rate - rate_hz) <= 1e-3 * rate:
            return rate
    raise UsageError(sentence("driver.no_rate", title=title, rate_hz=rate_hz, rates_hz=sorted(rates_hz)))


def choose_divisor(title: str, rate_hz: float, base_hz: float) -> int:
    """Return by what the inner rate of the instrument must be divided.

    Raises
    ------
    UsageError
        If no whole number gives ``rate_hz`` within 0.1 %.
    """
    divisor = max(round(base_hz / rate_hz), 1)
    if abs(base_hz / divisor - rate_hz) > 1e-3 * rate_hz:
        near_hz = [base_hz / number for number in range(max(divisor - 1, 1), divisor + 2)]
        raise UsageError(sentence("driver.no_divisor", title=title, base_hz=base_hz, rate_hz=rate_hz, near_hz=near_hz))
    return divisor
