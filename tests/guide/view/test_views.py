"""The screen, on the events of one simulated session."""

import copy
import re
from dataclasses import replace
from functools import partial
from io import BytesIO, StringIO, TextIOWrapper
from typing import Any

import pytest
from rich.console import Console

from imufield.guide.events import (
    Accepted,
    Done,
    Hold,
    LinkBack,
    Marked,
    RefusalCode,
    Rejected,
    Turning,
)
from imufield.guide.lead.guide import Guide
from imufield.guide.lead.settings import GuideSettings
from imufield.guide.lead.state_table import State
from imufield.guide.positions import SCHEMES, scheme
from imufield.guide.view.instruction import Screen, instruct
from imufield.guide.view.marks import with_keys
from imufield.guide.view.pictures import ROWS, big_lines
from imufield.guide.view.plain import line
from imufield.guide.view.screen import HEIGHT, WIDTH, LinkState, _in_corner, draw, draw_big, draw_small, has_room_for_big
from imufield.guide.view.terminal import TerminalView


def picture(screen: Any, guide: Any, **options: Any) -> Any:
    console = Console(width=WIDTH, height=HEIGHT, record=True, file=open_nothing(), **options)
    console.print(draw(screen, guide.snapshot(), guide.plan.scheme, LinkState(0)))
    return console.export_text()


def open_nothing() -> Any:
    return StringIO()


FOLLOWED: dict[float, Any] = {}
"""By time: it is the same session for every test, and many stop it at the same moments."""


def followed(session: Any, until_s: Any) -> Any:
    """Return the screen that has followed a session until then, and its guide."""
    if until_s not in FOLLOWED:
        screen, guide = Screen(), None
        for events, now in session(until_s):
            screen.follow(events)
            guide = now
        FOLLOWED[until_s] = screen, guide
    return copy.deepcopy(FOLLOWED[until_s])


def drawn_through(session: Any, until_s: float, view: TerminalView) -> None:
    """Draw a session as it goes on, ten times a second."""
    waiting: list[Any] = []
    for number, (events, guide) in enumerate(session(until_s)):
        waiting += events
        if number % 5 == 4:
            view.show(waiting, guide.snapshot())
            waiting = []


def shown(session: Any, until_s: Any) -> Any:
    return picture(*followed(session, until_s))


@pytest.mark.parametrize(
    ("until_s", "big", "told"),
    [
        (1.0, "L E A V E   I T   S T I L L", "measuring the noise floor"),
        (3.35, "H O L D   S T I L L", "+z: +z up, standing on the -z face"),
        (5.0, "G O O D :   T U R N", "1 of 6 done"),
        (6.8, "T U R N", "moving"),
        (12.5, "N O T   T A K E N", "none of the open positions is near"),
    ],
)
def test_screen_says_what_to_do(session: Any, until_s: Any, big: Any, told: Any) -> None:
    text = shown(session, until_s)
    assert big in text
    assert told in text


def test_screen_fits_80_by_24_without_colour_or_cut_words(session: Any) -> None:
    for until_s in (1.0, 3.35, 5.0, 6.8, 9.0, 12.5):
        lines = shown(session, until_s).rstrip("\n").split("\n")
        assert len(lines) <= HEIGHT
        assert max(len(one) for one in lines) <= WIDTH


def test_screen_in_full(session: Any) -> None:
    assert shown(session, 5.0) == SNAPSHOT


@pytest.mark.parametrize("name", SCHEMES)
def test_map_shows_every_position(make_path: Any, name: str) -> None:
    samples = make_path(100.0).hold([0, 0, 1], 1).samples()
    guide = Guide(scheme(name), samples.units)
    guide.feed(samples)
    text = picture(Screen(), guide)
    for position in guide.plan.scheme.positions:
        assert f"[ ]{position.name} " in text


def test_screen_tells_a_lost_link(session: Any) -> None:
    screen = Screen()
    guide = list(session(5.0))[-1][1]
    screen.follow(guide.link_lost())
    text = picture(screen, guide)
    assert "N O   L I N K" in text
    assert "LINK LOST" in text
    screen.follow([LinkBack(9.0, "")])
    assert "0 samples lost, pauses not counted   no temperature" in picture(screen, guide)


def test_a_refusal_stays_long_enough_to_be_read(session: Any) -> None:
    screen = Screen()
    refusal = next(event for some, _ in session() for event in some if isinstance(event, Rejected))
    screen.follow([refusal])
    turning = Turning(
        time_s=refusal.time_s + 1, direction=(0.0, 0.0, 1.0), position="+z", angle_deg=1.0, target="+z", target_angle_deg=1.0
    )
    screen.follow([turning])
    assert screen.refused is refusal
    screen.follow(
        [
            Turning(
                time_s=refusal.time_s + 5,
                direction=(0.0, 0.0, 1.0),
                position="+z",
                angle_deg=1.0,
                target="+z",
                target_angle_deg=1.0,
            )
        ]
    )
    assert screen.refused is None


def refused(reason: RefusalCode, words: str, remedy: str, time_s: float = 7.0) -> Rejected:
    return Rejected(
        time_s=time_s, position="", reason=reason, words=words, remedy=remedy, measured=1.0, limit=0.0, unit="deg", axis=None
    )


def test_what_is_nobodys_mistake_is_not_called_refused(session: Any) -> None:
    guide = list(session(6.5))[-1][1]
    done = refused(RefusalCode.ALREADY_DONE, "+z is already done", "5 left: +x, -x, +y, -y and 1 more")
    starting = refused(
        RefusalCode.START_UP, "the instrument is still starting up in 0.5 of 3 s", "leave it alone until it is ready"
    )
    for event, code, short in ((done, "already_done", "TURN"), (starting, "start_up", "WAIT")):
        screen = Screen()
        screen.follow([event])
        now = instruct(screen, guide.snapshot())
        assert (now.code, now.details) == (code, f"{event.words}; {event.remedy}")
        assert instruct(screen, guide.snapshot()).big[0] == short
        assert "refused" not in line(event)


def test_what_was_waited_for_is_withdrawn_when_a_hold_begins(session: Any) -> None:
    events = [event for some, _ in session() for event in some]
    hold = next(event for event in events if isinstance(event, Hold))
    words = "the instrument is still starting up in 100.0 % of the samples (limit 50 %)"
    other = refused(RefusalCode.CLOCK_JUMP, "the sample clock jumped", "nothing is lost")
    screen = Screen()
    screen.follow([other, refused(RefusalCode.START_UP, words, "leave it alone until it is ready")])
    assert any(words in message for message in screen.messages)
    screen.follow([hold])
    assert [words in message for message in screen.messages] == [False]


def test_the_panel_says_what_is_not_known_yet(session: Any) -> None:
    guide = list(session(9.0))[-1][1]
    for forecast, told in (
        ({}, ("accuracy: not known yet",)),
        ({"scale_ppm": 26000.0}, ("1 sigma now: scale 2.6 %", "bias unknown, misal. unknown")),
        (
            {"bias_ug": 25800.0, "scale_ppm": 9990.0, "misalignment_urad": 25800.0},
            ("1 sigma now: scale 0.999 %", "bias 25.8 mg, misal. 25.8 mrad"),
        ),
        (
            {"bias_ug": 103.4, "scale_ppm": 43.12, "misalignment_urad": 47.31},
            ("1 sigma now: scale 43.1 ppm", "bias 103 ug, misal. 47.3 urad"),
        ),
    ):
        console = Console(width=WIDTH, height=HEIGHT, record=True, file=open_nothing())
        console.print(draw(Screen(), replace(guide.snapshot(), forecast=forecast), guide.plan.scheme, LinkState(0)))
        text = console.export_text()
        assert all(words in text for words in told), text


@pytest.mark.parametrize(("width", "height"), [(60, 20), (40, 12)])
def test_a_small_window_says_what_to_do_and_is_not_cut(session: Any, width: int, height: int) -> None:
    played = list(session(9.0))
    screen = Screen()
    for events, _ in played:
        screen.follow(events)
    console = Console(width=width, height=height, record=True, file=open_nothing())
    snapshot = played[-1][1].snapshot()
    console.print(draw_small(screen, snapshot, LinkState(0), width=width, height=height))
    lines = console.export_text().splitlines()
    assert len(lines) <= height
    assert lines[0] == instruct(screen, snapshot).headline
    assert any(line.startswith("stillness") for line in lines)
    assert any("of 6 done" in line for line in lines)
    # Keys stay; the picture where there is room for it.
    assert lines[-1].startswith("? keys q quit r retake")
    assert any("now " in line for line in lines) == (height == 20)
    assert not any("…" in line for line in lines if "Hz" not in line)


@pytest.mark.parametrize(
    ("row", "shown"), [("      ⡠⠤⡄   ", "goal  ⡠⠤⡄   "), ("cable⣀⠤⡄    ", "cable⣀⠤⡄goal"), ("cable⣀⠤⡄⠤⡄  ", "cable⣀⠤⡄⠤⡄  ")]
)
def test_what_a_picture_is_stands_in_a_corner_that_is_free(row: str, shown: str) -> None:
    assert _in_corner(row, "goal") == shown


LONG = (
    "if you showed what was asked for, axes or signs in the driver or protocol are wrong: quit and correct them; if you go "
    "your own way, go on"
)


@pytest.mark.parametrize(("width", "height"), [(60, 20), (40, 12), (79, 23), (140, 45), (80, 24)])
def test_instruction_reason_and_remedy_are_whole_in_every_window(session: Any, width: int, height: int) -> None:
    guide = list(session(6.5))[-1][1]
    words = "3 times -y-z up was asked for and the accelerometer saw +z up"
    drawn = open_nothing()
    console = Console(width=width, height=height, file=drawn, force_terminal=True, color_system=None)
    with TerminalView(scheme("faces6"), console) as view:
        view.show([refused(RefusalCode.AXES, words, LONG)], guide.snapshot())
    shown = re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", drawn.getvalue())
    left = (line.split("││")[0].strip("│") for line in shown.splitlines())
    assert f"{words}; {LONG}" in " ".join(" ".join(left).split())


def test_what_has_no_room_in_the_panel_is_left_out_clause_by_clause(session: Any) -> None:
    guide = list(session(6.5))[-1][1]
    screen = Screen()
    limited = "the sample clock jumped forward by 2.9 s (limit 2 s)"
    words = f"{limited}: samples were lost, the computer slept, or the instrument restarted"
    screen.follow([refused(RefusalCode.CLOCK_JUMP, words, LONG)])
    for draws in (partial(draw, scheme=guide.plan.scheme), draw_big):
        console = Console(width=WIDTH, height=HEIGHT, record=True, file=open_nothing())
        console.print(draws(screen, guide.snapshot(), link=LinkState(0)))
        text = console.export_text()
        assert not re.search(r"\w\.\.\.", text)
        left = (line.split("││")[0].strip("│") for line in text.splitlines())
        assert f"{limited} now " in " ".join(" ".join(left).split()) or f"{limited} still" in " ".join(text.split())


def test_a_session_that_was_finished_early_is_not_called_complete(session: Any) -> None:
    guide = list(session(6.5))[-1][1]
    snapshot = replace(guide.snapshot(), state=State.DONE)
    screen = Screen()
    screen.follow([Done(7.0, accepted=1, planned=6, skipped=("+x",), words="finished with 1 of 6 positions")])
    assert instruct(screen, snapshot).details == "finished with 1 of 6 positions"


def test_a_large_window_shows_more_messages(session: Any) -> None:
    guide = list(session(6.5))[-1][1]
    screen = Screen()
    screen.follow([refused(RefusalCode.NOT_STILL, f"number {i}", LONG, 7.0 + i) for i in range(8)])
    console = Console(width=140, height=45, record=True, file=open_nothing())
    console.print(draw(screen, guide.snapshot(), guide.plan.scheme, LinkState(0), size=(140, 45)))
    text = console.export_text()
    assert all(f"number {i}" in text for i in range(8))
    assert len(text.splitlines()) <= 45


SIZES = [(60, 20), (80, 24), (80, 50), (100, 24), (120, 40), (200, 60)]


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("encoding", ["utf-8", "ascii"])
@pytest.mark.parametrize("until_s", [1.0, 3.35, 5.0, 6.8, 12.5])
def test_every_window_is_filled_and_nothing_is_cut(session: Any, size: tuple[int, int], encoding: str, until_s: float) -> None:
    drawn = TextIOWrapper(BytesIO(), encoding=encoding, errors="strict")
    console = Console(width=size[0], height=size[1], file=drawn, force_terminal=True, color_system=None)
    screen, guide = followed(session, until_s)
    snapshot = guide.snapshot()
    with TerminalView(scheme("faces6"), console) as view:
        view._screen = screen
        view.show([], snapshot)
    drawn.flush()
    text = re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", drawn.buffer.getvalue().decode(encoding))
    lines = text.splitlines()
    assert len(lines) <= size[1]
    assert max(map(len, lines)) <= size[0]
    assert "\u2026" not in text
    assert any("q quit" in line for line in lines[-2:])
    headline = instruct(screen, snapshot).headline
    assert headline in text or " ".join(headline) in text
    if size[0] >= WIDTH:
        # Every line of the window has something to show, but for those of the log at the beginning.
        assert len(lines) == size[1]
    assert ("signals: " in text) == (size[1] >= 40)
    assert ("gyro z" in text) == (size[1] >= 40) or "gyro z)" in text
    assert (" log " in text) == (size[0] >= 100)


@pytest.mark.parametrize("columns", [40, 50, 54, 60])
def test_the_address_of_the_page_is_one_link_in_a_narrow_window(session: Any, columns: int) -> None:
    url = f"http://127.0.0.1:8777/#token={22 * 'x'}"
    screen, guide = followed(session, 6.8)
    drawn = open_nothing()
    console = Console(width=columns, height=20, file=drawn, force_terminal=True, color_system="standard")
    console.print(draw_small(screen, guide.snapshot(), LinkState(0, page=url), width=columns, height=20))
    links = re.findall(r"\x1b\]8;id=[^;]*;([^;]+)\x1b\\([^\x1b]*)\x1b\]8;;\x1b", drawn.getvalue())
    shown = re.sub(r"\x1b\]8;[^\x1b]*\x1b\\|\x1b\[[0-9;]*m", "", drawn.getvalue())
    # With "page" before it, alone, or in pieces of which each opens the whole.
    assert (url in shown) == (columns >= len(url))
    assert {target for target, _ in links} == ({url} if columns < len(url) else set())
    assert columns >= len(url) or "".join(text.strip() for _, text in links).removeprefix("page").strip() == url


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("big", [False, True])
def test_the_address_of_the_page_is_whole_in_every_window(session: Any, size: tuple[int, int], *, big: bool) -> None:
    url = f"http://127.0.0.1:8777/#token={22 * 'x'}"
    screen, guide = followed(session, 6.8)
    drawn = open_nothing()
    console = Console(width=size[0], height=size[1], file=drawn, force_terminal=True, color_system=None)
    with TerminalView(scheme("faces6"), console, big=big) as view:
        view._screen = screen
        view.page = url
        view.show([], guide.snapshot())
    lines = re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", drawn.getvalue()).splitlines()
    assert [line.strip() for line in lines if url in line] == [f"page {url}"]
    assert len(lines) <= size[1]
    assert any("q quit" in line for line in lines[-2:])
    assert size[0] < WIDTH or big or len(lines) == size[1]


def test_an_answer_to_a_key_stands_once_in_the_log() -> None:
    screen = Screen()
    for words in ("keys", "accepted +x", "accepted +y", "keys", "keys"):
        screen.tell(words)
    assert list(screen.messages) == ["accepted +x", "accepted +y", "keys"]


def test_the_first_position_once_more_is_called_a_drift_check(make_path: Any) -> None:
    path = make_path(100.0)
    directions = list(scheme("corners24").directions())
    for up in [*directions, directions[0]]:
        path.hold(up, 4).turn(up, 0.1)
    samples = path.samples()
    guide = Guide(scheme("corners24"), samples.units, settings=GuideSettings(hold_s=3.0, revisit_first=True))
    screen, headlines, details = Screen(), list[str](), list[str]()
    for start in range(0, len(samples), 20):
        screen.follow(guide.feed(samples[start : start + 20]))
        snapshot = guide.snapshot()
        now = instruct(screen, snapshot)
        if len(snapshot.accepted) == 24 and now.headline not in headlines:
            headlines.append(now.headline)
            details.append(now.details)
    assert headlines == ["DRIFT CHECK: TURN", "DRIFT CHECK: HOLD", "DONE"]
    assert all("drift" in words for words in details[:2])


def test_the_pictures_grow_with_the_window(session: Any) -> None:
    screen, guide = followed(session, 6.8)
    dots = []
    for size in ((80, 24), (120, 40), (200, 60)):
        console = Console(width=size[0], height=size[1], record=True, file=open_nothing())
        snapshot = replace(guide.snapshot(), signals=None)
        console.print(draw(screen, snapshot, guide.plan.scheme, LinkState(0), size=size))
        dots.append(len(re.findall("[\u2800-\u28ff]", console.export_text())))
    assert dots[1] > 1.5 * dots[0]
    assert dots[2] > 1.5 * dots[1]


def test_a_suspect_is_said_instead_of_good(session: Any) -> None:
    played = list(session(5.0))
    good = next(event for some, _ in played for event in some if isinstance(event, Accepted))
    snapshot = played[-1][1].snapshot()
    screen = Screen()
    screen.follow([good])
    assert instruct(screen, snapshot).big[0] == "GOOD"
    screen.follow([replace(good, suspect=True, leave_one_out_m_s2=0.057)])
    now = instruct(screen, snapshot)
    assert (now.code, now.big) == ("suspect", ("PRESS", "R"))
    assert with_keys("[retake]") in now.details
    assert with_keys("[retake]") in screen.messages[-1]
    assert "+5.81 mg" in now.details
    assert "SUSPECT" in screen.messages[-1]
    # What the operator answers is what the screen speaks of next.
    screen.follow([Marked(9.0, "retake", "+z", "")])
    assert instruct(screen, snapshot).code == "turn"


@pytest.mark.parametrize(("kind", "sign"), [("suspects", "?"), ("again", "r"), ("skipped", "-")])
def test_the_map_marks_what_is_to_be_done_about_a_position(session: Any, kind: str, sign: str) -> None:
    guide = list(session(9.0))[-1][1]
    console = Console(width=WIDTH, height=HEIGHT, record=True, file=open_nothing())
    console.print(draw(Screen(), replace(guide.snapshot(), **{kind: ("+z",)}), guide.plan.scheme, LinkState(0)))
    assert f"[{sign}]+z" in console.export_text()


def test_without_a_link_nothing_old_is_shown(session: Any) -> None:
    guide = list(session(9.0))[-1][1]
    screen = Screen()
    screen.follow(guide.link_lost())
    text = picture(screen, guide)
    assert "LINK LOST   - Hz" in text
    assert "allowed" not in text


def test_the_newest_message_is_there_to_its_end(session: Any) -> None:
    guide = list(session(6.5))[-1][1]
    screen = Screen()
    remedy = "put it on a firm support or lean it on one, hands off"
    words = "not still yet: it shakes, accelerometer x 154 mm/s^2 (limit 50 mm/s^2)"
    screen.follow([refused(RefusalCode.NOT_STILL, words, remedy, time_s) for time_s in (7.0, 8.0, 9.0)])
    text = " ".join(picture(screen, guide).split())
    assert text.count(f"refused: {words}; {remedy}") == 2
    assert text.endswith("q quit (resume later)")
    assert len(picture(screen, guide).splitlines()) <= HEIGHT


def test_live_view_draws_through_rich(session: Any) -> None:
    drawn = open_nothing()
    console = Console(width=WIDTH, height=HEIGHT, file=drawn, force_terminal=True)
    with TerminalView(scheme("faces6"), console) as view:
        drawn_through(session, 3.5, view)
    assert "H O L D" in drawn.getvalue()


@pytest.mark.parametrize(
    ("until_s", "first"),
    [(1.0, "LEAVE"), (3.35, "HOLD"), (5.0, "GOOD"), (6.8, "TURN"), (12.5, "AGAIN")],
)
@pytest.mark.parametrize("size", [(WIDTH, HEIGHT), (60, 20), (WIDTH, 22), (40, 22)])
@pytest.mark.parametrize("page", ["", "http://192.168.178.25:43210/#0123456789012345678901"])
def test_big_letters_say_the_same_and_fit(session: Any, until_s: Any, first: Any, size: tuple[int, int], page: str) -> None:
    screen = Screen()
    played = list(session(until_s))
    for events, _ in played:
        screen.follow(events)
    snapshot = played[-1][1].snapshot()
    assert instruct(screen, snapshot).big[0] == first
    width, height = size
    assert has_room_for_big(screen, snapshot, LinkState(0, page=page), size)
    assert not has_room_for_big(screen, snapshot, LinkState(0, page=page), (width, 18))
    console = Console(width=width, height=height, record=True, file=open_nothing())
    console.print(draw_big(screen, snapshot, LinkState(0, page=page), size))
    lines = console.export_text().rstrip("\n").split("\n")
    assert len(lines) <= height
    assert max(map(len, lines)) <= width
    assert [line.rstrip() for line in lines[:ROWS]] == big_lines(first, width)
    assert "of 6 done" in "".join(lines)
    assert lines[-1].lstrip().startswith(("? keys", "r retake"))


def test_the_screen_is_ascii_where_the_terminal_is(session: Any) -> None:
    drawn = TextIOWrapper(BytesIO(), encoding="ascii", errors="strict")
    console = Console(width=WIDTH, height=HEIGHT, file=drawn, force_terminal=True, color_system=None)
    with TerminalView(scheme("faces6"), console) as view:
        drawn_through(session, 7.0, view)
    drawn.flush()


SNAPSHOT = """\
╭─ faces6: 1 of 6 done ──────────────────────╮╭─ positions ────────────────────╮
│ G O O D :   T U R N                        ││ [ ]+x [x]+z [ ]-y              │
│ +y: +y up, standing on the -y face         ││ [>]+y [ ]-x [ ]-z              │
│                                            ││ x done, > next, @ here         │
│                                            ││ ? suspect, r retake, - skipped │
│ now                   goal                 ││ accuracy: not known yet        │
│          ⢀⣀⡠⠤⡀              ⢀⣀⡠⠤⠔⠒⠊⠑⠢⢄⡀    ││                                │
│    ⣀⠤⠤⠒⠒⠉+z  ⠈⠑⠤⣀        ⢰⠮⣉⠁ ⣀+y⠤⠒⠒⠉⠁⡇    ││                                │
│    ⡏⠑⠢⣀  ⣀⣀⠤⠤⠒⠊⠉⢹        ⢸  ⢹⠉        ⡇    ││                                │
│    ⡇-x⠈⡏⠉  -y   ⢸   ->   ⢸-x⢸   +z    ⡇    ││                                │
│    ⠉⠒⢄⡀⡇  ⢀⣀⠤⠤⠒⠒⠉        ⢸  ⢸      ⢀⣀⡠⠇    ││                                │
│       ⠈⠓⠊⠉⠁              ⠈⠑⠢⢼⡠⠤⠔⠒⠊⠉⠁       ││                                │
│                                            ││                                │
│ to target ................                 ││                                │
│ hold      ................                 ││                                │
│ stillness ##......|....... still           ││                                │
│ acc z: vibration 11, limit 50 mm/s^2       ││                                │
╰────────────────────────────────────────────╯╰────────────────────────────────╯
 link ok   100 Hz   0 samples lost   no temperature
 noise floor: accelerometer 9.62 mm/s^2 rms per axis, gyroscope 0.057 deg/s;
   limit for stillness 50 mm/s^2
 accepted +z: 3 s

r retake  s skip  u undo  p pause  f finish  ? keys  q quit (resume later)
"""
