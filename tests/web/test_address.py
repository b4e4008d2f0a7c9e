"""Where the page is found: ports, addresses, names, and the picture for a phone."""

from __future__ import annotations

from contextlib import closing

import pytest

pytest.importorskip("segno", reason="the page needs segno")

from imufield.errors import UsageError
from imufield.web import address
from imufield.web.address import open_place, qr_code


def refusal(lan: str | None, port: int | None = None) -> str:
    with pytest.raises(UsageError) as caught:
        open_place(lan, port).listening.close()
    return str(getattr(caught.value.message, "key", None))


def test_two_sessions_at_once_have_ports_of_their_own() -> None:
    with closing((first := open_place(None, None)).listening), closing((second := open_place(None, None)).listening):
        ports = [place.listening.getsockname()[1] for place in (first, second)]
        # Other programs take and leave ports meanwhile.
        assert ports[0] != ports[1]
        assert {*ports} <= {*range(address.DEFAULT_PORT, address.DEFAULT_PORT + address.TRIED_PORTS)}
        assert first.url == f"http://127.0.0.1:{ports[0]}/"
        assert first.hosts == {f"127.0.0.1:{ports[0]}", f"localhost:{ports[0]}"}
        assert not first.is_in_network
        # One that was asked for is not replaced by another.
        assert refusal(None, ports[1]) == "address.taken"


def test_only_this_machine_unless_the_network_is_asked_for() -> None:
    with closing((place := open_place(None, None)).listening):
        assert place.listening.getsockname()[0] == "127.0.0.1"


def test_an_address_in_the_network_is_one_of_this_machine(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(address, "lan_addresses", lambda: ["127.0.0.1", "::1"])
    assert refusal("192.0.2.7") == "address.not_ours"
    with closing((place := open_place("auto", None)).listening):
        assert (place.is_in_network, place.others) == (True, ("::1",))
        # No name that somebody else could own.
        assert len(place.hosts) == 1
    monkeypatch.setattr(address, "lan_addresses", list)
    assert refusal("auto") == "address.no_network"


def test_an_address_of_version_six_stands_in_brackets(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(address, "lan_addresses", lambda: ["::1"])
    try:
        place = open_place("::1", None)
    except UsageError:
        pytest.skip("this machine has no IPv6")
    with closing(place.listening):
        port = place.listening.getsockname()[1]
        assert place.url == f"http://[::1]:{port}/"
        assert place.hosts == {f"[::1]:{port}"}


def test_addresses_of_this_machine_are_none_of_loopback() -> None:
    found = address.lan_addresses()
    assert len(found) == len(set(found))
    assert not any(ip.startswith(("127.", "169.254.", "fe80")) or ip == "::1" for ip in found)


def test_the_picture_fits_a_terminal() -> None:
    lines = qr_code("http://192.168.178.123:8777/#token=0123456789abcdefghijkl").splitlines()
    assert len(lines) <= 24
    assert all(len(line.replace("\x1b[7m", "").replace("\x1b[0m", "")) <= 80 for line in lines)
