"""Methods by name, with settings as they are typed."""

from __future__ import annotations

import pytest

from imufield.calibrate.solvers.evolution import IDE_SETTINGS
from imufield.calibrate.solvers.registry import METHODS, load_solver
from imufield.errors import Reason, UsageError
from tests.refused import refused


def settings_of(name: str, **typed: str):  # type: ignore[no-untyped-def]  # of any method
    return load_solver(name, typed).keywords["settings"]  # type: ignore[attr-defined]


def test_settings_go_by_symbol_and_by_word() -> None:
    swarm = settings_of("bsas", beetles="20", p_st="0.5", iterations="77")
    assert (swarm.m, swarm.p_st, swarm.k_max) == (20, 0.5, 77)
    # What is not typed stays as it is in whitened coordinates.
    assert swarm.c_s == 0.965
    assert settings_of("bsas-staged", rounds="3", m="6").rounds == 3
    evolution = settings_of("de-combined", population="40", factor="1.05", crossover="0.9", EG="300")
    assert (evolution.NP, evolution.F, evolution.CR, evolution.EG) == (40, 1.05, 0.9, 300)
    assert settings_of("ide", F_min="0.5").F_max == IDE_SETTINGS.F_max
    assert settings_of("ide", factor="1.1").F_max == 1.1
    assert settings_of("pso", population="30").population == 30


@pytest.mark.parametrize(
    ("method", "name", "value"),
    [("bsas", "m", "0"), ("bsas", "m", "2.5"), ("bsas", "c_s", "1"), ("bsas", "p_pos", "1.1"), ("ide", "EG", "1e3"),
     ("de-rand-1", "F", "-1"), ("de-rand-1", "F", "inf"), ("ide", "alpha", "nan"), ("ide", "NP", "9999999"), ("bas", "s", "x")],
)  # fmt: skip
def test_a_value_that_makes_no_sense_is_refused(method: str, name: str, value: str) -> None:
    with refused(UsageError, Reason.USAGE, name, value, key="registry.setting"):
        load_solver(method, {name: value})


def test_a_setting_that_a_method_does_not_have_is_refused_with_those_it_has() -> None:
    # A constant factor is none of IDE's: its own goes from F_max to F_min.
    with refused(UsageError, Reason.USAGE, "'F'", "F_max", key="registry.no_setting"):
        load_solver("ide", {"F": "1.2"})
    with refused(UsageError, Reason.USAGE, "least-squares", "m", key="registry.no_settings"):
        load_solver("least-squares", {"m": "3"})


def test_every_method_says_where_its_settings_are() -> None:
    assert {name for name in METHODS if not METHODS[name].settings} == {"least-squares"}
