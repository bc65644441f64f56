"""The benchmark's footprint figures, of real processes."""

import os
import subprocess
import sys

from bench import footprint


def test_the_memory_of_a_family_is_that_of_each_member():
    program = "print(flush=True); input()"
    child = f"import subprocess, sys; subprocess.run([sys.executable, '-c', {program!r}, '__node:=inner'])"
    with subprocess.Popen([sys.executable, "-c", child], stdin=subprocess.PIPE, stdout=subprocess.PIPE) as process:
        process.stdout.readline()  # both have loaded all that they need
        memory = footprint._memory_of_family(process.pid)
        process.communicate(b"\n")
    assert memory.keys() == {"command line", "inner"}
    assert all(1 < mebibytes < 100 for mebibytes in memory.values())


def test_cpu_time_is_that_of_the_command_and_its_children(monkeypatch):
    monkeypatch.setattr(footprint, "ROUNDS", 1)
    burn = "import time\nwhile time.process_time() < 0.3: pass"
    seconds = footprint._cpu(["bash", "-c", f"{sys.executable} -c '{burn}'; true"])
    assert seconds >= 0.3
    assert footprint._cpu_of(os.getpid()) > 0
