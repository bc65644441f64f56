"""The stop that needs no middleware."""

import fcntl
import os
import pathlib
import socket
import subprocess
import sys
import threading

import pytest

from pushfric_ros.node_kit.lock import address, lock
from pushfric_ros.node_kit.stop_button import StopButton, Unheard, press, press_as_asked

ROOT = pathlib.Path(__file__).parents[3]


@pytest.fixture
def answering():
    """A button that answers whoever presses it."""
    button, over, presses = StopButton("/cell"), threading.Event(), []

    def listen() -> None:
        while not over.wait(0.001):
            if (who := button.pressed()) is not None:
                presses.append(who)
                button.answer(who, "stopped")

    assert button.pressed() is None  # it listens from now on
    thread = threading.Thread(target=listen)
    thread.start()
    yield presses
    over.set()
    thread.join()
    button.close()


@pytest.fixture
def nobody(monkeypatch):
    """A domain without nodes."""
    monkeypatch.setenv("ROS_DOMAIN_ID", "99")
    return 99


def test_whoever_presses_it_is_answered(answering):
    StopButton("/cell").close()  # as that of an actuator which is only asked what it has
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as without_an_address:
        without_an_address.sendto(b"!", address("stop /cell"))
    assert press("cell") == press_as_asked([]) == press_as_asked(["--namespace", "/cell"]) == "stopped"
    assert len(answering) == 4
    assert press_as_asked(["--help"]) is None


@pytest.mark.parametrize("namespace", ["/cell", "/other"])
def test_it_is_that_of_one_cell_in_one_domain(answering, namespace, nobody):
    with pytest.raises(Unheard, match=f"^nobody listens to {namespace}/stop; "):
        press(namespace)
    assert not answering


@pytest.mark.parametrize(
    ("name", "value"),
    [("ROS_AUTOMATIC_DISCOVERY_RANGE", "SUBNET"), ("ROS_STATIC_PEERS", "10.0.0.1"), ("RMW_IMPLEMENTATION", "rmw_zenoh_cpp")],
)
def test_who_may_hear_it_elsewhere_is_sought(nobody, monkeypatch, name, value):
    monkeypatch.setenv(name, value)
    assert press("/cell") is None


def test_a_node_of_any_kind_may_hear_it_in_another_way(nobody):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as port:
        port.bind(("127.0.0.1", 7400 + 250 * nobody + 11))
        assert press("/cell") is None


def test_a_node_that_has_only_shared_memory_may_hear_it(nobody):
    port = pathlib.Path(f"/dev/shm/fastrtps_port{7400 + 250 * nobody + 11}_el")
    try:
        with port.open("w") as locked:
            fcntl.flock(locked, fcntl.LOCK_EX)
            assert press("/cell") is None
        with pytest.raises(Unheard):  # the file of a process that was killed
            press("/cell")
    finally:
        port.unlink()


def test_who_presses_it_may_be_gone(answering):
    """The answer goes nowhere, and the next one is answered."""
    begin = "import contextlib, pushfric_ros.node_kit.stop_button as s; s.ANSWER_TIMEOUT = 1e-9"
    program = f"{begin}\nwith contextlib.suppress(s.Unheard): s.press('/cell')"  # the answer may be late for that
    subprocess.run([sys.executable, "-c", program], check=True)
    assert press("/cell") == "stopped"


@pytest.mark.parametrize("command", [["./pushfric", "stop"], [sys.executable, "-m", "pushfric_core", "stop"]])
def test_the_command_presses_it_first(answering, command):
    ended = subprocess.run(command, capture_output=True, text=True)
    assert (ended.returncode, ended.stdout, ended.stderr) == (0, "stopped\n", "")
    assert len(answering) == 1


def test_a_domain_that_is_none_is_named():
    ended = subprocess.run(["./pushfric", "stop"], env=os.environ | {"ROS_DOMAIN_ID": "abc"}, capture_output=True, text=True)
    said = "error: ROS_DOMAIN_ID must be a number from 0 to 232, got 'abc'\n"
    assert (ended.returncode, ended.stdout, ended.stderr) == (2, "", said)


def test_the_script_needs_the_standard_library_alone():
    """The names of commands and the button are looked at before anything is installed."""
    paths = [str(ROOT / "src" / package) for package in ("pushfric_core", "pushfric_ros")]
    program = f"import sys; sys.path[:0] = {paths}; import pushfric_ros.commands, pushfric_ros.node_kit.stop_button"
    subprocess.run([sys.executable, "-I", "-S", "-c", program], check=True)


def test_a_stop_without_a_cell_names_the_cells_that_run(monkeypatch):
    monkeypatch.setenv("ROS_DOMAIN_ID", "99")
    with lock("/left"):
        monkeypatch.setenv("ROS_DOMAIN_ID", "98")
        said = subprocess.run([sys.executable, "-m", "pushfric_core", "stop"], capture_output=True, text=True).stderr
    assert said.startswith("error: nobody listens to /cell/stop; running on this machine: ")
    assert "/left (ROS domain 99)" in said
