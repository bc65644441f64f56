"""A Dask cluster of two worker processes on this machine, which find what is in the checkout."""

import contextlib
import os
import pathlib
import subprocess
import sys
from collections.abc import Iterator

import psutil

ROOT = pathlib.Path(__file__).resolve().parents[1]

CLUSTER = """
import sys
from distributed import LocalCluster
with LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as cluster:
    print(cluster.scheduler_address, flush=True)
    sys.stdin.read()
"""


@contextlib.contextmanager
def local_cluster(folder: pathlib.Path) -> Iterator[str]:
    """Start a cluster; yields the address of its scheduler. Afterwards, the cluster and its workers have ended.

    Args:
        folder: for the workers' files.
    """
    command = [sys.executable, "-c", CLUSTER]
    paths = os.pathsep.join((str(ROOT), os.environ.get("PYTHONPATH", "")))
    environment = os.environ | {"DASK_TEMPORARY_DIRECTORY": str(folder), "PYTHONPATH": paths}
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, env=environment) as cluster:
        address = cluster.stdout.readline().strip()
        workers = psutil.Process(cluster.pid).children(recursive=True)
        yield address
        cluster.communicate(timeout=120)
    assert cluster.returncode == 0
    assert len(workers) >= 2
    assert not psutil.wait_procs(workers, timeout=120)[1]
