"""Faults happen as often as asked, are counted, and repeat with the seed."""

from __future__ import annotations

import numpy as np
import pytest

from imufield.errors import Reason, UsageError
from imufield.simulate.emulator.faults import FaultInjector, Faults
from tests.refused import refused

DATA = np.arange(20000, dtype=np.int64).astype(np.uint8)
CHECKSUMS = np.arange(39, 20000, 40)


def damage(faults: Faults, seed: int = 1) -> tuple[bytes, FaultInjector]:
    injector = FaultInjector(faults, seed)
    return injector.damage(DATA, CHECKSUMS, 1.0), injector


def test_no_faults_no_damage() -> None:
    data, injector = damage(Faults())
    assert data == DATA.tobytes()
    assert not injector.counts


def test_bit_flips_change_one_bit_each() -> None:
    data, injector = damage(Faults(bit_flip_probability=0.01))
    changed = np.frombuffer(data, dtype=np.uint8) ^ DATA
    assert np.count_nonzero(changed) == injector.counts["bit_flips"]
    assert set(np.unique(changed)) == {0, 1, 2, 4, 8, 16, 32, 64, 128}
    assert 150 < injector.counts["bit_flips"] < 250


def test_lost_and_doubled_bytes_change_the_length() -> None:
    data, injector = damage(Faults(lost_byte_probability=0.01, doubled_byte_probability=0.02))
    doubled_then_lost = 20000 - injector.counts["lost_bytes"] + injector.counts["doubled_bytes"] - len(data)
    # A byte that is both is lost.
    assert 0 <= doubled_then_lost < 15
    assert 150 < injector.counts["lost_bytes"] < 250
    assert 320 < injector.counts["doubled_bytes"] < 480


def test_wrong_checksums_hit_checksums_only() -> None:
    data, injector = damage(Faults(wrong_checksum_probability=0.2))
    changed = np.flatnonzero(np.frombuffer(data, dtype=np.uint8) != DATA)
    assert len(changed) == injector.counts["wrong_checksums"] > 50
    assert set(changed) <= set(CHECKSUMS.tolist())


def test_garbage_is_added_whole() -> None:
    data, injector = damage(Faults(garbage_per_s=1.0))
    assert injector.counts["garbage"] == 1
    assert 1 <= len(data) - len(DATA) <= 64


def test_rates_are_per_second_of_instrument_time() -> None:
    injector = FaultInjector(Faults(stalls_per_s=0.5, counter_jumps_per_s=2.0, disconnects_per_s=0.2), 3)
    for k in range(100000):
        injector.happens("stalls", 0.5, 0.01)
        injector.counter_jump(0.01)
        injector.disconnects(k * 0.01, 0.01)
    assert injector.counts["stalls"] == pytest.approx(500, rel=0.15)
    assert injector.counts["counter_jumps"] == pytest.approx(2000, rel=0.1)
    assert injector.counts["disconnects"] == pytest.approx(200, rel=0.2)


def test_disconnections_at_given_times() -> None:
    injector = FaultInjector(Faults(disconnect_at_s=(3.0, 1.0)), 1)
    happened = [t for t in np.arange(0, 5, 0.25) if injector.disconnects(float(t), 0.25)]
    assert happened == [1.0, 3.0]


def test_seed_decides() -> None:
    faults = Faults(bit_flip_probability=0.01, lost_byte_probability=0.01)
    assert damage(faults, 1)[0] == damage(faults, 1)[0] != damage(faults, 2)[0]


@pytest.mark.parametrize("faults", [{"bit_flip_probability": 1.5}, {"garbage_per_s": -1.0}, {"stall_s": float("nan")}])
def test_senseless_rates_are_refused(faults: dict[str, float]) -> None:
    with refused(UsageError, Reason.USAGE, *faults, key="faults.outside"):
        Faults(**faults)  # type: ignore[arg-type]
