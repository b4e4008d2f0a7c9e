"""A page that was away: from its return to the frame that shows what is true by then, 50 times each.

It is reloaded, or its phone sleeps, or its network is cut, for up to four seconds in which the state of the session changes. A
network that is joined again tells the page nothing: it finds out by itself. Nothing else should run.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import TYPE_CHECKING, Any
from urllib.parse import urlsplit

import numpy as np

from tests.web.browser import Screens, open_browser
from tests.web.guide_stages import StagedSession
from tests.web.network import ARGUMENT, Network

if TYPE_CHECKING:
    from playwright.sync_api import Page

TIMES = 50
AWAY_S = (0.1, 4.0)


def leave(kind: str, page: Page, network: Network) -> Callable[[], object]:
    """Take a page away; return what brings it back."""
    if kind == "reload":
        return lambda: page.reload(wait_until="commit")
    if kind == "network":
        network.cut()
        return network.join
    phone = page.context.new_cdp_session(page)
    phone.send("Page.setWebLifecycleState", {"state": "frozen"})
    return lambda: phone.send("Page.setWebLifecycleState", {"state": "active"})


def run() -> list[dict[str, Any]]:
    """Return rows of name, value, unit."""
    rows: list[dict[str, Any]] = []
    staged, rng = StagedSession(), np.random.default_rng(1)
    next(staged.stages())
    with staged.served() as (_, url), open_browser(ARGUMENT) as browser, Network(urlsplit(url).port or 0) as network:
        screens = Screens(browser)
        page = screens.open(url.replace("127.0.0.1", "localhost"))
        staged.wait_for(page, "")
        for kind in ("reload", "sleep", "network"):
            late_ms = []
            for _ in range(TIMES):
                bring_back = leave(kind, page, network)
                time.sleep(0.0 if kind == "reload" else rng.uniform(*AWAY_S))
                staged.mark("pause")
                begin_s = time.perf_counter()
                bring_back()
                staged.wait_for(page, "")
                late_ms.append(1e3 * (time.perf_counter() - begin_s))
                is_paused = staged.guide.snapshot().state.name == "PAUSED"
                assert ("PAUSED" in page.locator("#headline").inner_text()) == is_paused
            for name, value in (("median", np.median(late_ms)), ("longest", max(late_ms))):
                rows.append({"name": f"page back after {kind}, {name} of {TIMES}", "value": float(value), "unit": "ms"})
        screens.close()
    return rows


if __name__ == "__main__":
    for row in run():
        print(f"{row['name']:55} {row['value']:>8.1f} {row['unit']}")
