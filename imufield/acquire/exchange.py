"""Questions and orders to an instrument: the import address for other packages; the code is in ``instrument.exchange``."""

from imufield.acquire.instrument.exchange import ANSWER_S, TRIES, Command, Exchange, Message, any_message

__all__ = ["ANSWER_S", "TRIES", "Command", "Exchange", "Message", "any_message"]
