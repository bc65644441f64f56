"""The footprint of the processes: memory of the demo, CPU time of two commands, how long nodes take to start and to end.

The same run measures the memory of a bare rclpy node: one publisher, one subscription, nothing else.

Memory is the proportional set size: a page that several processes share is divided among them.
"""

import pathlib
import re
import resource
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, suppress

import numpy as np
import psutil
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseWithCovarianceStamped

from bench.display import Figures, Verdict
from bench.processes import OBJECT, cell_of
from faults.cell_run import new_run
from pushfric_ros.faults.processes import NODES, end, started
from pushfric_ros.graph import fork_server, graph
from pushfric_ros.graph.supervisor import command
from pushfric_ros.node_kit.qos import RELIABLE, SENSOR_QUEUE
from pushfric_ros.node_kit.visit import visit

ROOT = pathlib.Path(__file__).resolve().parents[1]
DEMO_BAG = ROOT / "bags" / OBJECT

WATCHED = 8.0
"""How long the memory of the demo is sampled, from the first pose [s]; the largest total counts."""

EVENT_TIMEOUT = 60.0
"""How long nodes may take to appear and to end [s]."""

ROUNDS = 5
BARE_NODE = """
import rclpy
from std_msgs.msg import String
rclpy.init()
node = rclpy.create_node("bare")
publisher = node.create_publisher(String, "bare_out", 10)
subscription = node.create_subscription(String, "bare_in", lambda _: None, 10)
print("ready", flush=True)
rclpy.spin(node)
"""


def measure(progress: Callable[[str], None]) -> Figures:
    """Run the commands, the demo, and its nodes.

    Returns:
        "memory_mib": of each process of the demo and their "total"; "bare_memory_mib". "help_cpu_s" and "estimate_cpu_s":
        medians. "first_pose_s": median time from the start of the command line's process.
        "end_s": from SIGINT to the end of the last process, of the estimator ("alone") and of all six nodes ("together");
        "end_codes": exit codes other than 0.
    """
    figures: Figures = {}
    for name, arguments in (("help", ["--help"]), ("estimate", ["estimate", DEMO_BAG])):
        progress(name)
        figures[f"{name}_cpu_s"] = _cpu([ROOT / "pushfric", *arguments])
    progress("memory of the demo")
    figures |= demo() | {"end_s": {}, "end_codes": {}}
    for name, nodes in (("alone", ("estimator",)), ("together", NODES)):
        progress(f"end of nodes, {name}")
        figures["end_s"][name], codes = _end(nodes)
        figures["end_codes"] |= {f"{node}, {name}": code for node, code in codes.items() if code}
    return figures


def verdicts(figures: Figures) -> Iterator[Verdict]:
    """The targets, next to what was measured."""
    asked = (
        ("memory of the demo, six nodes and the command line, MiB", 400.0, figures["memory_mib"]["total"]),
        ("./pushfric --help, s of CPU", 0.5, figures["help_cpu_s"]),
        ("./pushfric estimate bags/rubber_rect4, s of CPU", 0.8, figures["estimate_cpu_s"]),
        ("run to first pose, s", 1.5, figures["first_pose_s"]),
        ("SIGINT to the end of the estimator, s", 0.3, figures["end_s"]["alone"]),
        ("SIGINT to the end of six nodes at once, s", 0.3, figures["end_s"]["together"]),
        ("exit codes other than 0", 0, len(figures["end_codes"])),
    )
    return (Verdict.at_most(target, limit, measured) for target, limit, measured in asked)


def _cpu(arguments: list[str | pathlib.Path]) -> float:
    """CPU time of a command and its children [s]: the median of several calls, after one that warms the caches."""
    spent = []
    for _ in range(ROUNDS + 1):
        subprocess.run(arguments, cwd=ROOT, stdout=subprocess.DEVNULL, check=True)
        usage = resource.getrusage(resource.RUSAGE_CHILDREN)
        spent.append(usage.ru_utime + usage.ru_stime)
    return float(np.median(np.diff(spent)))


def demo() -> Figures:
    """Start the demo several times; run the last one until its memory is known, with a bare node next to it.

    Returns:
        "memory_mib", "bare_memory_mib" and "first_pose_s", as `measure`.
    """
    with new_run() as bare:
        bare.start(sys.executable, "-c", BARE_NODE)
        bare.wait_for_output("ready")
        first_poses = [_started_demo(0.0)[0] for _ in range(ROUNDS - 1)]
        first_pose, samples = _started_demo(WATCHED)
        bare_memory = _memory(psutil.Process(bare.process.pid))
    largest = max(samples, key=lambda sample: sum(sample.values()))
    return {
        "memory_mib": largest | {"total": sum(largest.values())},
        "bare_memory_mib": bare_memory,
        "first_pose_s": float(np.median([*first_poses, first_pose])),
    }


def _started_demo(watched: float) -> tuple[float, list[dict[str, float]]]:
    """How long a demo takes to its first pose [s], and its memory, sampled for some time from then on [s]."""
    poses: list[int] = []  # when they were published [ns]
    samples: list[dict[str, float]] = []
    with new_run() as run, visit("bench", graph.NAMESPACE) as here:
        here.node.create_subscription(
            PoseWithCovarianceStamped, "object_pose", lambda _, info: poses.append(info["source_timestamp"]), SENSOR_QUEUE
        )
        begin = time.time_ns()
        run.demo()
        run.wait_for(lambda: here.spin_once(0.05) or poses or run.ended, "a pose")
        deadline = time.monotonic() + watched
        while not samples or time.monotonic() < deadline:
            if run.ended:
                raise RuntimeError(f"the demo ended early:\n{run.output}")
            samples.append(_memory_of_family(run.process.pid))
            here.spin_once(0.1)
        run.process.send_signal(signal.SIGINT)
        run.wait_for_end()
    return (poses[0] - begin) / 1e9, samples


def _end(names: Sequence[str]) -> tuple[float, dict[str, int]]:
    """Start these nodes of the simulated cell, and interrupt them; return the time [s] and the exit codes."""
    with tempfile.TemporaryDirectory(prefix="pushfric-bench-") as folder, ExitStack() as stack:
        up: set[str] = set()
        here = stack.enter_context(visit("bench", graph.NAMESPACE))
        here.node.create_subscription(
            DiagnosticArray, "/diagnostics", lambda msg: up.update(status.name for status in msg.status), RELIABLE
        )
        commands = {one.name: command(one, graph.NAMESPACE, pathlib.Path(folder)) for one in cell_of(folder)}
        processes = {name: started(commands[name], pathlib.Path(folder), subprocess.DEVNULL) for name in names}
        for process in processes.values():
            stack.callback(end, process)
        awaited = {f"{graph.NAMESPACE}/{node}" for node in names}
        deadline = time.monotonic() + EVENT_TIMEOUT
        while not up >= awaited:
            if time.monotonic() > deadline:
                raise RuntimeError(f"no report of {', '.join(sorted(awaited - up))} within {EVENT_TIMEOUT:g} s")
            here.spin_once(0.1)
        begin = time.monotonic()
        for process in processes.values():  # all at once, as a terminal does
            process.send_signal(signal.SIGINT)
        codes = {name: process.wait(EVENT_TIMEOUT) for name, process in processes.items()}
        return time.monotonic() - begin, codes


def _memory_of_family(pid: int) -> dict[str, float]:
    """Memory of a process and its descendants [MiB], by name."""
    found: dict[str, float] = {}
    command_line = psutil.Process(pid)
    for member in (command_line, *command_line.children(recursive=True)):
        with suppress(psutil.NoSuchProcess):  # it has ended since
            arguments = " ".join(member.cmdline())
            node = re.search(r" __node:=(\w+)", arguments)
            name = "fork server" if fork_server.__name__ in arguments else node[1] if node else "command line"
            found[name] = found.get(name, 0.0) + _memory(member)
    return found


def _memory(process: psutil.Process) -> float:
    """The proportional set size [MiB]."""
    return float(process.memory_full_info().pss) / 2**20
