"""The words of a page stand in its HTML; what the guide and the commands say comes from the program."""

import re
from importlib.resources import files
from itertools import chain

import pytest

from imufield.calibrate.accelerometer.ellipsoid_start import FEWEST_FOR_SCALE_AND_BIAS
from imufield.earth import MICRO_G_M_S2
from imufield.guide.view.instruction import Mood
from imufield.guide.view.marks import KEYS, NAMES
from imufield.pipeline.calibration import FEWEST_CHECKED

STATIC = files("imufield.web") / "static"
# The modules that the page loads, one by another.
IMPORTED = re.compile(r'from "\./(\w+\.js)"')
TEXT = re.compile(r"\btext\(([^()]*)")
NAME = re.compile(r'"(\w+)"')
# Of positions, marks and the end: their names come from the program.
BY_STATE = {"accepted", "next", "here", "open", "suspect", "again", "skipped", "tap", "named"}
BY_STATE |= {f"{outcome}{then}" for outcome in ("finished", "stopped", "replayed") for then in ("", "_next", "_back")}
BY_RESULT = {"good", "usable", "poor", "named"}
PAGES = {"index.html": ("guide.js", BY_STATE), "workbench.html": ("workbench.js", BY_RESULT)}
"""The first module of each page, and the words it asks for by what the program says."""


def scripts(first: str) -> dict[str, str]:
    """Return a page's modules by their names."""
    found: dict[str, str] = {}
    left = [first]
    while left:
        name = left.pop()
        if name not in found:
            found[name] = (STATIC / name).read_text(encoding="utf-8")
            left += IMPORTED.findall(found[name])
    return found


@pytest.mark.parametrize("page", PAGES)
def test_each_text_has_its_place(page: str) -> None:
    first, asked = PAGES[page]
    given = set(re.findall(r'data-text="(\w+)"', (STATIC / page).read_text(encoding="utf-8")))
    used = set(chain.from_iterable(NAME.findall(call) for code in scripts(first).values() for call in TEXT.findall(code)))
    assert used | asked == given


@pytest.mark.parametrize("page", PAGES)
def test_scripts_hold_no_sentence(page: str) -> None:
    code = {name: re.sub(r"//.*|/\*[\s\S]*?\*/", "", source) for name, source in scripts(PAGES[page][0]).items()}
    sentences = [
        f"{name}: {text}" for name, source in code.items() for text in re.findall(r'"[A-Za-z]+( [a-z]+){2,}[^"]*"', source)
    ]
    assert sentences == []


def test_the_page_makes_the_marks_of_the_terminal_and_names_them_as_the_guide_does() -> None:
    html = (STATIC / "index.html").read_text(encoding="utf-8")
    assert dict(re.findall(r'data-mark="(\w+)" data-key="(\w)"', html)) == {action: key for key, action in KEYS.items()}
    labels = re.findall(r"<button data-mark[^>]*>(?:<span>)?([a-z ]+?)(?:</span>)? <kbd>(\w)</kbd>", html)
    labels += [(words, "p") for words in re.findall(r'data-text="go_on">([^<]*)', html)]
    assert NAMES.items() <= {*labels}


def test_numbers_that_stand_twice_are_the_same() -> None:
    session = (STATIC / "session.js").read_text(encoding="utf-8")
    numbers = {name: float(value) for name, value in re.findall(r"^const (\w+) = ([\d.e-]+);", session, flags=re.MULTILINE)}
    assert {
        "MICRO_G": MICRO_G_M_S2,
        "FEWEST_SOLVED": FEWEST_FOR_SCALE_AND_BIAS,
        "FEWEST_CHECKED": FEWEST_CHECKED,
    }.items() <= numbers.items()


def test_each_mood_has_its_colours() -> None:
    style = (STATIC / "style.css").read_text(encoding="utf-8")
    assert {*re.findall(r'\[data-mood="(\w+)"\]', style)} == {mood.value for mood in Mood} - {Mood.NONE.value}


def test_a_night_that_is_chosen_has_the_colours_of_the_system_s() -> None:
    style = (STATIC / "style.css").read_text(encoding="utf-8")
    nights = [" ".join(rules.split()) for rules in re.findall(r":root[^{]*\{([^}]*color-scheme: dark;[^}]*)\}", style)]
    assert len(nights) == 2
    assert nights[0] == nights[1]
