"""What the registers of a WitMotion say of it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from drivers import witmotion
else:
    from imufield.drivers import witmotion


@pytest.mark.parametrize(
    ("words", "firmware"),
    [
        ((2526, 0), {"firmware": "2526"}),
        # Register 0x2F is CCBW, none of the version (REG.h), unless its highest bit says so (the maker's C# program).
        ((2526, 1), {"firmware": "2526"}),
        ((0b01_000011_00000100, 0x8000 | 1), {"firmware": "5.3.4"}),
        ((0, 1), {}),
    ],
)
def test_the_version_is_one_register_or_three_numbers(words: tuple[int, int], firmware: dict[str, str]) -> None:
    answer = {"kind": "registers", "asked": "version", "registers": (*words, 0, 0)}
    assert witmotion.WitMotion.identity([answer]) == firmware
