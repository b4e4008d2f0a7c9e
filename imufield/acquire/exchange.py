"""Questions and orders to an instrument: the address that drivers of other packages import."""

from imufield.acquire.instrument.exchange import ANSWER_S, TRIES, Command, Exchange, Message, any_message

__all__ = ["ANSWER_S", "TRIES", "Command", "Exchange", "Message", "any_message"]
