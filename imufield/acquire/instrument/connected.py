"""The connection to an instrument: what a command asks for, and what it gets once the instrument is understood.

``connect`` and ``connect_can`` build it. Nothing is printed here: a sentence for the person goes to a callback.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

from imufield.acquire.driver import Driver, Message, Wire
from imufield.acquire.instrument.baud_search import Say
from imufield.acquire.instrument.instrument import Instrument
from imufield.acquire.link.background import BackgroundLink, ReopenableLink
from imufield.acquire.link.chunk import Chunk
from imufield.acquire.protocol.protocol import Protocol
from imufield.acquire.protocol.settings import with_origin
from imufield.acquire.recording.recorder import protocol_tables
from imufield.dataclass import dataclass, field
from imufield.errors import LinkError, Reason
from imufield.sentences import Sentences, printable

sentence = Sentences(__package__)

# Settings that change every number, so that an assumed value must be seen; so does one that is "unknown".
_WORTH_SAYING = ("accelerometer_range_g", "columns", "time_unit", "accelerometer_unit", "gyroscope_unit")


@dataclass(frozen=True, slots=True, kw_only=True)
class ConnectOptions:
    """Options of the commands that open a port."""

    port: str | None = None
    driver: str | None = None
    baud: int | None = None
    protocol: Path | None = None
    settings: Mapping[str, str] = field(default_factory=dict)
    settings_read: Mapping[str, str] = field(default_factory=dict)
    """Those that a session took from the stream, and that hold where it does not tell them again."""
    protocol_text: str | None = None
    """Text of the protocol that a session was recorded with, where neither driver nor file is given."""
    bus: str | None = None
    """A CAN bus instead of a port, ``INTERFACE:CHANNEL``; ``baud`` is its bit rate then."""
    dbc: Path | None = None
    mapping: Mapping[str, str] = field(default_factory=dict)
    """Which signal of ``dbc`` is which axis, as ``parse_map`` returns it."""
    rate_hz: float | None = None
    """Output rate to set; None leaves it."""


def _silence(_: str) -> None:
    """Tell nobody."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Connected:
    """An open link with an instrument that was understood; it is read in the background from now on."""

    link: BackgroundLink
    protocol: Protocol
    driver: str
    model: str
    baud: int | None
    """Bit rate; None on a bus where it is set elsewhere."""
    chunks: list[Chunk]
    """What arrived while listening; the first of the recording."""
    identity: dict[str, str]
    wire: Wire = "serial"
    instrument: Instrument | None = None
    """Takes commands; None on a bus and without a driver."""
    rate_hz: float | None = None
    """Output rate that was asked for."""
    rate_before_hz: float | None = None
    """What it was before."""
    is_virtual: bool = False
    """Read with a scaled clock, as only emulated instruments are; an emulator at real speed is not recognised."""
    say: Say = _silence
    """Told where the instrument could not be put back as it was."""

    def close(self) -> None:
        """Leave the instrument as it was found, and give the link back."""
        try:
            if self.instrument is not None and self.instrument.is_changed:
                # What waits to be read came before the commands and answers none of them.
                self.link.drain()
                self.instrument.restore(self.link)
        except LinkError as error:
            self.say(sentence("connected.not_put_back", cause=error.message))
        finally:
            self.link.close()

    def ask_again(self, chunks: list[Chunk]) -> None:
        """Ask behind a reconnection who is there; ``chunks``, the first one that came, becomes what is to be read in its place.

        Raises
        ------
        LinkError
            The instrument has another serial number than before (``FOREIGN``), or the link is gone again.
        """
        known = self.identity.get("serial_number")
        if self.instrument is None or not known:
            return
        try:
            messages = self.instrument.identify(self.link)
        except (LinkError, KeyboardInterrupt):
            # The stream does not go on behind the answers, so nothing of it has to give way to them.
            chunks += self.instrument.chunks
            raise
        keep(self.instrument, chunks)
        found = read_identity(self.instrument.driver, messages).get("serial_number", known)
        if found != known:
            # What was changed in the one before must not be undone in this one.
            self.instrument.forget_changes()
            other = sentence("connected.other_instrument", port=self.link.name, known=known, found=found)
            raise LinkError(other, Reason.FOREIGN)

    def session_tables(self) -> dict[str, object]:
        """Return the tables of ``session.toml`` that describe instrument, link and protocol."""
        nominal = self.protocol.nominal
        baud, rates = self.baud, {"rate_hz": self.rate_hz, "rate_before_hz": self.rate_before_hz}
        where = {"bus": self.link.name, "bit_rate": baud} if self.wire == "can" else {"port": self.link.name, "baud": baud}
        virtual: dict[str, object] = {"is_virtual": True} if self.is_virtual else {}
        instrument = {"driver": self.driver, "model": self.model, **self.identity}
        # In the model, so that every file and report made from it says so.
        instrument["model"] += " (emulated)" if self.is_virtual else ""
        return {
            "instrument": instrument,
            # TOML has no value for nothing.
            "link": virtual | {name: value for name, value in {**where, **rates}.items() if value is not None},
            **protocol_tables(self.protocol),
            "nominal": {"raw_zero": nominal.raw_zero, "rate_hz": nominal.rate_hz},
        }


def read_identity(driver: type[Driver], messages: Iterable[Message]) -> dict[str, str]:
    """Return what an instrument said of itself; its texts come from a wire and go to terminals, files and pages."""
    return {name: printable(text) for name, text in driver.identity(messages).items()}


def identity_text(identity: Mapping[str, str]) -> str:
    """Return what an instrument said of itself as a list; empty where it said nothing."""
    return ", ".join(f"{name.replace('_', ' ')} {value}" for name, value in identity.items())


def say_what_is_known(driver: type[Driver] | None, protocol: Protocol, identity: Mapping[str, str], say: Say) -> None:
    """Tell what a person should know of an instrument that was understood."""
    said = [f"instrument: {told}"] if (told := identity_text(identity)) else []
    for remark in (*untried(driver), *said, *assumed(protocol)):
        say(remark)


def ask_identity(
    instrument: Instrument, link: ReopenableLink, chunks: list[Chunk], messages: Sequence[Message]
) -> list[Message]:
    """Return the instrument's messages: those received, or the answers to commands that change nothing in it."""
    if instrument.driver.read_settings(messages) or instrument.driver.identity(messages):
        return [*messages]
    answers = instrument.identify(link)
    keep(instrument, chunks)
    return [*messages, *answers]


def keep(instrument: Instrument, chunks: list[Chunk]) -> None:
    """Add what arrived during a command; where that interrupted the stream, what came before is no part of it any more."""
    if instrument.interrupted:
        chunks.clear()
    else:
        chunks += instrument.chunks


def with_settings(
    driver: type[Driver] | None, protocol: Protocol, messages: Sequence[Message], rate_hz: float | None = None
) -> Protocol:
    """Return the protocol with what the instrument told of its settings, and the rate that was set.

    The rate goes into protocols of increments only: others take it from the stream.
    """
    by_increment = protocol.units.accelerometer_is_increment or protocol.units.gyroscope_is_increment
    set_rate: dict[str, object] = {} if rate_hz is None or not by_increment else {"rate_hz": rate_hz}
    if driver is None or not (set_rate or driver.read_settings(messages)):
        return protocol
    given, read = with_origin(protocol.settings, "given"), with_origin(protocol.settings, "read")
    return driver.load_protocol({**given, **set_rate}, messages=messages, read=read)


def untried(driver: type[Driver] | None) -> list[str]:
    """Return a sentence where the format of an instrument was never tried on bytes of a real one."""
    if driver is None or driver.status == "verified on real bytes":
        return []
    return [sentence("connected.experimental", title=driver.title)]


def assumed(protocol: Protocol) -> list[str]:
    """Return a sentence for each setting that was assumed and changes every number, and for values that are no raw ones."""
    samples = protocol.samples
    return [
        *([sentence("connected.corrected", advice=samples.advice)] if samples.corrected else []),
        *(
            sentence("connected.assumed", name=name, value=setting.value)
            for name, setting in protocol.settings.items()
            if setting.origin == "assumed" and (name in _WORTH_SAYING or setting.value == "unknown")
        ),
    ]
