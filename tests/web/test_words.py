"""The words of the guide's page stand in its HTML; what the guide itself says comes from the program."""

import re
from importlib.resources import files
from itertools import chain

STATIC = files("imufield.web") / "static"
PAGE = (STATIC / "index.html").read_text(encoding="utf-8")
# The modules that the page loads, one by another.
IMPORTED = re.compile(r'from "\./(\w+\.js)"')
TEXT = re.compile(r"\btext\(([^()]*)")
NAME = re.compile(r'"(\w+)"')
# Of positions and of the link: their names come from the program.
BY_STATE = {"accepted", "next", "open", "suspect", "again", "skipped", "lost", "silent"}


def scripts() -> dict[str, str]:
    """Return the page's modules by their names."""
    found: dict[str, str] = {}
    left = ["guide.js"]
    while left:
        name = left.pop()
        if name not in found:
            found[name] = (STATIC / name).read_text(encoding="utf-8")
            left += IMPORTED.findall(found[name])
    return found


def test_each_text_has_its_place() -> None:
    given = set(re.findall(r'data-text="(\w+)"', PAGE))
    used = set(chain.from_iterable(NAME.findall(call) for code in scripts().values() for call in TEXT.findall(code)))
    assert used | BY_STATE == given


def test_scripts_hold_no_sentence() -> None:
    code = {name: re.sub(r"//.*|/\*[\s\S]*?\*/", "", source) for name, source in scripts().items()}
    sentences = [
        f"{name}: {text}" for name, source in code.items() for text in re.findall(r'"[A-Za-z]+( [a-z]+){2,}[^"]*"', source)
    ]
    assert sentences == []
