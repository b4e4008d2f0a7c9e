"""Who gets in: tokens, the names this server answers to, and the headers that keep a page to itself.

A page has no cookie and sends no form: the token stands in the fragment of its address, which no server and no log sees, and
goes back as a subprotocol of the socket, the one header that a browser lets a script set (as Jupyter's tokens,
jupyter_server, docs/source/operators/security.rst, but never in a query).
"""

from __future__ import annotations

import hmac
import secrets
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from enum import Enum
from http import HTTPStatus

PROTOCOL = "imufield"
"""The subprotocol that the server answers with: the token is never sent back."""
_BEFORE_TOKEN = "token."  # noqa: S105  (what stands before one)
_TOKEN_BYTES = 16

HEADERS: Mapping[str, str] = {
    "Content-Security-Policy": "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data:; "
    "connect-src 'self' {sockets}; base-uri 'none'; form-action 'none'; frame-ancestors 'none'; "
    "require-trusted-types-for 'script'",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cache-Control": "no-store",
}
"""Of every answer. ``sockets`` are the addresses of the socket: an older Safari does not count them to 'self'."""


class Role(Enum):
    """What a token lets its bearer do."""

    WATCH = "watch"
    MARK = "mark"


def _token() -> str:
    return secrets.token_urlsafe(_TOKEN_BYTES)


@dataclass(frozen=True, slots=True)
class Access:
    """Who may open the page, under which names.

    Attributes
    ----------
    hosts : frozenset of str
        Values of ``Host`` that are this server, port included. Any other is a name that somebody made point here.
    watch, mark : str
        128-bit tokens.
    """

    hosts: frozenset[str]
    watch: str = field(default_factory=_token)
    mark: str = field(default_factory=_token)

    def headers(self) -> dict[str, str]:
        """Return the headers of every answer."""
        sockets = " ".join(f"ws://{host}" for host in sorted(self.hosts))
        return {name: value.format(sockets=sockets) for name, value in HEADERS.items()}

    def refusal(self, hosts: Sequence[str], origins: Sequence[str], *, is_socket: bool) -> HTTPStatus | None:
        """Return why a request is refused, None where it may go on.

        Parameters
        ----------
        hosts, origins : sequence of str
            All values of the two headers.
        is_socket : bool
            A browser names the origin of every socket: without one, or with a foreign one, it is not our page.
        """
        if len(hosts) != 1 or hosts[0].lower() not in self.hosts:
            return HTTPStatus.MISDIRECTED_REQUEST
        ours = [f"http://{host}" for host in self.hosts]
        if is_socket and (len(origins) != 1 or origins[0].lower() not in ours):
            return HTTPStatus.FORBIDDEN
        return None

    def role(self, offered: Sequence[str]) -> Role | None:
        """Return what the subprotocols that a page offers let it do; compared in constant time."""
        given = [name.removeprefix(_BEFORE_TOKEN).encode() for name in offered if name.startswith(_BEFORE_TOKEN)]
        # Both are compared with each, so that the time tells nothing.
        marks = [hmac.compare_digest(token, self.mark.encode()) for token in given]
        watches = [hmac.compare_digest(token, self.watch.encode()) for token in given]
        return Role.MARK if any(marks) else Role.WATCH if any(watches) else None
