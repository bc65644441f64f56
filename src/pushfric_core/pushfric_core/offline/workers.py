"""A function called for many arguments, by processes of this machine or by the workers of a Dask cluster."""

import multiprocessing
import os
import signal
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from typing import TypeVar

from pushfric_core.errors import InvalidInput, PushfricError

DASK_TIMEOUT = "10s"
"""How long the scheduler of a Dask cluster may take to answer (a duration in Dask's notation)."""

Argument = TypeVar("Argument")
Result = TypeVar("Result")


class WorkerKilled(PushfricError):
    """A worker process was killed."""


def results(work: Callable[[Argument], Result], arguments: Iterable[Argument], jobs: int, dask: str | None) -> Iterator[Result]:
    """The result of `work` for each argument, in order of completion.

    Args:
        work: the function.
        arguments: one for each call.
        jobs: processes on this machine; -1: one for each core.
        dask: address of the scheduler of a Dask cluster to use instead; None: this machine.
    Raises:
        InvalidInput: no cluster answers.
        WorkerKilled: a process of this machine was killed.
    """
    yield from _on_cluster(work, arguments, dask) if dask else _on_this_machine(work, arguments, jobs)


def _on_this_machine(work: Callable[[Argument], Result], arguments: Iterable[Argument], jobs: int) -> Iterator[Result]:
    if jobs == 1:
        yield from map(work, arguments)
        return
    processes = len(os.sched_getaffinity(0)) if jobs < 0 else jobs
    # started from nothing: a fork would copy locks that the threads of this process may hold
    pool = ProcessPoolExecutor(processes, multiprocessing.get_context("spawn"), _end_with, (os.getpid(),))
    try:
        for future in as_completed([pool.submit(work, argument) for argument in arguments]):
            yield future.result()
    except BrokenProcessPool as error:
        raise WorkerKilled("a worker process was killed; perhaps memory ran out: try fewer --jobs") from error
    finally:
        pool.shutdown(cancel_futures=True)


def _end_with(parent: int) -> None:
    """Let this worker process end with its parent, even if the parent is killed; on Ctrl-C, the parent ends it."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(1)
        os._exit(1)

    threading.Thread(target=watch, name="end with the parent", daemon=True).start()


def _on_cluster(work: Callable[[Argument], Result], arguments: Iterable[Argument], address: str) -> Iterator[Result]:
    # imported late: it takes a second, for which a run without a cluster should not wait
    import distributed

    try:
        client = distributed.Client(address, timeout=DASK_TIMEOUT)
    except (OSError, ValueError) as error:
        raise InvalidInput(f"--dask: no scheduler answers at {address}: {error}") from error
    with client:
        futures = client.map(work, list(arguments), pure=False)
        for _, result in distributed.as_completed(futures, with_results=True):
            yield result
