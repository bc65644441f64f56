"""One function called for many arguments, by processes of this machine or by the workers of a Dask cluster."""

import importlib
import os
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from typing import TypeVar

from joblib import Parallel, delayed

from pushfric_core.errors import InvalidInput

DASK_TIMEOUT = "10s"
"""How long the scheduler of a Dask cluster may take to answer (a duration in Dask's notation)."""

Result = TypeVar("Result")


def results(work: Callable[[int], Result], seeds: Iterable[int], jobs: int, dask: str | None) -> Iterator[Result]:
    """What `work` returns for each seed, in the order in which they are done.

    Args:
        work: the function.
        seeds: its arguments.
        jobs: processes on this machine; -1: one for each core.
        dask: address of the scheduler of a Dask cluster to use instead; None: this machine.
    Raises:
        InvalidInput: no cluster answers.
    """
    yield from _on_cluster(work, seeds, dask) if dask else _on_this_machine(work, seeds, jobs)


def _on_this_machine(work: Callable[[int], Result], seeds: Iterable[int], jobs: int) -> Iterator[Result]:
    parallel = Parallel(jobs, return_as="generator_unordered", initializer=_end_with, initargs=(os.getpid(),))
    yield from parallel(delayed(work)(seed) for seed in seeds)


def _end_with(parent: int) -> None:
    """Let this worker process end with its parent, even if the parent is killed; joblib's workers would stay for ever."""

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(1)
        os._exit(1)

    threading.Thread(target=watch, name="end with the parent", daemon=True).start()


def _on_cluster(work: Callable[[int], Result], seeds: Iterable[int], address: str) -> Iterator[Result]:
    # importing it takes a second, which a run without a cluster should not wait for
    distributed = importlib.import_module("distributed")
    try:
        client = distributed.Client(address, timeout=DASK_TIMEOUT)
    except (OSError, ValueError) as error:
        raise InvalidInput(f"--dask: no scheduler answers at {address}: {error}") from error
    with client:
        futures = client.map(work, list(seeds), pure=False)
        for _, result in distributed.as_completed(futures, with_results=True):
            yield result
