"""The words of a page stand in its HTML; what the guide and the commands say comes from the program."""

import re
from importlib.resources import files
from itertools import chain

import pytest

STATIC = files("imufield.web") / "static"
# The modules that the page loads, one by another.
IMPORTED = re.compile(r'from "\./(\w+\.js)"')
TEXT = re.compile(r"\btext\(([^()]*)")
NAME = re.compile(r'"(\w+)"')
# Of positions and of the link: their names come from the program.
BY_STATE = {"accepted", "next", "open", "suspect", "again", "skipped", "lost", "silent"}
VERDICTS = {"good", "usable", "poor"}
PAGES = {"index.html": ("guide.js", BY_STATE), "workbench.html": ("workbench.js", VERDICTS)}
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


def test_a_night_that_is_chosen_has_the_colours_of_the_system_s() -> None:
    style = (STATIC / "style.css").read_text(encoding="utf-8")
    nights = [" ".join(rules.split()) for rules in re.findall(r":root[^{]*\{([^}]*color-scheme: dark;[^}]*)\}", style)]
    assert len(nights) == 2
    assert nights[0] == nights[1]
