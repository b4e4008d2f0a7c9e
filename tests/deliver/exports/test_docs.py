"""The page of each target: what it quotes is what the export writes, and the worked number is what the formula gives."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest
from target_formulas import DIAGONAL, FORMULAS, pyins_module

from imufield.deliver.exports import TARGETS, export_parameters
from imufield.deliver.parameters.file import load

pytestmark = pytest.mark.numerical

DOCS = Path(__file__).resolve().parents[3] / "docs"
FRACTION = r"[-+]?\d+(?:\.\d*(?:[eE][-+]?\d+)?|[eE][-+]?\d+)"
LAST_DIGITS = 1e-12  # relative: the last binary digit of a product depends on the processor's kernel
RAW = (np.array([[1.0, -2.0, 9.5]]), np.array([[0.1, -0.2, 0.3]]))


def page(target: str) -> str:
    return (DOCS / "exports" / f"{target}.md").read_text(encoding="utf-8")


def worked(text: str, quantity: str) -> list[float] | None:
    found = re.search(rf"^\| {quantity}, [^|]*\| [^|]*\| \(([^)]*)\) \|$", text, re.MULTILINE)
    return None if found is None else [float(value) for value in found[1].split(",")]


def is_written(quoted: str, text: str) -> bool:
    """Whether a text contains the quoted one letter by letter, and the same numbers but for the last digits."""
    numbers = [float(number) for number in re.findall(FRACTION, quoted)]
    like = f"({FRACTION})".join(map(re.escape, re.split(FRACTION, quoted)))
    return any(
        numbers == pytest.approx([float(number) for number in there.groups()], rel=LAST_DIGITS, abs=1e-15)
        for there in re.finditer(like, text)
    )


def test_every_target_has_its_page_and_is_in_the_list() -> None:
    assert {path.stem for path in (DOCS / "exports").glob("*.md")} == set(TARGETS)
    overview = (DOCS / "exports.md").read_text(encoding="utf-8")
    for target in TARGETS.values():
        assert f"| [{target.name}](exports/{target.name}.md) | {target.title} | {target.holds} |" in overview


@pytest.mark.parametrize("target", TARGETS)
def test_page_quotes_the_files_and_sentences_of_the_export(target: str) -> None:
    exported = export_parameters(load(DOCS / "exports" / "example.toml"), target)
    text = page(target)
    for sentence in (*exported.losses, *exported.notes):
        assert sentence in text
    files = "\n".join(content.decode() for name, content in exported.files.items() if not name.endswith(".bin"))
    for block in re.findall(r"```text\n(.*?)```", text, re.DOTALL):
        for line in block.splitlines():
            name, _, values = line.partition(": ")
            if files.lstrip().startswith("{"):
                quoted = json.dumps(json.loads(values))[1:-1]
                assert is_written(quoted, re.sub(r"\s+", " ", files).replace("[ ", "[").replace(" ]", "]")), name
            else:
                assert is_written(line, files), line


def test_numbers_are_compared_and_text_is_exact() -> None:
    line = "scale: [1.002, -0.0010019999999999999], axis 1"
    assert is_written(line, f"first\n{line.replace('10019999999999999', '1002')}\nlast")
    assert not is_written(line, line.replace("1.002", "1.0021"))
    assert not is_written(line, line.replace("axis 1", "axis 2"))
    assert not is_written(line, line.replace("scale", "bias"))


@pytest.mark.parametrize("target", TARGETS)
def test_worked_number_is_what_the_formula_gives(target: str, tmp_path: Path) -> None:
    parameters = load(DOCS / "exports" / "example.toml")
    files = dict(export_parameters(parameters, target).files)
    formula = FORMULAS.get(target) or DIAGONAL.get(target)
    force, rate = parameters.apply_accelerometer(RAW[0]), parameters.apply_gyroscope(RAW[1])
    if formula is not None:
        force, rate = formula(files, *RAW)
    elif target == "pyins":
        module = pyins_module(files, tmp_path)
        force, rate = (
            module.correct(triad, raw) for triad, raw in zip((module.ACCELEROMETER, module.GYROSCOPE), RAW, strict=True)
        )
    text = page(target)
    assert worked(text, "specific force") == pytest.approx(force[0].tolist(), abs=1.1e-9)
    expected = None if rate is None else pytest.approx(rate[0].tolist(), abs=1.1e-9)
    assert worked(text, "angular rate") == expected
