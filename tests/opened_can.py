"""A bus, opened with everything to decode it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

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


def open_can(
    bus: str,
    *,
    driver: str | None = None,
    protocol: str | Path | Protocol | None = None,
    dbc: str | Path | None = None,
    mapping: Mapping[str, str] | None = None,
    settings: Mapping[str, object] | None = None,
) -> OpenedCan:
    found = bus_candidate(driver=driver, protocol=protocol, dbc=dbc, mapping=mapping, settings=settings)
    link = open_can_link(bus, bit_rate=next(iter(found.bauds), None))
    return OpenedCan(link, found.protocol, Decoder(found.protocol), found.name)
