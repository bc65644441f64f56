"""The supervisor with small programs instead of nodes."""

import contextlib
import os
import pathlib
import signal
import sys
import tempfile

import pytest
from calls import wait_until

from pushfric_core.errors import InvalidInput
from pushfric_ros.graph import supervisor
from pushfric_ros.graph.graph import NodeSpec
from pushfric_ros.graph.supervisor import Ended, Supervisor

NAME = "/test_supervisor"


def command(spec, _, folder):
    script = folder / f"{spec.name}.py"
    script.write_text(spec.parameters["program"])
    return [sys.executable, str(script)]


@pytest.fixture
def run(monkeypatch):
    """A function that supervises programs until the run ends; it returns how the run ended, and the lines that were printed."""
    monkeypatch.setattr(supervisor, "command", command)
    monkeypatch.setattr(supervisor, "RESPAWN_DELAY", 0.0)

    def run(**programs: NodeSpec) -> tuple[Ended, list[str]]:
        said: list[str] = []
        with Supervisor(list(programs.values()), NAME, lambda name, line: said.append(f"{name}: {line}")) as nodes:
            polled: list[Ended | None] = []
            wait_until(lambda: polled.append(nodes.poll()) or polled[-1], said, 60.0)
        return polled[-1], said

    return run


def node(name: str, program: str, **kwargs) -> NodeSpec:
    return NodeSpec(name, {"program": program}, **kwargs)


WAITS = "import time; time.sleep(300)"


def test_a_node_that_keeps_dying_ends_the_run(run, monkeypatch):
    monkeypatch.setattr(supervisor, "DEATHS_WITHIN", 3600.0)  # however slow the machine is
    ended, said = run(
        tracker=node("tracker", "print('no camera'); raise SystemExit(3)", respawn=True), other=node("other", WAITS)
    )
    assert ended == (3, "tracker ended with exit code 3, 3 times within 3600 s")
    assert said.count("supervisor: tracker ended with exit code 3; starting it again") == 2
    assert said.count("tracker: no camera") == 3


def test_a_node_with_unusable_input_is_not_started_again(run):
    ended, said = run(tracker=node("tracker", "raise SystemExit(2)", respawn=True))
    assert ended == (2, "tracker ended with exit code 2")
    assert said == []


def test_a_node_that_fails_at_the_end_is_known(monkeypatch):
    """A recorder, for example, closes its bag and finds that messages were lost."""
    monkeypatch.setattr(supervisor, "command", command)
    fails = "import signal, sys; signal.signal(15, lambda *_: sys.exit(1)); print('ready', flush=True); signal.pause()"
    said: list[str] = []
    with Supervisor([node("other", WAITS), node("recorder", fails)], NAME, lambda *line: said.append(line)) as nodes:
        wait_until(lambda: said, "the word that it is ready", 60.0)
        assert nodes.poll() is None
    assert nodes.failed_at_the_end == (1, "recorder ended with exit code 1")


def test_a_stopped_node_has_died(run, monkeypatch, tmp_path):
    """The node is started again if that loses nothing; otherwise its death ends the run."""
    monkeypatch.setattr(supervisor, "STOPPED", 0.2)
    lives = tmp_path / "lives"
    stops = f"""
import os, signal
open({str(lives)!r}, "a").write("x")
if len(open({str(lives)!r}).read()) == 1:
    os.kill(os.getpid(), signal.SIGSTOP)
"""
    ended, said = run(tracker=node("tracker", stops, respawn=True, ends_run=True))
    assert ended == (0, "tracker has finished")
    assert said == [
        "supervisor: tracker was stopped (SIGSTOP) for 0.2 s and is ended",
        "supervisor: tracker was killed by SIGKILL; starting it again",
    ]
    lives.unlink()
    ended, said = run(recorder=node("recorder", stops))
    assert ended == (1, "recorder was killed by SIGKILL")


def test_a_node_that_is_stopped_for_a_moment_lives_on(run, tmp_path):
    """A sibling stops the node and lets it go on."""
    program = """
import os, signal, time
child = os.fork()
if not child:
    time.sleep(0.5)
    os.kill(os.getppid(), signal.SIGCONT)
    os._exit(0)
os.kill(os.getpid(), signal.SIGSTOP)
os.waitpid(child, 0)
"""
    assert run(other=node("other", program, ends_run=True)) == ((0, "other has finished"), [])


def test_two_runs_of_one_name_are_refused():
    with (
        Supervisor([], NAME, print),
        pytest.raises(InvalidInput, match=f"a cell named {NAME} is already running"),
        Supervisor([], NAME, print),
    ):
        pass
    with Supervisor([], NAME, print):  # the refused run left the name free
        pass


@pytest.mark.usefixtures("run")
def test_the_nodes_hold_the_name_of_their_cell_too():
    with Supervisor([node("other", WAITS)], NAME, print) as nodes:
        (pid,) = nodes.processes.values()
        sockets = {
            entry.split()[6] for entry in pathlib.Path("/proc/net/unix").read_text().splitlines() if "@pushfric " in entry
        }
        held = set()
        for file in pathlib.Path(f"/proc/{pid}/fd").iterdir():
            with contextlib.suppress(FileNotFoundError):  # the node, which still starts, has closed it meanwhile
                held.add(os.readlink(file))
    assert {f"socket:[{number}]" for number in sockets} & held


@pytest.fixture
def temporary(tmp_path, monkeypatch):
    """The folder of temporary files, empty at first."""
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    return tmp_path


def handlers():
    return [signal.getsignal(caught) for caught in (signal.SIGINT, signal.SIGTERM)]


@pytest.mark.usefixtures("run")
@pytest.mark.parametrize("caught", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_interrupts_nothing_but_poll(temporary, caught):
    before = handlers()
    with Supervisor([node("other", WAITS)], NAME, print) as nodes:
        signal.raise_signal(caught)
        assert len(list(temporary.iterdir())) == 1  # the parameters of the nodes
        with pytest.raises(KeyboardInterrupt):
            nodes.poll()
    assert handlers() == before
    assert list(temporary.iterdir()) == []


@pytest.mark.usefixtures("run")
def test_a_node_that_cannot_be_started_leaves_nothing(temporary):
    before = handlers()
    nodes = Supervisor([node("other", WAITS), NodeSpec("odd", {})], NAME, print)
    with pytest.raises(KeyError, match="program"), nodes:
        pass
    assert not nodes._processes["other"].running
    assert handlers() == before
    assert list(temporary.iterdir()) == []
