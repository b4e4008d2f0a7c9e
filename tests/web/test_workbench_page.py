"""The workbench in a real browser: from an empty folder to a parameter file, by what a newcomer finds on the page."""

from __future__ import annotations

import itertools
import math
import os
import re
import signal
import socket
import subprocess
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from imufield.deliver.parameters.file import load
from imufield.earth import STANDARD_GRAVITY_M_S2
from imufield.guide.positions import scheme
from imufield.web.page_commands import VIRTUAL
from tests.commands.conftest import SPEED, Program
from tests.web.page_session import wait_for
from tests.web.test_page_looks import AXE, RUN_AXE, SIZES

if TYPE_CHECKING:
    from playwright.sync_api import Page

    from imufield.deliver.parameters.file import Parameters
    from tests.web.browser import Screens

pytest.importorskip("websockets", reason="the workbench needs websockets")

RATE_HZ = 50.0
STILL_S, TURN_S = 5.0, 1.0
SCALE, BIAS_M_S2, SIGMA_M_S2 = np.array([1.003, 0.998, 1.001]), np.array([0.02, -0.03, 0.01]), 0.004


@pytest.fixture
def address(program: Program) -> str:
    """Start the workbench in an empty folder and return where it is."""
    return start(program)


def start(program: Program, port: int | None = None) -> str:
    """Start it at a port of its own: the usual ones may be taken or given up by others at any moment."""
    if port is None:
        with socket.create_server(("127.0.0.1", 0)) as free:
            port = free.getsockname()[1]
    variables = {"DISPLAY": "", "WAYLAND_DISPLAY": "", "IMUFIELD_CLOCK_SPEED": f"{SPEED:g}"}
    process = program.start("web", "--web-port", port, variables=variables)
    assert process.stderr is not None
    found = re.search(r"http://\S+", process.stderr.readline())
    assert found is not None
    return found[0]


def table_of_stills(path: Path) -> None:
    """Write a log as a home-made logger does: no time, and a gyroscope that lay still."""
    rng = np.random.default_rng(7)
    ups = scheme("paper24").directions()
    held, turned = round(STILL_S * RATE_HZ), round(TURN_S * RATE_HZ)
    force = [ups[0]]
    for before, up in itertools.pairwise(ups):
        force += [before] * held
        way = before + np.linspace(0, 1, turned)[:, None] * (up - before + np.cross(before, up) + 1e-3)
        force += [*(way / np.linalg.norm(way, axis=1, keepdims=True))]
    force += [ups[-1]] * held
    values = 9.80665 * np.array(force) * SCALE + BIAS_M_S2 + rng.normal(0, SIGMA_M_S2, (len(force), 3))
    rows = "\n".join(",".join(f"{value:.5f}" for value in row) for row in values)
    path.write_text(f"first,second,third\n{rows}\n")


PARTS = {"#history": "#instruments h3", "#sessions": "#list a", "#import": "#drop", "#calibrate": "#start"}
# A table scrolls in its own frame, but for those whose cells stack.
WIDER = """() => [...document.querySelectorAll("body *")]
    .filter((element) => !element.closest(".wide:not(.stacks) > *") && element.checkVisibility())
    .filter((element) => element.getBoundingClientRect().right > innerWidth + 1)
    .map((element) => element.id || element.tagName)"""

# Names of positions, and those of them whose side is in two lines.
CUT = """() => {
    const names = [...document.querySelectorAll(".holds span")].map((span) => span.firstChild);
    const cut = names.filter((name) => {
        const range = document.createRange();
        range.setStart(name, name.data.search(/[^ ]*$/));
        range.setEnd(name, name.length);
        return range.getClientRects().length !== 1;
    });
    return [names, cut].map((each) => each.map((name) => name.data));
}"""

DRAGGED = """([name, text]) => {
    const dragged = new DataTransfer();
    dragged.items.add(new File([text], name));
    return dragged;
}"""


def assert_it_is_for_everybody(page: Page) -> None:
    """Look at each part on each screen: nothing sticks out, and axe-core finds no barrier."""
    if AXE.exists():
        page.evaluate(AXE.read_text(encoding="utf-8"))
    assert barriers(page) == []
    for part, shown in PARTS.items():
        page.locator(f'header a[href="{part}"]').click()
        page.locator(shown).first.wait_for()
        assert barriers(page) == [], part


def assert_sides_are_whole(page: Page) -> None:
    """Look whether a line ends inside the name of a side: "near -" with "y" below it reads as +y."""
    for width, height in SIZES:
        page.set_viewport_size({"width": width, "height": height})
        names, cut = page.evaluate(CUT)
        assert cut == []
        assert any("\u2212" in name for name in names)
        assert page.locator(".holds b", has_text=re.compile("^-")).count() == 0


def barriers(page: Page) -> list[str]:
    found = []
    for width, height in SIZES:
        page.set_viewport_size({"width": width, "height": height})
        found += [f"{width}: {what}" for what in page.evaluate(WIDER)]
    for colours in ("light", "dark") if AXE.exists() else ():
        page.emulate_media(color_scheme=colours)
        found += page.evaluate(RUN_AXE)
    return found


def assert_each_angle_stands_below_its_axis(page: Page, found: Parameters) -> None:
    """Compare with the file, whose rows are sensing axes."""
    shown = page.locator("#result td[data-head]", has_text=re.compile("^[xyz]{2} ")).all()
    angles = [(str(cell.get_attribute("data-head")), *cell.inner_text().split()[:2]) for cell in shown]
    assert [(axis, pair) for axis, pair, _ in angles] == [("y", "yx"), ("z", "zx"), ("z", "zy")]
    exact_rad = found.calibration.accelerometer.misalignment_rad
    for _, pair, mrad in angles:
        # Half of the last digit that is shown.
        half = 0.51 * 10 ** -len(mrad.partition(".")[2])
        assert float(mrad) == pytest.approx(1e3 * exact_rad["xyz".index(pair[0]), "xyz".index(pair[1])], abs=half)


# The browser and some fifteen programs, six positions of an emulated instrument among them: once, for the whole way.
def test_from_an_empty_folder_to_the_files(program: Program, screens: Screens, address: str) -> None:
    # A person who shows five sides, and the last one when asked to: the guide cannot end before.
    port = program.emulate("--wait", "--poses", "-", stdin=subprocess.PIPE)
    person = program.started[-1]
    assert person.stdin is not None
    person.stdin.write("+z\n+x\n-x\n+y\n-y\n")
    person.stdin.flush()
    page = screens.open(address)
    assert "token" not in page.url
    # What has a field on the page is named as that.
    wait_for(page, "#plan-says", "Give “Latitude” and “Height” .* “measured gravity”")
    wait_for(page, "#plan-says", "Give “Class of the instrument”, or imufield plan --noise-ug")
    page.get_by_text("by hand").click()
    page.get_by_label("Port", exact=True).fill(port)
    page.get_by_label("Latitude").first.fill("45")
    page.get_by_label("Height").first.fill("0")
    page.locator("[name=positions]").select_option("faces6")
    page.get_by_label("Name of the session").fill("first")
    # How long it takes is said before, for what was chosen.
    page.get_by_label("Class of the instrument").select_option("navigation")
    # What is too large for a number is refused as it was typed.
    page.get_by_label("Bias wanted to").fill("1e999")
    page.get_by_label("Bias wanted to").blur()
    wait_for(page, "#plan-says", "1e999")
    page.get_by_label("Bias wanted to").fill("")
    page.get_by_label("Bias wanted to").blur()
    wait_for(page, "#plan-says", "^6 positions with holds of 3 s")
    wait_for(page, "#commands code", "imufield plan --json --positions=faces6 --latitude=45 --height=0 --grade=navigation")
    assert ".." not in page.locator("#plan-says").inner_text()
    page.get_by_role("button", name="Start the guide").click()
    page.locator("#start:disabled + [role=status]").wait_for()
    # The guide has a page of its own, and leads back to where the session is.
    wait_for(page, "#headline", "TURN|HOLD|STAY|DONE|still")
    assert page.url.split(":")[2] != address.split(":")[2]
    page.locator("#back").click()
    wait_for(page, "#under-way", "Session first: 5 of 6")
    person.stdin.write("-z\n")
    person.stdin.flush()
    page.get_by_role("button", name="Compute the result").click()
    wait_for(page, "#verdict", "POOR")  # Six positions have six parameters: nothing is left to check them.
    parameters = load(program.folder / "imufield-sessions" / "first")
    assert len(parameters.document["position"]) == 6
    quality = parameters.calibration.quality
    assert page.locator("#result details li").count() == len(quality.reasons) - len(quality.warnings)

    # What PX4 does not use the file without is asked for.
    page.get_by_label("Program").select_option("px4")
    page.get_by_label("CAL_ACC0_ID").fill("1310988")
    page.get_by_role("button", name="Make the file").click()
    wait_for(page, "#commands code", "export .*--to=px4 --set=accelerometer_id=1310988")
    page.get_by_role("button", name="Make the report").click()
    wait_for(page, "#made", r"report\.html")
    page.get_by_label("Program").select_option("c")
    assert not page.locator("#asked input").count()
    page.get_by_role("button", name="Make the file").click()
    with page.expect_download() as saved:
        page.get_by_role("button", name=re.compile(r"Save .*\.h$")).click()
    assert "#define" in Path(saved.value.path()).read_text()
    with page.expect_download() as saved:
        page.get_by_role("button", name="Save parameters.toml").click()
    assert Path(saved.value.path()).read_bytes() == (program.folder / "imufield-sessions/first/parameters.toml").read_bytes()
    # Whatever was done is shown as what a person could have typed.
    for words in ("capture .*--session=imufield-sessions/first", "solve .*imufield-sessions/first", "export .*--to=c"):
        wait_for(page, "#commands code", f"imufield {words}")
    assert_it_is_for_everybody(page)
    # What was recorded is seen again, as fast as one likes.
    page.locator('header a[href="#sessions"]').click()
    page.get_by_role("link", name="first").click()
    page.get_by_label("times as fast").fill("2.5")
    page.get_by_role("button", name="Replay").click()
    page.locator("#recording", has_text="2.5").wait_for()
    page.locator("#back").click()
    wait_for(page, "#commands code", "imufield replay --web --json imufield-sessions/first --speed=2.5")
    page.locator("#under-way button", has_text="Stop").click()
    page.locator("#under-way button", has_text="again").click()
    page.locator("#under-way > div").wait_for(state="detached")
    assert screens.console == []
    # Another one knows neither this page nor what was done here; the folder tells it.
    program.started[0].kill()
    program.started[0].wait()
    address = start(program, int(address.split(":")[2].partition("/")[0]))
    wait_for(page, "#link", "open the address")
    # A tab is chosen before the page has seen its new address.
    page.evaluate("address => { location.href = address; location.hash = 'sessions'; }", address)
    page.get_by_role("link", name="first").click()
    wait_for(page, "#verdict", "POOR")
    assert page.get_by_role("button", name=re.compile(r"Save .*\.h$")).is_visible()


# The browser and six programs.
PARAMETERS_OF = """async (found) => {
    const { SessionView } = await import("./session.js");
    const shown = SessionView.prototype.parameters.call(SessionView.prototype, found);
    return [...shown.querySelectorAll("tbody tr")].map((row) => [...row.children].map((cell) => cell.textContent));
}"""


def test_every_parameter_that_was_fitted_is_shown(screens: Screens, address: str) -> None:
    page = screens.open(address)
    micro, per_g = 1e-6 / STANDARD_GRAVITY_M_S2, math.radians(1 / 3600) / STANDARD_GRAVITY_M_S2
    zero, angles = [0.0] * 3, {"misalignment_rad": [[0.0] * 3] * 3}
    accelerometer: dict[str, Any] = {"raw_unit": "count", "scale": [100.0] * 3, "bias_m_s2": zero, **angles}
    sigma: dict[str, Any] = {"scale": [1.0] * 3, "bias_m_s2": [1.0] * 3, **angles}
    accelerometer |= {"quadratic_fitted": True, "quadratic": [300 * micro, 0.0, 0.0], "uncertainty": sigma}
    sigma["quadratic"] = [100 * micro] * 3
    higher = {"cubic": zero, "cubic_sigma": [1.0] * 3, "cross": [zero, [0.0, 4 * micro, 0.0], zero]}
    accelerometer["higher"] = {**higher, "cross_sigma": [[2 * micro] * 3] * 3}
    gyroscope: dict[str, Any] = {"raw_unit": "count", "scale": [2.0] * 3, "bias_rad_s": zero, **angles}
    gyroscope["g_sensitivity"] = [zero, [0.0, 0.0, 40 * per_g], zero]
    sigma = {"scale": [0.5] * 3, "bias_rad_s": [1.0] * 3, "g_sensitivity": [[2 * per_g] * 3] * 3, **angles}
    gyroscope["uncertainty"] = sigma
    found = {"accelerometer": accelerometer, "gyroscope": gyroscope}
    rows = page.evaluate(PARAMETERS_OF, found)
    assert ["accelerometer quadratic term", "µg/g²", "3.0 ± 1.0", "0.0 ± 1.0", "0.0 ± 1.0"] in rows
    assert ["accelerometer cross term xz", "µg/g²", "0.0 ± 2.0", "4.0 ± 2.0", "0.0 ± 2.0"] in rows
    assert "accelerometer cubic term" in {row[0] for row in rows}
    assert ["gyroscope scale", "count per rad/s", "2.00 ± 0.50", "2.00 ± 0.50", "2.00 ± 0.50"] in rows
    assert ["gyroscope g-sensitivity", "deg/h/g", "xz 0.0 ± 1.0", "yz 20.0 ± 1.0", "zz 0.0 ± 1.0"] in rows
    # Of terms that were not fitted there is no row.
    sigma["g_sensitivity"] = [[None] * 3] * 3
    accelerometer["quadratic_fitted"] = False
    del accelerometer["higher"]
    rows = page.evaluate(PARAMETERS_OF, found)
    assert not [row for row in rows if "term" in row[0] or "sensitivity" in row[0]]


def test_a_session_of_a_virtual_instrument_is_stopped_and_goes_on(program: Program, screens: Screens, address: str) -> None:
    page = screens.open(address)
    for _ in range(2):
        page.get_by_role("button", name="virtual").click()
    page.get_by_label("Name of the session").fill("first")
    page.get_by_role("button", name="Start the guide").click()
    emulated = page.locator("#commands li", has=page.locator("code", has_text="imufield emulate"))
    for stops in (1, 2):
        wait_for(page, "#headline", "TURN|HOLD|STAY|DONE|still")
        page.locator("#back").click()
        wait_for(page, "#under-way", "Session first")
        page.get_by_role("button", name="Stop, go on later").click()
        page.get_by_role("button", name="Tap again to stop").click()
        # What was begun for it ends with it.
        emulated.first.get_by_text("stopped").wait_for()
        assert emulated.count() == stops
        if stops == 1:
            page.get_by_role("button", name="Go on with the positions").click()
    assert not (program.folder / "imufield-sessions" / VIRTUAL).is_symlink()
    # One that was recorded from a port that is gone asks for the one where its instrument is now.
    settings = program.folder / "imufield-sessions" / "first" / "session.toml"
    settings.write_text(settings.read_text().replace(f"imufield-sessions/{VIRTUAL}", "/dev/ttyUSB77"))
    page.reload()
    page.get_by_role("button", name="Go on with the positions").click()
    wait_for(page, "#session-says", "/dev/ttyUSB77")
    page.get_by_label("Port, if it has changed").wait_for()
    assert screens.console == []


def test_a_dropped_file_is_asked_about_and_solved_without_a_position(program: Program, screens: Screens, address: str) -> None:
    path = program.folder / "<b>odd.csv"
    table_of_stills(path)
    page = screens.open(address)
    # Dropped on whatever part of the page is shown.
    file = page.evaluate_handle(DRAGGED, [path.name, path.read_text()])
    page.locator("#start").dispatch_event("drop", {"dataTransfer": file})
    # Its columns are named by nothing that the program knows, and there is no time.
    wait_for(page, "h2", "What is in the file")
    for number, name in enumerate(("ax", "ay", "az"), start=1):
        page.get_by_label(f"meaning of column {number}").select_option(name)
    page.get_by_label("samples per second").fill(str(RATE_HZ))
    page.get_by_role("button", name="Import with these settings").click()
    page.get_by_role("button", name="Go on to the result").click()
    page.get_by_label("Latitude").last.fill("45")
    page.get_by_role("button", name="Compute the result").click()
    wait_for(page, "#verdict", "GOOD|USABLE")
    assert_sides_are_whole(page)
    page.get_by_role("button", name="Show the signals").click()
    page.get_by_role("button", name="Closer").click()
    assert page.locator("#signals-of-session polyline").count() == page.locator("#signals-of-session polygon").count() == 3
    page.locator("[data-still]").nth(3).focus()
    page.keyboard.press("Enter")
    name = str(page.locator("[data-still]").nth(3).get_attribute("data-still"))
    assert not page.locator(f'[data-hold="{name}"]').is_checked()
    page.get_by_role("button", name="Compute again with the ticked positions").click()
    page.locator("#verdict").wait_for()
    wait_for(page, "#commands code", f"--without={re.escape(name)}")
    page.locator(f'.holds label:has([data-hold="{name}"]) rect.left').wait_for()
    (folder,) = (program.folder / "imufield-sessions").glob("b-odd-*")
    found = load(folder)
    assert [position["name"] for position in found.document["position"] if not position["used"]] == [name]
    assert found.calibration.accelerometer.bias_m_s2 == pytest.approx(BIAS_M_S2, abs=2e-3)
    assert_each_angle_stands_below_its_axis(page, found)
    # What was made of an earlier result is offered as that.
    page.get_by_text("Older files").click()
    page.locator("#saved-earlier").get_by_role("button", name="Save parameters-1.toml").wait_for()
    assert page.locator("#result").get_by_role("button", name="Save parameters.toml").is_visible()
    # A damaged result is told of, and computed again.
    (folder / "parameters.toml").write_text("cut")
    page.reload()
    page.locator("#state .failed", has_text="parameters.toml").wait_for()
    page.get_by_role("button", name="Compute the result").click()
    wait_for(page, "#verdict", "GOOD|USABLE")
    assert page.locator("#state .failed").count() == 0
    assert screens.console == []
    os.kill(program.started[0].pid, signal.SIGINT)
    assert program.started[0].wait(60) == 130
