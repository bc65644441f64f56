"""Little CPU time for a running cell: by a control group, or by busy loops where none can be made."""

import contextlib
import math
import os
import pathlib
import subprocess
import sys
from collections.abc import Iterator

GROUPS = pathlib.Path("/sys/fs/cgroup")  # of version 2, cgroups(7)

PERIOD = 100_000
"""Within which the kernel counts the CPU time of a group, its default [us]."""


@contextlib.contextmanager
def cpu_quota(percent: float, pid: int) -> Iterator[str]:
    """Leave a process, and all that it starts from now on, this share of one processor's time.

    Yields:
        How the time is limited, in words.
    """
    with contextlib.ExitStack() as undo:
        try:
            group = undo.enter_context(_group(percent))
        except OSError:
            one, loops = {min(os.sched_getaffinity(pid))}, math.ceil(100 / percent - 1)
            os.sched_setaffinity(pid, one)
            for _ in range(loops):
                busy = undo.enter_context(subprocess.Popen([sys.executable, "-c", "while True: pass"]))
                os.sched_setaffinity(busy.pid, one)
                undo.callback(busy.kill)
            yield f"{loops} busy processes on the one processor that is left to it"
        else:
            (group / "cgroup.procs").write_text(str(pid))
            yield f"a control group with {percent:g} % of a processor"


@contextlib.contextmanager
def _group(percent: float) -> Iterator[pathlib.Path]:
    """A new control group with a quota, which must be empty when it is removed.

    Raises:
        OSError: none can be made here.
    """
    group = GROUPS / f"pushfric-{os.getpid()}"
    (GROUPS / "cgroup.controllers").read_text()  # only version 2 has it
    group.mkdir()
    try:
        (group / "cpu.max").write_text(f"{round(PERIOD * percent / 100)} {PERIOD}")
        yield group
    finally:
        for pid in (group / "cgroup.procs").read_text().split():
            with contextlib.suppress(OSError):  # it has ended meanwhile
                (group.parent / "cgroup.procs").write_text(pid)
        group.rmdir()
