"""One function called for many arguments, by processes of this machine or by the workers of a Dask cluster."""

import os
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from typing import TypeVar

from joblib import Parallel, delayed
from joblib.externals.loky.process_executor import TerminatedWorkerError

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
    parallel = Parallel(jobs, return_as="generator_unordered", initializer=_end_with, initargs=(os.getpid(),))
    try:
        yield from parallel(delayed(work)(argument) for argument in arguments)
    except TerminatedWorkerError as error:
        raise WorkerKilled("a worker process was killed; perhaps memory ran out: try fewer --jobs") from error


def _end_with(parent: int) -> None:
    """Let this worker process end with its parent, even if the parent is killed; joblib's workers would stay for ever."""

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
