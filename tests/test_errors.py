"""What is said of packages that are not there, or cannot be imported."""

import math
import sys
from pathlib import Path

import pytest

from imufield.errors import Reason, UsageError, load_package
from tests.refused import refused


def test_a_package_that_is_there_is_returned() -> None:
    assert load_package("math", "a sum", "noise") is math


def test_one_that_is_missing_is_named_with_its_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pyins.earth", None)
    wanted = ("a sum", "python-ins", "pip install '.[nav]'")
    with refused(UsageError, Reason.MISSING_PACKAGE, *wanted, key="errors.missing_package"):
        load_package("pyins.earth", "a sum", "nav", "python-ins")


@pytest.mark.parametrize(
    "error", ["ImportError('another NumPy')", "OSError('cannot load library')", "ModuleNotFoundError('its own', name='its')"]
)
def test_of_one_that_cannot_be_imported_the_cause_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, error: str) -> None:
    (tmp_path / "broken_package_of_a_test.py").write_text(f"raise {error}\n", encoding="utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    wanted = ("broken_package_of_a_test", error.split("'")[1], "pip install '.[nav]'")
    with refused(UsageError, Reason.MISSING_PACKAGE, *wanted, key="errors.broken_package"):
        load_package("broken_package_of_a_test", "a sum", "nav")
