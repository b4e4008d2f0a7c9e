"""Send the commands of a driver to one instrument: ask who it is, set its rate, and put it back as it was found."""

from __future__ import annotations

from collections.abc import Collection, Sequence

from imufield.acquire.decoder import Decoder
from imufield.acquire.driver import Command, Driver, Message
from imufield.acquire.instrument.exchange import Exchange
from imufield.acquire.link.chunk import Chunk
from imufield.acquire.link.host_clock import HostClock
from imufield.acquire.link.serial import Link
from imufield.acquire.protocol.protocol import load_protocol
from imufield.errors import LinkError, LinkTimeoutError, Reason, UsageError
from imufield.sentences import Sentences

sentence = Sentences(__package__)

_SAME = 1e-3  # Rates closer than this are the same: instruments round their divisors.


class Instrument:
    """Plays the commands of a driver over a link, and remembers how to undo them.

    Parameters
    ----------
    driver : type of Driver
    clock : HostClock
    heard : collection of str
        Kinds of frames that it sends.

    Attributes
    ----------
    chunks : list of Chunk
        What arrived during the last command, to be recorded.
    state : list of Message
        Newest answers to the questions about what can be changed.
    interrupted : bool
        Whether that interrupted the stream of samples, or took the place of some: what came before does not go on behind it.
    """

    def __init__(self, driver: type[Driver], clock: HostClock, heard: Collection[str] = ()) -> None:
        self.driver = driver
        self.heard = heard
        self.chunks: list[Chunk] = []
        self.state: list[Message] = []
        self.interrupted = False
        self._clock = clock
        self._undo: list[Sequence[Command]] = []
        self._rate_before_hz: float | None = None

    def identify(self, link: Link) -> list[Message]:
        """Return what the instrument answers to questions about itself; nothing where it is not connected that way."""
        return self._play(link, self.driver.identity_questions(self.heard))

    def start(self, link: Link) -> None:
        """Make a silent instrument send; ``restore`` silences it again.

        Raises
        ------
        UsageError
            It is not known how.
        LinkError
            No answer, or a refusal.
        """
        self._switch(link, on=True)

    def stop(self, link: Link) -> None:
        """Silence it; ``restore`` makes it send again. Raises as ``start`` does."""
        self._switch(link, on=False)

    def _switch(self, link: Link, *, on: bool) -> None:
        if "start and stop" not in self.driver.abilities:
            raise UsageError(sentence("instrument.no_start", title=self.driver.title))
        state = self._read_state(link)
        start, stop = self.driver.start_orders(state), self.driver.stop_orders(state)
        if not start or not stop:
            untold = sentence("instrument.output_untold", title=self.driver.title, port=link.name)
            raise LinkTimeoutError(untold, Reason.SILENCE)
        # Noted first: an order that fails half way is undone, too.
        self._undo.append(stop if on else start)
        self._play(link, start if on else stop, is_order=True)

    def set_rate(self, link: Link, rate_hz: float) -> float:
        """Set the output rate; return what it was. ``restore`` brings that back.

        Raises
        ------
        UsageError
            The instrument cannot have this rate, or any.
        LinkError
            No answer, a refusal, or another rate than the one asked for.
        """
        if "rate" not in self.driver.abilities:
            # Raises with the reason that the driver gives.
            self.driver.rate_orders(rate_hz, ())
        state = self._read_state(link)
        before_hz = self.driver.rate_hz(state)
        # Nothing is changed that could not be put back.
        if before_hz is None:
            raise LinkError(sentence("instrument.rate_untold", title=self.driver.title, port=link.name), Reason.SILENCE)
        # Before the comparison, so that a rate which the instrument does not have is refused in any case.
        orders = self.driver.rate_orders(rate_hz, state)
        if abs(before_hz - rate_hz) <= _SAME * rate_hz:
            return before_hz
        self._undo.append(self.driver.restore_orders(state))
        self._rate_before_hz = before_hz
        self._play(link, orders, is_order=True)
        self._check_rate(link, rate_hz)
        self.interrupted = True
        return before_hz

    def _check_rate(self, link: Link, rate_hz: float) -> None:
        """Read the rate back: not every instrument answers an order."""
        now_hz = self.driver.rate_hz(self._read_state(link))
        if now_hz is None or abs(now_hz - rate_hz) > _SAME * rate_hz:
            key = "instrument.unknown_rate" if now_hz is None else "instrument.other_rate"
            told = {"title": self.driver.title, "port": link.name, "rate_hz": rate_hz, "found_hz": now_hz}
            raise LinkError(sentence(key, **told), Reason.REFUSED)

    @property
    def is_changed(self) -> bool:
        """Whether there is something to undo."""
        return bool(self._undo)

    def forget_changes(self) -> None:
        """Leave as it is what was changed: another instrument is connected now."""
        self._undo, self._rate_before_hz = [], None

    def restore(self, link: Link) -> None:
        """Undo everything, newest first; a second call does nothing.

        Raises
        ------
        LinkError
            The instrument is gone or does not take it; the next power-off brings it back all the same.
        """
        # Taken at once: a failure here is not tried again when the program ends.
        undo, self._undo = self._undo, []
        failure: LinkError | None = None
        for orders in reversed(undo):
            try:
                self._play(link, orders, is_order=True)
            except LinkError as error:
                # The other changes are undone all the same; the first failure is reported.
                failure = failure or error
        before_hz, self._rate_before_hz = self._rate_before_hz, None
        if failure is not None:
            raise failure
        if before_hz is not None:
            self._check_rate(link, before_hz)

    def _read_state(self, link: Link) -> list[Message]:
        self.state = self._play(link, self.driver.state_questions(self.heard))
        return self.state

    def _play(self, link: Link, commands: Sequence[Command], *, is_order: bool = False) -> list[Message]:
        """Send commands and return their answers; orders must succeed, questions need not."""
        decoder = Decoder(load_protocol(self.driver.answers or self.driver.protocol))
        exchange = Exchange(link, decoder, self._clock)
        self.interrupted = any(command.is_last for command in commands)
        # Kept before it is played: a link that is gone in the middle has brought something, too.
        self.chunks = exchange.chunks
        answers = exchange.order(commands) if is_order else exchange.gather(commands)
        # Samples that gave way to answers are not lost on the link: what counts begins behind the last answer.
        self.interrupted |= bool(answers) and self.driver.answers_replace_samples
        return answers
