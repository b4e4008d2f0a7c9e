"""Campaigns: results that do not depend on who computes them, and workers that are killed."""

from __future__ import annotations

import multiprocessing
import os
import signal
import socket
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from imufield.campaign import BLAS_VARIABLES, one_blas_thread, run_batch, run_campaign
from imufield.errors import LinkError, Reason, UsageError
from tests.local_cluster import local_cluster
from tests.refused import refused

LIBRARY = Path(__file__).with_name("campaign_runs.py")


@pytest.fixture(scope="module")
def runs() -> Any:
    # Runs are sent by name, so they have to be in a module that other processes can import.
    import sys

    sys.path.insert(0, str(LIBRARY.parent))
    import campaign_runs

    yield campaign_runs
    sys.path.remove(str(LIBRARY.parent))


def test_results_do_not_depend_on_the_number_of_workers(runs: Any) -> None:
    alone = run_campaign(runs.draw, range(40), seed=5, workers=1)
    together = run_campaign(runs.draw, range(40), seed=5, workers=2)
    assert alone == together
    assert len({value for _, value in alone}) == 40
    assert [argument for argument, _ in alone] == list(range(40))


def test_another_seed_gives_other_results(runs: Any) -> None:
    assert run_campaign(runs.draw, range(3), seed=5, workers=1) != run_campaign(runs.draw, range(3), seed=6, workers=1)


def test_batches_make_no_difference(runs: Any) -> None:
    seeds = np.random.SeedSequence(5).spawn(4)
    expected = run_campaign(runs.draw, range(4), seed=5, workers=1)
    assert run_batch(runs.draw, (2, [2, 3], seeds[2:])) == expected[2:]


def test_runs_of_a_killed_worker_are_done_again(runs: Any, tmp_path: Path) -> None:
    marker = tmp_path / "killed"
    results = run_campaign(runs.die_once, [str(marker)] * 20, seed=5, workers=2)
    assert marker.exists()
    assert results == run_campaign(runs.live, [str(marker)] * 20, seed=5, workers=1)


def test_a_run_that_always_kills_its_worker_ends_the_campaign(runs: Any) -> None:
    with refused(UsageError, Reason.USAGE, "6 times", key="campaign.killed") as caught:
        run_campaign(runs.die, range(2), seed=5, workers=2)
    assert caught.value.values["workers"] == 2


def test_errors_of_a_run_come_through(runs: Any) -> None:
    with pytest.raises(UsageError, match="no good") as caught:
        run_campaign(runs.fail, range(4), seed=5, workers=2)
    assert caught.value.values == {"number": 7}


def test_workers_have_one_blas_thread_and_the_parent_keeps_its_own(runs: Any) -> None:
    before = {name: os.environ.get(name) for name in BLAS_VARIABLES}
    assert run_campaign(runs.blas_threads, range(2), seed=5, workers=2) == ["1", "1"]
    assert {name: os.environ.get(name) for name in BLAS_VARIABLES} == before
    with one_blas_thread():
        assert os.environ["OMP_NUM_THREADS"] == "1"


def test_results_are_told_as_they_come(runs: Any) -> None:
    told: list[tuple[int, float]] = []
    results = run_campaign(runs.draw, range(10), seed=5, workers=2, on_result=told.append)
    assert sorted(told) == sorted(results)


def test_an_interrupt_waits_for_no_worker(runs: Any) -> None:
    """The run of the other worker takes longer than any test may."""

    def interrupt(_: object) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run_campaign(runs.sleep, [0, 3600], seed=5, workers=2, on_killed=float, on_result=interrupt)
    assert not multiprocessing.active_children()


def test_workers_hear_no_interrupt(runs: Any) -> None:
    """Ctrl-C goes to all processes of a terminal; this one ends the others, who would have a traceback each to show."""
    assert run_campaign(runs.interrupt_itself, range(4), seed=5, workers=2) == [0, 1, 2, 3]


def test_no_workers_is_no_campaign(runs: Any) -> None:
    with refused(UsageError, Reason.USAGE, "--workers 0", key="campaign.workers") as caught:
        run_campaign(runs.draw, range(2), seed=5, workers=0)
    assert caught.value.values["workers"] == 0


def test_an_empty_campaign_has_no_results(runs: Any) -> None:
    assert run_campaign(runs.draw, [], seed=5) == []


def test_a_scheduler_that_is_not_there(runs: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("distributed", reason="needs the study extra")
    monkeypatch.setattr("imufield.campaign._CONNECT_TIMEOUT_S", 1.0)
    with socket.socket() as listener:
        listener.bind(("127.0.0.1", 0))
        port = listener.getsockname()[1]
    with refused(LinkError, Reason.SILENCE, f"127.0.0.1:{port}", key="campaign.scheduler_silent"):
        run_campaign(runs.draw, range(2), seed=5, scheduler=f"tcp://127.0.0.1:{port}")


@pytest.mark.parametrize("address", ["tls://127.0.0.1:38786", "ucx://127.0.0.1:38786", "http://127.0.0.1:8786", "nonsense"])
def test_a_scheduler_that_cannot_be_reached_by_tcp(runs: Any, address: str) -> None:
    pytest.importorskip("distributed", reason="needs the study extra")
    with refused(UsageError, Reason.USAGE, "--scheduler", address, "tcp://host:8786", key="campaign.scheduler_address"):
        run_campaign(runs.draw, range(2), seed=5, scheduler=address)


@pytest.fixture(scope="module")
def cluster(runs: Any) -> Any:
    with local_cluster(LIBRARY.parent) as cluster:
        yield cluster


def test_a_cluster_gives_the_same_results(cluster: Any, runs: Any) -> None:
    on_cluster = run_campaign(runs.draw, range(40), seed=5, scheduler=cluster.scheduler_address)
    assert on_cluster == run_campaign(runs.draw, range(40), seed=5, workers=1)


def test_runs_of_a_killed_cluster_worker_are_done_again(cluster: Any, runs: Any) -> None:
    victim = next(iter(cluster.workers.values())).pid
    killed: list[int] = []

    def kill(result: tuple[int, float]) -> None:
        if result[0] >= 4 and not killed:
            os.kill(victim, signal.SIGKILL)
            killed.append(victim)

    results = run_campaign(runs.slow_draw, range(40), seed=5, scheduler=cluster.scheduler_address, on_result=kill)
    assert killed
    assert results == run_campaign(runs.draw, range(40), seed=5, workers=1)
