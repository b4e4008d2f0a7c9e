"""What ``imufield.toml`` may say: a value of the wrong kind is named with the file, and no option is blamed for it."""

from __future__ import annotations

from pathlib import Path

import pytest

from imufield.commands.options.configuration import FILE_NAME, KEYS, default_map, parse_zero
from imufield.errors import Reason, UsageError
from tests.refused import refused

TEXTS = ("port", "bus", "dbc", "driver", "positions", "laboratory", "customer", "operator")
TABLES = ("settings", "mapping", "instrument")


@pytest.fixture(autouse=True)
def own_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


@pytest.mark.parametrize("name", TEXTS)
@pytest.mark.parametrize("value", ["[1]", "{a = 1}", "true", "5"])
def test_a_text_is_no_other_value(name: str, value: str) -> None:
    Path(FILE_NAME).write_text(f"{name} = {value}\n")
    with refused(UsageError, None, FILE_NAME, name, key="configuration.no_text"):
        default_map()


@pytest.mark.parametrize("name", sorted(KEYS.keys() - {*TEXTS, *TABLES}))
@pytest.mark.parametrize("value", ["[1]", "{a = 1}", "true", '"abc"', "2020-01-01", "1979-05-27T07:32:00Z", "nan"])
def test_a_number_is_no_other_value(name: str, value: str) -> None:
    Path(FILE_NAME).write_text(f"{name} = {value}\n")
    with refused(UsageError, None, FILE_NAME, name, key="configuration.no_number"):
        default_map()


@pytest.mark.parametrize(("name", "value"), [("baud", '"115200+-3"'), ("baud", "115200.5"), ("hold_s", '"9.8+-0.1"')])
def test_other_numbers_have_no_uncertainty(name: str, value: str) -> None:
    Path(FILE_NAME).write_text(f"{name} = {value}\n")
    with refused(UsageError, None, FILE_NAME, name, key="configuration.no_number"):
        default_map()


@pytest.mark.parametrize("value", ["9.8089", '"9.8089"', '"9.8089+-0.0001"', '"9.8089±0.0001"'])
def test_gravity_may_have_its_uncertainty(value: str) -> None:
    Path(FILE_NAME).write_text(f"gravity = {value}\n", encoding="utf-8")
    assert str(default_map()["solve"]["gravity"]).startswith("9.8089")


@pytest.mark.parametrize(
    ("text", "zero"),
    [
        (None, None),
        ("32768", [32768.0] * 3),
        ("1,2,3", [1.0, 2.0, 3.0]),
        ("1, 2 3", [1.0, 2.0, 3.0]),
        ("-5", [-5.0] * 3),
        ("0,0,0,9,9,9", [0.0] * 3 + [9.0] * 3),
    ],
)
def test_a_raw_zero_is_one_number_or_three(text: str | None, zero: list[float] | None) -> None:
    assert parse_zero(text) == zero


@pytest.mark.parametrize("text", ["", "x", "1,2", "nan", "inf", "1,2,3,4"])
def test_a_raw_zero_that_is_none_is_quoted(text: str) -> None:
    with refused(UsageError, Reason.USAGE, "--zero", key="configuration.zero") as caught:
        parse_zero(text)
    assert caught.value.values["zero"] == text
