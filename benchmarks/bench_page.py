"""The page: from a sample to the frame that shows it, frames a second, what server and guide pay for it, bytes to load.

A virtual instrument is turned in real time and read in blocks of 20 ms as a port is; a guide, a page of it and a server stand
in this process, a headless browser draws it on a phone's screen without a graphics card, and clients without a browser read
a server in a process of its own. Nothing else should run: half of it is waiting for a turn of the processor.
"""

from __future__ import annotations

import gzip
import json
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from typing import Any

import numpy as np
from websockets.sync.client import connect
from websockets.typing import Origin, Subprotocol

from imufield.commands.terminal.page import SHOWN_EVERY_S
from imufield.guide.lead.guide import Guide
from imufield.guide.positions import scheme
from imufield.simulate.truth.grades import TACTICAL, perfect_instrument
from imufield.simulate.truth.imu import Imu, ImuSettings
from imufield.simulate.truth.operator import Operator, OperatorSettings
from imufield.web.access import PROTOCOL, Access
from imufield.web.address import PageAddress, open_place
from imufield.web.guide_page import GuidePage
from imufield.web.server import PageServer
from tests.web.browser import Screens, open_browser

RATE_HZ = 250.0
BLOCK = 5  # Samples of one read of a port: 20 ms.
MEASURED_S = 20.0
FRAMES_S = 5.0
CLIENTS = (1, 8, 50)
CLIENTS_S = 10.0

# The page says how many samples are lost; here it is the number of the state, and the time is that of the frame's end.
_WATCH = """() => {
  window.shown = [];
  new MutationObserver(() => {
    const found = document.querySelector("#rate").textContent.match(/(\\d+) samples lost/);
    if (!found) return;
    const note = () => window.shown.push([Number(found[1]), performance.timeOrigin + performance.now()]);
    requestAnimationFrame(() => setTimeout(note));
  }).observe(document.querySelector("#rate"), { childList: true, characterData: true, subtree: true });
}"""
_FRAMES = """(seconds) => new Promise((resolve) => {
  let count = 0, begin = 0;
  const frame = (now) => {
    begin ||= now;
    if (now - begin >= seconds * 1000) return resolve(count / (now - begin) * 1000);
    count += 1;
    requestAnimationFrame(frame);
  };
  requestAnimationFrame(frame);
})"""
_LOADED = "() => performance.getEntriesByType('resource').map((entry) => new URL(entry.name).pathname)"


class Turned:
    """A guide that hears an instrument being turned, block after block."""

    def __init__(self) -> None:
        positions = scheme("paper24")
        self._imu = Imu(perfect_instrument(TACTICAL), 7, ImuSettings(rate_hz=RATE_HZ))
        self._operator = Operator(np.tile(positions.directions(), (4, 1)), 7, OperatorSettings(hold_s=3.0, initial_still_s=5.0))
        self.guide = Guide(positions, self._imu.instrument.grade.units)
        self.page = GuidePage(positions, session="bench", instrument="virtual", cable="-x")
        self._first = 0

    def feed(self) -> float:
        """Feed the next block and return the processor time of the guide for it, in seconds."""
        samples = self._imu.feed(self._operator.block(self._first, BLOCK, self._imu.interval_s))
        self._first += BLOCK
        began_s = time.thread_time()
        events = self.guide.feed(samples)
        spent_s = time.thread_time() - began_s
        self.page.show(events)
        return spent_s

    def show(self, number: int) -> float:
        """Put the present state on the board and return the processor time for it, in seconds."""
        began_s = time.thread_time()
        self.page.refresh(self.guide.snapshot(), silent=False, samples_lost=number)
        return time.thread_time() - began_s


@contextmanager
def served(turned: Turned) -> Iterator[tuple[PageAddress, Access]]:
    """Serve the page of a guide."""
    place = open_place(None, None)
    access = Access(place.hosts)
    with PageServer(place.listening, access, turned.page.board, turned.page.mark):
        yield place, access


def real_time(turned: Turned, seconds: float) -> tuple[list[tuple[float, int]], list[float], list[float]]:
    """Feed in real time; return arrival of each block with the number of the state that shows it, and what both steps cost."""
    arrivals: list[tuple[float, int]] = []
    fed_s: list[float] = []
    shown_s: list[float] = []
    begin_s, last_s, number = time.monotonic(), 0.0, 1
    for block in range(round(seconds * RATE_HZ / BLOCK)):
        time.sleep(max(begin_s + block * BLOCK / RATE_HZ - time.monotonic(), 0.0))
        arrivals.append((1e3 * time.time(), number))
        fed_s.append(turned.feed())
        if time.monotonic() - last_s >= SHOWN_EVERY_S:
            last_s = time.monotonic()
            shown_s.append(turned.show(number))
            number += 1
    # What came behind the last state, too: every sample has one that shows it.
    turned.show(number)
    return arrivals, fed_s, shown_s


def in_the_browser() -> list[dict[str, Any]]:
    """Latency, frames, bytes and the guide's cost with a page that looks."""
    turned = Turned()
    alone_us = _mean_us(real_time(turned, MEASURED_S)[1])
    with served(turned) as (place, access), open_browser() as browser:
        screens = Screens(browser)
        page = screens.open(f"{place.url}#token={access.mark}", calm=False)
        page.evaluate(_WATCH)
        found: list[Any] = []
        feeding = threading.Thread(target=lambda: found.extend(real_time(turned, MEASURED_S)))
        feeding.start()
        page.wait_for_timeout(1000 * (MEASURED_S - FRAMES_S) / 2)
        frames = page.evaluate(_FRAMES, FRAMES_S)
        while feeding.is_alive():
            page.wait_for_timeout(200)
        newest = max(number for _, number in found[0])
        shown: dict[int, float] = {}
        while max(shown, default=0) < newest:
            page.wait_for_timeout(200)
            shown = {int(number): time_ms for number, time_ms in page.evaluate("window.shown")}
        paths = ["/", *page.evaluate(_LOADED)]
        screens.close()
    arrivals, fed_s, shown_s = found
    late_ms = [_first_from(shown, number) - arrived for arrived, number in arrivals]
    bytes_raw, bytes_packed = _loaded(paths)
    median, worst = np.percentile(late_ms, [50, 99])
    return [
        {"name": "sample to the frame that shows it, median", "value": median, "unit": "ms"},
        {"name": "sample to the frame that shows it, 99 %", "value": worst, "unit": "ms"},
        {"name": "frames, 390 x 844, software rendering", "value": frames, "unit": "frames/s"},
        {
            "name": "guide: 20 ms block, with a page (peer: without)",
            "value": _mean_us(fed_s),
            "unit": "us",
            "peer": alone_us,
        },
        {"name": "state of the page, made 20 times a second", "value": _mean_us(shown_s), "unit": "us"},
        {"name": "page, all in, compressed", "value": bytes_packed / 1e3, "unit": "kB"},
        {"name": "page, all in, as it is sent", "value": bytes_raw / 1e3, "unit": "kB"},
    ]


def _first_from(shown: dict[int, float], number: int) -> float:
    """Return when a state was shown, or where a frame has passed over it the next one, however much later."""
    return min(time_ms for later, time_ms in shown.items() if later >= number)


def _loaded(paths: list[str]) -> tuple[int, int]:
    from imufield.web.server import static_files

    contents = [static_files()[path][1] for path in set(paths) if path in static_files()]
    return sum(map(len, contents)), sum(len(gzip.compress(content)) for content in contents)


def _mean_us(seconds: list[float]) -> float:
    return 1e6 * sum(seconds) / len(seconds)


def serve_states(seconds: float) -> None:
    """Serve the states of a session that was played before, 20 a second; print the address, then the share of a core."""
    turned = Turned()
    for _ in range(1000):
        turned.feed()
    with served(turned) as (place, access):
        turned.show(0)
        print(json.dumps({"url": place.url, "token": access.watch}), flush=True)
        sys.stdin.readline()
        spent_s = 0.0
        before_s, begin_s = time.process_time(), time.monotonic()
        for number in range(round(seconds / SHOWN_EVERY_S)):
            time.sleep(max(begin_s + number * SHOWN_EVERY_S - time.monotonic(), 0.0))
            # What makes the states is not the server's.
            began_s = time.thread_time()
            for _ in range(2):
                turned.feed()
            turned.show(number)
            spent_s += time.thread_time() - began_s
        share = (time.process_time() - before_s - spent_s) / (time.monotonic() - begin_s)
    print(json.dumps(100 * share), flush=True)


def server_share(clients: int) -> float:
    """Return the share of a core, in percent, of a server with so many pages."""
    command = [sys.executable, "-c", f"from benchmarks.bench_page import serve_states; serve_states({CLIENTS_S})"]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as server, ExitStack() as stack:
        assert server.stdin is not None
        assert server.stdout is not None
        told = json.loads(server.stdout.readline())
        for _ in range(clients):
            stack.enter_context(_client(told["url"], told["token"]))
        server.stdin.write("\n")
        server.stdin.flush()
        return float(json.loads(server.stdout.readline()))


@contextmanager
def _client(url: str, token: str) -> Iterator[None]:
    host = url.removeprefix("http://").rstrip("/")
    names = [Subprotocol(PROTOCOL), Subprotocol(f"token.{token}")]
    with connect(f"ws://{host}/socket", origin=Origin(f"http://{host}"), subprotocols=names) as connection:
        reading = threading.Thread(target=lambda: [None for _ in connection])
        reading.start()
        yield
    reading.join()


def run() -> list[dict[str, Any]]:
    """Return rows of name, value, unit."""
    rows = in_the_browser()
    for clients in CLIENTS:
        name = f"server, {clients} page{'s' * (clients > 1)}, 20 states/s"
        rows.append({"name": name, "value": server_share(clients), "unit": "% of a core"})
    return rows


if __name__ == "__main__":
    for row in run():
        print(f"{row['name']:55} {row['value']:>8.1f} {row['unit']}" + (f"  peer {row['peer']:.1f}" if "peer" in row else ""))
