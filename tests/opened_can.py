"""A bus, opened with everything to decode it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from imufield.acquire.decoder import Decoder
from imufield.acquire.instrument.can_map import bus_candidate
from imufield.acquire.link.can import CanLink, open_can_link
from imufield.acquire.protocol.protocol import Protocol


@dataclass(frozen=True)
class OpenedCan:
    link: CanLink
    protocol: Protocol
    decoder: Decoder
    driver: str
    """Or the protocol where there is none."""


def open_can(bus: str, **asked: Any) -> OpenedCan:
    """Open a bus with what ``bus_candidate`` takes."""
    found = bus_candidate(**asked)
    link = open_can_link(bus, bit_rate=next(iter(found.bauds), None))
    return OpenedCan(link, found.protocol, Decoder(found.protocol), found.name)
