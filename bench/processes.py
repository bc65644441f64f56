"""Processes that a benchmark starts, and what they use."""

import resource
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any


@contextmanager
def running(arguments: list[str], **options: Any) -> Iterator["subprocess.Popen[str]"]:
    """A process that is killed in the end."""
    with subprocess.Popen(arguments, text=True, **options) as process:
        try:
            yield process
        finally:
            process.kill()


def cpu_of_ended_children() -> float:
    """CPU time of this process's children that have ended, and of theirs [s]."""
    usage = resource.getrusage(resource.RUSAGE_CHILDREN)
    return usage.ru_utime + usage.ru_stime
