"""Many independent runs, on all cores or on a Dask cluster, with results that do not depend on how many workers there are.

Run ``i`` gets the ``i``-th child of one seed sequence, whoever does it and when. Runs go out in batches; a batch whose worker
is killed is done again, with the same seeds, so the result is the same as if nothing had happened. Each process keeps to one
BLAS thread: the matrices are 3 x 3, and two workers with two threads each would only get in each other's way.
"""

from __future__ import annotations

import contextlib
import math
import multiprocessing
import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from typing import Any, TypeVar

import numpy as np

from imufield.errors import LinkError, LinkTimeoutError, Reason, UsageError

Argument = TypeVar("Argument")
Result = TypeVar("Result")
Run = Callable[[Argument, np.random.Generator], Result]
Progress = Callable[[int, int], None]

BLAS_VARIABLES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "VECLIB_MAXIMUM_THREADS", "NUMEXPR_NUM_THREADS")
_BATCHES_PER_WORKER = 8
"""Enough that no worker waits long for another at the end, few enough that sending them costs nothing."""
_LARGEST_BATCH = 64
_KILLS_ACCEPTED = 5
"""A worker killed more often than this is killed by the run itself, or by lack of memory."""
_CONNECT_TIMEOUT_S = 10.0

_Batch = tuple[int, list[Any], list[np.random.SeedSequence]]
"""Index of its first run, arguments, seeds."""


def run_campaign(
    run: Run[Argument, Result],
    arguments: Sequence[Argument],
    *,
    seed: int,
    workers: int | None = None,
    scheduler: str | None = None,
    progress: Progress | None = None,
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
    progress : callable, optional
        Told runs done and runs in all.

    Raises
    ------
    UsageError
        If the number of workers makes no sense, Dask is not installed, or workers are killed again and again.
    LinkError
        If the scheduler does not answer or is lost.
    """
    seeds = np.random.SeedSequence(seed).spawn(len(arguments))
    tell = progress or _silent
    if scheduler is not None:
        return _on_cluster(run, arguments, seeds, scheduler, tell)
    if workers is not None and workers < 1:
        raise UsageError(f"{workers} workers can do nothing; use 1 or more, or leave it out for one per core", workers=workers)
    count = min(workers or os.cpu_count() or 1, max(len(arguments), 1))
    if count == 1:
        return _here(run, arguments, seeds, tell)
    return _on_processes(run, arguments, seeds, count, tell)


def _silent(_done: int, _total: int) -> None:
    return


def _here(
    run: Run[Argument, Result], arguments: Sequence[Argument], seeds: list[np.random.SeedSequence], tell: Progress
) -> list[Result]:
    results = []
    for argument, seed in zip(arguments, seeds, strict=True):
        results.append(run(argument, np.random.default_rng(seed)))
        tell(len(results), len(arguments))
    return results


def run_batch(run: Run[Argument, Result], batch: _Batch) -> list[Result]:
    """Return the results of one batch; the function that workers are sent."""
    return [run(argument, np.random.default_rng(seed)) for argument, seed in zip(batch[1], batch[2], strict=True)]


def _batches(arguments: Sequence[Any], seeds: list[np.random.SeedSequence], workers: int) -> list[_Batch]:
    size = min(max(math.ceil(len(arguments) / (workers * _BATCHES_PER_WORKER)), 1), _LARGEST_BATCH)
    return [(i, list(arguments[i : i + size]), seeds[i : i + size]) for i in range(0, len(arguments), size)]


def _on_processes(
    run: Run[Argument, Result],
    arguments: Sequence[Argument],
    seeds: list[np.random.SeedSequence],
    workers: int,
    tell: Progress,
) -> list[Result]:
    results: dict[int, list[Result]] = {}
    open_batches = _batches(arguments, seeds, workers)
    for _ in range(_KILLS_ACCEPTED + 1):
        with contextlib.suppress(BrokenProcessPool), one_blas_thread():
            _pool_pass(run, open_batches, workers, results, lambda done: tell(done, len(arguments)))
        open_batches = [batch for batch in open_batches if batch[0] not in results]
        if not open_batches:
            return [result for first in sorted(results) for result in results[first]]
    raise UsageError(
        f"workers of the campaign were killed {_KILLS_ACCEPTED + 1} times, {len(open_batches)} batches are not "
        "done; use fewer workers (the usual reason is lack of memory)",
        Reason.USAGE,
        workers=workers,
    )


def _pool_pass(
    run: Run[Argument, Result],
    batches: list[_Batch],
    workers: int,
    results: dict[int, list[Result]],
    tell: Callable[[int], None],
) -> None:
    """Send batches to a pool until all are done or a worker dies, which breaks the pool."""
    # "spawn": a forked child would inherit BLAS with the threads the parent started it with.
    pool = ProcessPoolExecutor(workers, mp_context=multiprocessing.get_context("spawn"))
    try:
        waiting: dict[Future[list[Result]], _Batch] = {pool.submit(run_batch, run, batch): batch for batch in batches}
        while waiting:
            for future in wait(waiting, return_when=FIRST_COMPLETED).done:
                results[waiting.pop(future)[0]] = future.result()
                tell(sum(len(done) for done in results.values()))
    finally:
        pool.shutdown(wait=True, cancel_futures=True)


@contextlib.contextmanager
def one_blas_thread() -> Iterator[None]:
    """Let processes started within keep to one BLAS thread each."""
    before = {name: os.environ.get(name) for name in BLAS_VARIABLES}
    os.environ.update(dict.fromkeys(BLAS_VARIABLES, "1"))
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value


def _on_cluster(
    run: Run[Argument, Result],
    arguments: Sequence[Argument],
    seeds: list[np.random.SeedSequence],
    scheduler: str,
    tell: Progress,
) -> list[Result]:
    distributed = _distributed()
    try:
        client = distributed.Client(scheduler, timeout=_CONNECT_TIMEOUT_S, set_as_default=False)
    except (OSError, TimeoutError, ValueError) as error:
        raise LinkTimeoutError(
            f"no Dask scheduler answers at {scheduler!r} within {_CONNECT_TIMEOUT_S:g} s ({error or 'silence'}); "
            "check the address and that the scheduler runs",
            Reason.SILENCE,
            scheduler=scheduler,
        ) from error
    with client:
        workers = len(client.nthreads())
        batches = _batches(arguments, seeds, max(workers, 1))
        # Not pure: two campaigns with the same arguments are two campaigns. Tasks of a worker that dies go to another.
        futures = client.map(run_batch, [run] * len(batches), batches, pure=False, retries=_KILLS_ACCEPTED)
        results: dict[int, list[Result]] = {}
        numbers = {future.key: batch[0] for future, batch in zip(futures, batches, strict=True)}
        try:
            for future, result in distributed.as_completed(futures, loop=client.loop, with_results=True):
                results[numbers[future.key]] = result
                tell(sum(len(done) for done in results.values()), len(arguments))
        except (distributed.KilledWorker, OSError) as error:
            raise LinkError(
                f"the Dask cluster at {scheduler!r} lost {len(batches) - len(results)} of {len(batches)} batches "
                f"({error}); check its workers and start again, the result will be the same",
                Reason.DISCONNECTED,
                scheduler=scheduler,
            ) from error
    return [result for first in sorted(results) for result in results[first]]


def _distributed() -> Any:
    try:
        import distributed  # pyright: ignore[reportMissingImports]  (of the study extra)
    except ModuleNotFoundError as error:
        raise UsageError(
            f"--scheduler needs the package distributed, which is not installed ({error}); install imufield[study]",
            Reason.MISSING_PACKAGE,
            package="distributed",
        ) from error
    return distributed
