"""A link read ahead: order, errors at their place, reopening, and nothing lost while nobody reads."""

from __future__ import annotations

import itertools
import os
import threading
import time
import tty
from collections.abc import Iterator

import pytest

from imufield.acquire.link.background import BackgroundLink
from imufield.acquire.link.serial import Chunk, open_link
from imufield.errors import LinkError
from tests.interrupts import ends, interrupted_at


class Scripted:
    """A link that returns what it is told to; None and errors included."""

    def __init__(self, *items: bytes | Exception | None) -> None:
        self.name = "scripted"
        self.items: list[bytes | Exception | None] = list(items)
        self.written: list[bytes] = []
        self.closed = False
        self.there = False

    def read(self) -> Chunk | None:
        if not self.items:
            time.sleep(0.01)
            return None
        item = self.items.pop(0)
        if isinstance(item, Exception):
            raise item
        return None if item is None else Chunk(item, 0.0, 0)

    def write(self, data: bytes) -> None:
        self.written.append(data)

    def reopen(self) -> bool:
        return self.there

    def close(self) -> None:
        self.closed = True


def read_until(link: BackgroundLink, count: int) -> list[bytes]:
    found: list[bytes] = []
    end_s = time.monotonic() + 60
    while len(found) < count and time.monotonic() < end_s:
        chunk = link.read()
        if chunk is not None:
            found.append(chunk.data)
    return found


def test_order_then_the_error_then_open_again() -> None:
    inner = Scripted(b"a", None, b"b", LinkError("gone"))
    link = BackgroundLink(inner)
    assert read_until(link, 2) == [b"a", b"b"]
    with pytest.raises(LinkError, match="gone"):
        read_until(link, 3)
    assert not link.reopen()
    inner.there, inner.items = True, [b"c"]
    assert link.reopen()
    assert read_until(link, 1) == [b"c"]
    link.write(b"R\r")
    link.close()
    link.close()
    assert inner.written == [b"R\r"]
    assert inner.closed


def test_a_defect_is_raised_where_it_is_seen() -> None:
    link = BackgroundLink(Scripted(ZeroDivisionError("a defect")))
    with pytest.raises(ZeroDivisionError):
        read_until(link, 1)
    link.close()


def test_nothing_arrives() -> None:
    link = BackgroundLink(Scripted())
    assert link.read() is None
    assert link.drain() == []
    link.close()


def test_what_was_not_read_is_there_in_the_end() -> None:
    inner = Scripted(b"a", b"b", b"c")
    link = BackgroundLink(inner)
    assert read_until(link, 1) == [b"a"]
    link.close()
    assert [chunk.data for chunk in link.drain()] + inner.items == [b"b", b"c"]


def test_what_is_read_while_the_link_is_closed_is_there_in_the_end() -> None:
    begun = threading.Event()

    class Slow(Scripted):
        def read(self) -> Chunk | None:
            begun.set()
            time.sleep(0.2)
            return super().read()

    inner = Slow(b"a", b"b", b"c")
    link = BackgroundLink(inner)
    assert begun.wait(60)
    link.close()
    assert [chunk.data for chunk in link.drain()] + inner.items == [b"a", b"b", b"c"]


@pytest.fixture
def port() -> Iterator[tuple[int, str]]:
    master, slave = os.openpty()
    tty.setraw(slave)
    yield master, os.ttyname(slave)
    os.close(master)
    os.close(slave)


def test_nothing_is_lost_while_nobody_reads(port: tuple[int, str]) -> None:
    link = BackgroundLink(open_link(port[1], baud=921600))
    # More than the system keeps of a terminal: without the thread this would wait for ever.
    data = bytes(range(256)) * 2000
    sent = 0
    while sent < len(data):
        sent += os.write(port[0], data[sent : sent + 4096])
    received = b""
    while len(received) < len(data):
        # On a busy machine the thread may not run for longer than a read waits.
        if (chunk := link.read()) is not None:
            received += chunk.data
    assert received == data
    link.close()


@pytest.mark.parametrize("items", [(), (b"a", b"b")], ids=["silent", "sending"])
def test_an_interrupt_leaves_the_link_whole(items: tuple[bytes, ...]) -> None:
    for moment in itertools.count(1):
        link = BackgroundLink(Scripted(*items))
        was_interrupted = interrupted_at(moment, link.read)
        assert ends(link.drain)
        assert ends(link.close)
        if not was_interrupted:
            break
    assert moment > 1
