"""What a driver is: the facts about one instrument family that are not on the wire."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any, ClassVar, Literal

from imufield.acquire.protocol import Protocol, load_protocol

Evidence = Literal["verified on real bytes", "document only"]
Wire = Literal["serial", "can"]


class Driver:
    """Base of all drivers. A driver file ends with ``DRIVER = <its class>``.

    A driver is constants and, where the instrument can be asked, what its answers mean. Wire formats are protocols.
    """

    name: ClassVar[str]
    """The name one types; the name of the file."""
    title: ClassVar[str]
    """Maker and model."""
    protocol: ClassVar[str]
    """Name of the protocol it speaks."""
    wire: ClassVar[Wire] = "serial"
    """What it is connected by; bit rates are those of that wire, and commands to a CAN instrument are packed frames."""
    default_baud: ClassVar[int]
    bauds: ClassVar[tuple[int, ...]]
    """All rates it can be set to, the likeliest first."""
    status: ClassVar[Evidence]
    """Whether the protocol was tried on bytes of a real instrument."""
    manual: ClassVar[str]
    """Title, revision and section."""
    settings: ClassVar[Mapping[str, object]] = {}
    """Settings of the protocol that differ from its defaults for this instrument."""
    identity_commands: ClassVar[tuple[bytes, ...]] = ()
    """Commands whose answers tell model, serial number and settings. They change nothing in the instrument."""

    @classmethod
    def load_protocol(
        cls, given: Mapping[str, object] | None = None, *, messages: Iterable[Mapping[str, Any]] = ()
    ) -> Protocol:
        """Return the protocol with this instrument's settings, those its messages tell, and those given.

        Raises
        ------
        ProtocolError
            If a given setting is not known or not allowed.
        """
        read = {**cls.settings, **cls.read_settings(messages)}
        return load_protocol(cls.protocol, given, read=read)

    @classmethod
    def read_settings(cls, messages: Iterable[Mapping[str, Any]]) -> dict[str, object]:  # noqa: ARG003  for drivers to use
        """Return the settings that messages of the instrument tell."""
        return {}

    @classmethod
    def identity(cls, messages: Iterable[Mapping[str, Any]]) -> dict[str, str]:  # noqa: ARG003  for drivers to use
        """Return what messages of the instrument tell of ``model``, ``serial_number`` and ``firmware``."""
        return {}
