"""Who gets in: tokens, the names this server answers to, and the headers that keep a page to itself.

A page has no cookie and sends no form: the token stands in the fragment of its address, which no server and no log sees, and
goes back as a subprotocol of the socket, the one header that a browser lets a script set (as Jupyter's tokens,
jupyter_server, docs/source/operators/security.rst, but never in a query).
"""

from __future__ import annotations

import hmac
import secrets
import time
from collections.abc import Mapping, Sequence
from enum import Enum
from http import HTTPStatus

from imufield.dataclass import dataclass, field

PROTOCOL = "imufield"
"""The subprotocol that the server answers with: the token is never sent back."""
BEFORE_TOKEN = "token."  # noqa: S105  (what stands before one)
_TOKEN_BYTES = 16
ONCE_S = 60.0
"""For a browser that has to be started first."""

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
    _once: dict[str, tuple[Role, float]] = field(default_factory=dict, init=False)

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

    def once(self, role: Role) -> str:
        """Return a token that lets one page in: it becomes an argument of the browser, where other users can see it."""
        token = _token()
        self._once[token] = role, time.monotonic()
        return token

    def spend(self, offered: Sequence[str]) -> str | None:
        """Return the lasting token in exchange for one that is good once, and by this no more; None where none is offered."""
        for name in offered:
            role, made_s = self._once.pop(name.removeprefix(BEFORE_TOKEN), (None, 0.0))
            if role is not None and time.monotonic() - made_s < ONCE_S:
                return self.mark if role is Role.MARK else self.watch
        return None

    def role(self, offered: Sequence[str]) -> Role | None:
        """Return what the subprotocols that a page offers let it do; compared in constant time."""
        tokens = [name.removeprefix(BEFORE_TOKEN) for name in offered if name.startswith(BEFORE_TOKEN)]
        known = [
            (self.mark, Role.MARK),
            (self.watch, Role.WATCH),
            # A copy: pages of other threads spend theirs meanwhile.
            *((token, role) for token, (role, made_s) in [*self._once.items()] if time.monotonic() - made_s < ONCE_S),
        ]
        # No token has half a surrogate pair in it, nor the question mark that stands for one here.
        given = [token.encode(errors="replace") for token in tokens]
        # All are compared with each, so that the time tells nothing.
        roles = [role for token, role in known for each in given if hmac.compare_digest(each, token.encode())]
        return Role.MARK if Role.MARK in roles else Role.WATCH if roles else None
