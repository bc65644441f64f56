"""Little CPU time for a running cell, by a control group of either version, cgroups(7)."""

import contextlib
import os
import pathlib
import time
from collections.abc import Iterator

GROUPS = pathlib.Path("/sys/fs/cgroup")

PERIOD = 100_000
"""Within which the kernel counts the CPU time of a group, its default [us]."""


def available() -> bool:
    """Whether a group with a quota can be made here."""
    try:
        with _group(100):
            return True
    except OSError:
        return False


@contextlib.contextmanager
def cpu_quota(percent: float, pid: int) -> Iterator[None]:
    """Leave a process, and all that it starts from now on, this share of one processor's time.

    Raises:
        OSError: no group can be made here.
    """
    with _group(percent) as group:
        (group / "cgroup.procs").write_text(str(pid))
        yield


@contextlib.contextmanager
def _group(percent: float) -> Iterator[pathlib.Path]:
    """A new control group with a quota; the processes that are left in it at the end go back to its root."""
    version_2 = (GROUPS / "cgroup.controllers").exists()
    root, quota = GROUPS if version_2 else GROUPS / "cpu", round(PERIOD * percent / 100)
    (root / "cgroup.procs").read_text()  # or this is an ordinary folder, as in some sandboxes
    group = root / f"pushfric-{os.getpid()}"
    group.mkdir()
    try:
        if version_2:
            (group / "cpu.max").write_text(f"{quota} {PERIOD}")
        else:
            (group / "cpu.cfs_quota_us").write_text(f"{quota}")
        yield group
    finally:
        while left := (group / "cgroup.procs").read_text().split():
            for pid in left:
                with contextlib.suppress(ProcessLookupError):  # it has ended meanwhile
                    (root / "cgroup.procs").write_text(pid)
            time.sleep(0.01)  # those that it has started meanwhile are moved, too
        group.rmdir()
