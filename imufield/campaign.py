"""Many independent runs, on all cores or on a Dask cluster; the results do not depend on the number of workers.

Run ``i`` gets the ``i``-th child of one seed sequence, whichever worker does it and when. Runs are sent in batches; a batch
whose worker is killed is done again with the same seeds, so the result is the same. Each process uses one BLAS thread: the
matrices are 3 x 3, and two workers with two threads each would compete for the cores.
"""

from __future__ import annotations

import contextlib
import math
import multiprocessing
import os
import re
import signal
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from typing import Generic, TypeVar

import numpy as np

from imufield.dataclass import dataclass, field
from imufield.errors import LinkError, LinkTimeoutError, Reason, UsageError, load_package
from imufield.progress import Task, task
from imufield.sentences import Sentences

sentence = Sentences(__package__)

Argument = TypeVar("Argument")
Result = TypeVar("Result")
Run = Callable[[Argument, np.random.Generator], Result]

BLAS_VARIABLES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "VECLIB_MAXIMUM_THREADS", "NUMEXPR_NUM_THREADS")
# A batch is at most this part of a worker's share of what is left: batches shrink to single runs, so that at the end no worker
# waits longer for another than one run takes.
_SHARE_OF_REST = 4
LARGEST_BATCH = 16
"""Sending a batch costs about a millisecond."""
_KILLS_ACCEPTED = 5  # A worker killed more often than this is killed by the run itself, or by lack of memory.
_CONNECT_TIMEOUT_S = 10.0
# Without a scheme it is tcp; tls needs certificates, which nobody can give here.
_ADDRESS = re.compile(r"(tcp://)?\[?[^\s/]+\]?:\d+|inproc://\S+")

_Batch = tuple[int, list[Argument], list[np.random.SeedSequence]]  # Index of its first run, arguments, seeds.


def run_campaign(
    run: Run[Argument, Result],
    arguments: Sequence[Argument],
    *,
    seed: int,
    workers: int | None = None,
    scheduler: str | None = None,
    on_killed: Callable[[Argument], Result] | None = None,
    on_result: Callable[[Result], None] | None = None,
) -> list[Result]:
    """Return ``run(argument, generator)`` of every argument, in their order.

    Parameters
    ----------
    run : callable
        A function of a module (it is sent to other processes by name).
    arguments : sequence
    seed : int
        Of the whole campaign.
    workers : int, optional
        Processes; default one per core. 1 runs here.
    scheduler : str, optional
        Address of a Dask scheduler ("tcp://host:8786"); ``workers`` then is the cluster's business.
    on_killed : callable, optional
        What takes the place of a result that kills its worker again and again; without it that ends the campaign. Runs are
        sent one by one then.
    on_result : callable, optional
        Told each result as it comes, in any order.

    Raises
    ------
    UsageError
        If the number of workers makes no sense, Dask is not installed, or workers are killed again and again.
    LinkError
        If the scheduler does not answer or is lost.
    """
    if workers is not None and workers < 1:
        raise UsageError(sentence("campaign.workers", workers=workers))
    count = min(workers or os.cpu_count() or 1, max(len(arguments), 1))
    with task("computing", len(arguments)) as under_way:
        campaign = _Campaign(
            run=run,
            arguments=tuple(arguments),
            seeds=tuple(np.random.SeedSequence(seed).spawn(len(arguments))),
            under_way=under_way,
            on_killed=on_killed,
            on_result=on_result,
        )
        if scheduler is not None:
            return _on_cluster(campaign, scheduler)
        if count > 1:
            return _on_processes(campaign, count)
        for first, (argument, own_seed) in enumerate(zip(campaign.arguments, campaign.seeds, strict=True)):
            campaign.take(first, run_batch(run, (first, [argument], [own_seed])))
        return campaign.in_order()


@dataclass(slots=True, kw_only=True)
class _Campaign(Generic[Argument, Result]):
    """What both kinds of workers are given, and what has come back."""

    run: Run[Argument, Result]
    arguments: tuple[Argument, ...]
    seeds: tuple[np.random.SeedSequence, ...]
    under_way: Task
    on_killed: Callable[[Argument], Result] | None
    on_result: Callable[[Result], None] | None
    results: dict[int, list[Result]] = field(default_factory=dict)  # By the number of the batch's first run.

    def batches(self, workers: int) -> list[_Batch[Argument]]:
        """Return the runs in batches that get smaller to the end."""
        batches: list[_Batch[Argument]] = []
        first, count = 0, len(self.arguments)
        while first < count:
            size = min(math.ceil((count - first) / (workers * _SHARE_OF_REST)), LARGEST_BATCH if self.on_killed is None else 1)
            batches.append((first, list(self.arguments[first : first + size]), list(self.seeds[first : first + size])))
            first += size
        return batches

    def take(self, first: int, results: list[Result]) -> None:
        """Keep the results of a batch."""
        self.results[first] = results
        if self.on_result is not None:
            for result in results:
                self.on_result(result)
        self.under_way.done += len(results)

    def in_order(self) -> list[Result]:
        """Return all results."""
        return [result for first in sorted(self.results) for result in self.results[first]]


def run_batch(run: Run[Argument, Result], batch: _Batch[Argument]) -> list[Result]:
    """Return the results of one batch; the function that workers are sent."""
    return [run(argument, np.random.default_rng(seed)) for argument, seed in zip(batch[1], batch[2], strict=True)]


def _on_processes(campaign: _Campaign[Argument, Result], workers: int) -> list[Result]:
    open_batches = campaign.batches(workers)
    for _ in range(_KILLS_ACCEPTED + 1):
        with contextlib.suppress(BrokenProcessPool), one_blas_thread():
            _pool_pass(campaign, open_batches, workers)
        open_batches = [batch for batch in open_batches if batch[0] not in campaign.results]
        if not open_batches:
            return campaign.in_order()
    if campaign.on_killed is not None:
        # Each run that is left gets a worker of its own, to find those that kill it; a batch has one run here.
        for batch in open_batches:
            with contextlib.suppress(BrokenProcessPool), one_blas_thread():
                _pool_pass(campaign, [batch], 1)
            if batch[0] not in campaign.results:
                campaign.take(batch[0], [campaign.on_killed(argument) for argument in batch[1]])
        return campaign.in_order()
    times, batches = _KILLS_ACCEPTED + 1, len(open_batches)
    raise UsageError(sentence("campaign.killed", times=times, batches=batches), workers=workers)


def _pool_pass(campaign: _Campaign[Argument, Result], batches: list[_Batch[Argument]], workers: int) -> None:
    """Send batches to a pool until all are done or a worker dies, which breaks the pool."""
    # "spawn": a forked child would inherit BLAS with the threads the parent started it with.
    pool = ProcessPoolExecutor(workers, mp_context=multiprocessing.get_context("spawn"))
    try:
        with interrupts_held():
            first_runs = {pool.submit(run_batch, campaign.run, batch): batch[0] for batch in batches}
        for future in as_completed(first_runs):
            campaign.take(first_runs[future], future.result())
    except KeyboardInterrupt:
        # Nobody waits for what they are computing.
        for worker in multiprocessing.active_children():
            worker.kill()
        raise
    finally:
        # Also after an error of a run: no worker is left behind.
        pool.shutdown(wait=True, cancel_futures=True)


@contextlib.contextmanager
def interrupts_held() -> Iterator[None]:
    """Let a Ctrl-C wait until the end of the block; processes started within never hear one, which is for this process."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGINT])
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


@contextlib.contextmanager
def one_blas_thread() -> Iterator[None]:
    """Let processes started within keep to one BLAS thread each."""
    before = {name: os.environ[name] for name in BLAS_VARIABLES if name in os.environ}
    os.environ.update(dict.fromkeys(BLAS_VARIABLES, "1"))
    try:
        yield
    finally:
        for name in BLAS_VARIABLES:
            os.environ.pop(name, None)
        os.environ.update(before)


def _on_cluster(campaign: _Campaign[Argument, Result], scheduler: str) -> list[Result]:
    distributed = load_package("distributed", "--scheduler", "study")
    if not _ADDRESS.fullmatch(scheduler):
        raise UsageError(sentence("campaign.scheduler_address", scheduler=scheduler))
    try:
        client = distributed.Client(scheduler, timeout=_CONNECT_TIMEOUT_S, set_as_default=False)
    except (OSError, TimeoutError, ValueError) as error:
        told = {"timeout_s": _CONNECT_TIMEOUT_S, "cause": str(error) or "silence"}
        raise LinkTimeoutError(sentence("campaign.scheduler_silent", scheduler=scheduler, **told), Reason.SILENCE) from error
    with client:
        batches = campaign.batches(max(len(client.nthreads()), 1))
        # Not pure: two campaigns with the same arguments are two campaigns. Tasks of a worker that dies go to another.
        futures = client.map(run_batch, [campaign.run] * len(batches), batches, pure=False, retries=_KILLS_ACCEPTED)
        of_key = {future.key: batch for future, batch in zip(futures, batches, strict=True)}
        try:
            for future in distributed.as_completed(futures, loop=client.loop):
                first, arguments, _ = of_key[future.key]
                try:
                    results = future.result()
                except distributed.KilledWorker:
                    if campaign.on_killed is None:
                        raise
                    results = [campaign.on_killed(argument) for argument in arguments]
                campaign.take(first, results)
        except (distributed.KilledWorker, OSError) as error:
            told = {"lost": len(batches) - len(campaign.results), "batches": len(batches), "cause": error}
            raise LinkError(sentence("campaign.cluster_lost", scheduler=scheduler, **told), Reason.DISCONNECTED) from error
    return campaign.in_order()
