"""Files that come up to the workbench, and addresses by which they go down."""

from __future__ import annotations

import os
import threading
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("websockets", reason="the workbench needs websockets")

from websockets.exceptions import ConnectionClosed

from imufield.web import transfers
from imufield.web.page_commands import UPLOADS
from imufield.web.workbench import LARGEST_PIECE
from tests.web.served import WAIT_S, Served
from tests.web.workbench_page import Page, page, root, served

__all__ = ["page", "root", "served"]


def send_up(page: Page, name: str, content: bytes, **more: Any) -> dict[str, Any]:
    begun = page.ask({"upload": name, "size": len(content), **more})["answer"]
    pieces = [content[start : start + 1000] for start in range(0, len(content), 1000)]
    answers = [page.ask(begun["upload"].encode() + piece)["answer"] for piece in pieces]
    assert [answer["left"] for answer in answers] == [max(0, len(content) - 1000 * (k + 1)) for k in range(len(pieces))]
    return {**begun, **answers[-1]}


def test_a_file_comes_up_in_pieces_and_others_of_its_recording_beside_it(page: Page, root: Path) -> None:
    content = os.urandom(2500)
    sent = send_up(page, "acc.csv", content)
    assert (root / sent["file"]).read_bytes() == content
    assert (root / sent["file"]).parent == root / UPLOADS / sent["folder"]
    other = send_up(page, "gyro.csv", b"1,2,3\n", folder=sent["folder"])
    assert Path(other["file"]).parent == Path(sent["file"]).parent
    # The same name again would be another file under it.
    assert "refused" in page.ask({"upload": "acc.csv", "size": 1, "folder": sent["folder"]})


@pytest.mark.parametrize("name", ["session.toml", "parameters.TOML", "x/.toml.toml"])
def test_what_would_pass_for_parameters_of_an_instrument_does_not_come_up(page: Page, root: Path, name: str) -> None:
    assert "refused" in page.ask({"upload": name, "size": 4})
    assert not (root / UPLOADS).exists()


def test_nothing_is_made_where_a_link_leads_out(page: Page, root: Path, tmp_path: Path) -> None:
    (root / UPLOADS).symlink_to(tmp_path / "elsewhere")
    assert "refused" in page.ask({"upload": "acc.csv", "size": 4})
    assert not (tmp_path / "elsewhere").exists()


def test_what_came_meanwhile_under_its_name_stays(page: Page, root: Path) -> None:
    begun = page.ask({"upload": "acc.csv", "size": 4})["answer"]
    theirs = root / UPLOADS / begun["folder"] / "acc.csv"
    theirs.write_text("theirs")
    mask = os.umask(0o027)
    try:
        sent = page.ask(begun["upload"].encode() + b"ours")["answer"]
    finally:
        os.umask(mask)
    assert (theirs.read_text(), (root / sent["file"]).read_text()) == ("theirs", "ours")
    # As any other file that this person makes, and not for the owner alone.
    assert (root / sent["file"]).stat().st_mode & 0o777 == 0o640
    assert len([*theirs.parent.iterdir()]) == 2


@pytest.mark.parametrize(
    ("name", "kept"),
    [
        ("../../etc/passwd", "passwd"), ("..\\..\\x.csv", "x.csv"), ("--output=x.csv", "output_x.csv"), ("", "file"),
        (".hidden", "hidden"), ("<b>x</b>.csv", "b_.csv"), ("a\x00\n\u202eb.csv", "a_b.csv"), ("ä $(x).csv", "ä _(x).csv"),
        ("x" * 300 + ".csv", "x" * 96 + ".csv"), ("/", "file"), ("測" * 200 + ".csv", "測" * 32 + ".csv"),
    ],
)  # fmt: skip
def test_a_name_of_a_file_leads_nowhere(page: Page, root: Path, name: str, kept: str) -> None:
    sent = send_up(page, name, b"x")
    found = root / sent["file"]
    assert found.parent.parent == root / UPLOADS
    assert found.name.lstrip("_") == kept


def test_more_than_was_said_is_refused_and_leaves_nothing(page: Page, root: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    begun = page.ask({"upload": "x.csv", "size": 3})["answer"]
    # It has its name when it is whole, and nobody else gets that name.
    assert not (root / UPLOADS / begun["folder"] / "x.csv").exists()
    assert "refused" in page.ask({"upload": "x.csv", "size": 3, "folder": begun["folder"]})
    assert "refused" in page.ask(begun["upload"].encode() + b"four")
    assert [*(root / UPLOADS).iterdir()] == []
    assert "refused" in page.ask(begun["upload"].encode() + b"one")
    monkeypatch.setattr(transfers, "LARGEST_UPLOAD", 1000)
    assert "refused" in page.ask({"upload": "x.csv", "size": 1001})
    for _ in range(transfers.UPLOADS_AT_ONCE):
        page.ask({"upload": "x.csv", "size": 3})
    assert "refused" in page.ask({"upload": "x.csv", "size": 3})
    # Those of a page that went away make room.
    monkeypatch.setattr(transfers, "GOOD_FOR_S", 0.0)
    assert "answer" in page.ask({"upload": "x.csv", "size": 3})


def test_an_upload_ends_with_its_page(served: Served, page: Page, root: Path) -> None:
    begun = page.ask({"upload": "y.csv", "size": 3})["answer"]
    before = {*threading.enumerate()}
    with served.open() as line:
        closed = Page(line)
        for _ in range(transfers.UPLOADS_AT_ONCE - 1):
            closed.ask({"upload": "x.csv", "size": 3})
    for thread in {*threading.enumerate()} - before:
        thread.join(WAIT_S)
    assert "answer" in page.ask({"upload": "x.csv", "size": 3})
    # Of those that ended nothing is left, and what another page sends goes on.
    assert page.ask(begun["upload"].encode() + b"one")["answer"]["left"] == 0
    assert len([*(root / UPLOADS).iterdir()]) == 2


def test_a_giant_piece_closes_its_page_only(served: Served, page: Page) -> None:
    with served.open() as giant:
        giant.send(b"x" * (LARGEST_PIECE + 1))
        with pytest.raises(ConnectionClosed):
            next(None for _ in range(1000) if giant.recv(timeout=WAIT_S) is None)
    assert "address" in page.ask({"file": "one/parameters.toml"})["answer"]


# Files that go down


def test_an_address_is_good_once_and_for_a_minute(served: Served, page: Page, monkeypatch: pytest.MonkeyPatch) -> None:
    address = page.ask({"file": "one/parameters.toml"})["answer"]["address"]
    assert len(address.removeprefix("/file/")) == 22
    answer = served.get(address)
    assert (answer.status, answer.read()) == (200, b"of one")
    assert answer.getheader("Content-Disposition") == "attachment; filename*=UTF-8''parameters.toml"
    assert answer.getheader("Content-Type") == "application/octet-stream"
    assert answer.getheader("X-Content-Type-Options") == "nosniff"
    assert "default-src 'none'" in answer.getheader("Content-Security-Policy", "")
    assert served.get(address).status == 404
    assert served.get("/file/").status == served.get("/file/../one/parameters.toml").status == 404
    late = page.ask({"file": "one/parameters.toml"})["answer"]["address"]
    monkeypatch.setattr(transfers, "GOOD_FOR_S", 0.0)
    assert served.get(late).status == 404


def test_what_became_a_link_since_is_not_given_away(served: Served, page: Page, root: Path) -> None:
    address = page.ask({"file": "one/parameters.toml"})["answer"]["address"]
    (root / "one" / "parameters.toml").unlink()
    (root / "one" / "parameters.toml").symlink_to(root.resolve().parent / "secret")
    assert served.get(address).status == 404


def test_names_with_markup_and_a_file_that_is_too_large(
    served: Served, page: Page, root: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (root / '<img src=x onerror="alert(1)">.html').write_text("<script>")
    answer = served.get(page.ask({"file": '<img src=x onerror="alert(1)">.html'})["answer"]["address"])
    assert "<" not in answer.getheader("Content-Disposition", "")
    assert answer.getheader("Content-Type") == "application/octet-stream"
    monkeypatch.setattr(transfers, "LARGEST_DOWNLOAD", 3)
    assert "refused" in page.ask({"file": "one/parameters.toml"})


def test_only_the_newest_addresses_are_kept(served: Served, page: Page, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(transfers, "ADDRESSES_AT_ONCE", 2)
    addresses = [page.ask({"file": "one/parameters.toml"})["answer"]["address"] for _ in range(3)]
    assert [served.get(address).status for address in addresses] == [404, 200, 200]
