"""Where the page is found: the address it is bound to, the port, and the picture of it for a phone."""

from __future__ import annotations

import errno
import io
import ipaddress
import socket

import ifaddr
import segno

from imufield.dataclass import dataclass
from imufield.errors import UsageError
from imufield.sentences import Sentences

sentence = Sentences(__package__)

DEFAULT_PORT = 8777
TRIED_PORTS = 20
LOOPBACK = "127.0.0.1"
# Documentation addresses (RFC 5737, RFC 3849): a datagram socket that is connected to them sends nothing, and tells which
# interface the default route takes.
_FAR = ((socket.AF_INET, "192.0.2.1"), (socket.AF_INET6, "2001:db8::1"))


@dataclass(frozen=True, slots=True, kw_only=True)
class PageAddress:
    """A bound socket and the names it answers to.

    Attributes
    ----------
    listening : socket
    url : str
        Without the token, ends with a slash.
    hosts : frozenset of str
        Values of ``Host`` that mean this server.
    others : tuple of str
        Addresses of this machine that would have done as well.
    """

    listening: socket.socket
    url: str
    hosts: frozenset[str]
    others: tuple[str, ...] = ()
    is_in_network: bool = False
    """Whether others than this machine reach it."""


def lan_addresses() -> list[str]:
    """Return this machine's addresses in its networks, that of the default route first; link-local ones are left out."""
    routes = []
    for family, far in _FAR:
        with socket.socket(family, socket.SOCK_DGRAM) as probe:
            try:
                probe.connect((far, 9))
            # No route of this kind, IPv6 above all.
            except OSError:
                continue
            routes.append(probe.getsockname()[0])
    known = [ip.ip if isinstance(ip.ip, str) else ip.ip[0] for adapter in ifaddr.get_adapters() for ip in adapter.ips]
    usable = [address for address in dict.fromkeys([*routes, *known]) if _is_in_a_network(address)]
    # A phone is more likely to reach IPv4, and its address can be typed.
    return sorted(usable, key=lambda address: (address not in routes, ":" in address))


def _is_in_a_network(address: str) -> bool:
    parsed = ipaddress.ip_address(address.partition("%")[0])
    return not (parsed.is_loopback or parsed.is_link_local or parsed.is_unspecified or parsed.is_multicast)


def open_place(lan: str | None, port: int | None) -> PageAddress:
    """Bind the socket of the page.

    Parameters
    ----------
    lan : str or None
        Address of this machine in the network, "auto" for that of the default route, None for this machine only.
    port : int or None
        None: 8777 or the next free one.

    Raises
    ------
    UsageError
        If the address is none of this machine, there is no network, or the port is taken.
    """
    others: list[str] = []
    address = LOOPBACK
    if lan is not None:
        known = lan_addresses()
        if lan != "auto" and lan not in known:
            raise UsageError(sentence("address.not_ours", address=lan, known=known or ["none"]))
        if not known:
            raise UsageError(sentence("address.no_network"))
        address = known[0] if lan == "auto" else lan
        others = [other for other in known if other != address]
    listening = _bind(address, port)
    bound = listening.getsockname()[1]
    shown = f"[{address}]" if ":" in address else address
    names = {shown, *(("localhost",) if lan is None else ())}
    return PageAddress(
        listening=listening,
        url=f"http://{shown}:{bound}/",
        hosts=frozenset(f"{name.lower()}:{bound}" for name in names),
        others=tuple(others),
        is_in_network=lan is not None,
    )


def _bind(address: str, port: int | None) -> socket.socket:
    """Return a socket that listens at a port, or at the first free one of those that are tried."""
    ports = [port] if port is not None else range(DEFAULT_PORT, DEFAULT_PORT + TRIED_PORTS)
    family = socket.AF_INET6 if ":" in address else socket.AF_INET
    for tried in ports:
        try:
            return socket.create_server((address, tried), family=family, reuse_port=False)
        except OSError as error:
            if error.errno not in (errno.EADDRINUSE, errno.EACCES):
                raise UsageError(sentence("address.not_bound", address=address, cause=error.strerror)) from error
    raise UsageError(sentence("address.taken", address=address, ports=[ports[0], ports[-1]]))


def qr_code(url: str) -> str:
    """Return the picture of an address for a phone's camera, in half characters, dark on light or light on dark alike."""
    out = io.StringIO()
    segno.make(url, error="m", micro=False).terminal(out=out, border=2, compact=True)
    return out.getvalue()
