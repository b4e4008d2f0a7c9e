"""Commands to an instrument, and their answers out of the stream it keeps sending.

An instrument answers between its samples or in place of some, so everything that arrives is searched for the answer. Waiting
ends by the clock of the host: a cable whose sending half is not connected costs a second, not the session.
"""

from __future__ import annotations

from collections.abc import Iterable

from imufield.acquire.decoder import Decoder
from imufield.acquire.driver import Command, Message, any_message
from imufield.acquire.link.chunk import Chunk
from imufield.acquire.link.host_clock import HostClock, patience_s
from imufield.acquire.link.serial import Link
from imufield.errors import LinkError, LinkTimeoutError, Reason
from imufield.sentences import Sentences

sentence = Sentences(__package__)

# Drivers of others import the first three from here.
__all__ = ["ANSWER_S", "TRIES", "Command", "Exchange", "Message", "any_message"]

ANSWER_S = 0.5
"""Wait for an answer: instruments answer within some 50 ms, at 9600 bit/s after up to 100 ms of samples on their way."""
TRIES = 2
"""A command is sent again once: its first bytes may have met the end of a sleep or a busy instrument."""
_LONGEST_ANSWER = 1 << 16  # Bytes kept while a text answer is awaited: 0.5 s at 1.3 Mbit/s.


class Exchange:
    """Asks one instrument.

    Parameters
    ----------
    link : Link
        Open, and read by nobody else meanwhile.
    decoder : Decoder
        Of the language of the answers, which need not be that of the samples.
    clock : HostClock

    Attributes
    ----------
    chunks : list of Chunk
        Everything that arrived meanwhile.
    """

    def __init__(self, link: Link, decoder: Decoder, clock: HostClock) -> None:
        self._link = link
        self._decoder = decoder
        self._clock = clock
        self.chunks: list[Chunk] = []

    def gather(self, commands: Iterable[Command]) -> list[Message]:
        """Return the answers there are; where the first command is not answered only the last ones are sent, too."""
        answers: list[Message] = []
        is_deaf = False
        for command in commands:
            # Every further question would cost its full time-out.
            if is_deaf:
                # Should the instrument hear but not be heard, it goes on all the same.
                if command.is_last:
                    self._link.write(command.data)
                continue
            answer = self._ask(command)
            if answer is not None:
                answers.append(answer)
            is_deaf = command.is_answered and not answers
        return answers

    def order(self, commands: Iterable[Command]) -> list[Message]:
        """Send commands that must succeed; return their answers.

        Raises
        ------
        LinkTimeoutError
            One was not answered.
        LinkError
            One was refused (``REFUSED``), or the link is gone.
        """
        answers: list[Message] = []
        failure: LinkError | None = None
        for command in commands:
            # What is half done must not go on, but what was begun is ended.
            if failure is not None and not command.is_last:
                continue
            answer = self._ask(command)
            asked = {"port": self._link.name, "command": command.name}
            if answer is not None:
                answers.append(answer)
                if refusal := command.refusal(answer):
                    refused = sentence("exchange.refused", **asked, refusal=refusal)
                    failure = failure or LinkError(refused, Reason.REFUSED)
            elif command.is_answered:
                silent = sentence("exchange.no_answer", **asked, tries=TRIES, limit_s=ANSWER_S)
                failure = failure or LinkTimeoutError(silent, Reason.SILENCE)
        if failure is not None:
            raise failure
        return answers

    def _ask(self, command: Command) -> Message | None:
        # What came before the command does not answer it.
        self._decoder.messages()
        for _ in range(TRIES if command.is_answered else 1):
            self._link.write(command.data)
            received = b""
            end_s = self._clock.monotonic_s() + patience_s(self._clock, ANSWER_S)
            while command.is_answered and self._clock.monotonic_s() < end_s:
                chunk = self._link.read()
                if chunk is None:
                    continue
                self.chunks.append(chunk)
                self._decoder.feed(chunk.data, chunk.monotonic_s)
                received = (received + chunk.data)[-_LONGEST_ANSWER:]
                answer = self._answer(command, received)
                if answer is not None:
                    return {**answer, "asked": command.name}
        return None

    def _answer(self, command: Command, received: bytes) -> Message | None:
        """Find the answer in the bytes or the messages since the command was sent."""
        if command.read is not None:
            return command.read(received)
        messages = self._decoder.messages()
        return next((message for message in messages if command.answer is not None and command.answer(message)), None)
