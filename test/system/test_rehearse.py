"""`./pushfric rehearse` on the simulated firmware: a sample of its table, and what it leaves behind."""

import contextlib
import importlib
import pathlib
import re
import signal
import subprocess
import sys
import time
from dataclasses import replace

import pytest
from calls import PROGRAM, simulated_arm, wait_until
from marlin_firmware import SimulatedMarlin

from pushfric_core.simulated.faulty_line import once
from pushfric_core.simulated.grbl_firmware import SimulatedGrbl
from pushfric_ros.commands import rehearse
from pushfric_ros.faults import fault as faults
from pushfric_ros.faults.pusher import FAULTS, damaged
from pushfric_ros.node_kit.person import NoAnswer, Person
from pushfric_ros.node_kit.visit import visit

EXAMPLES = pathlib.Path(__file__).parents[2] / "examples"
PATIENT = 30.0  # silence, for a busy machine [s]
DRIVERS = "grbl, marlin, slide, trajectory, twist"
QUICK = {"another program sets inches, increments and 200 % feed", "kill -9 of the actuator", "impossible settings"}
"""A fault of the controller, one of the host, and one that is found by questions; test_runaway.py has the others."""
KILL = "kill -9 of the actuator"


@pytest.fixture
def controller():
    with SimulatedGrbl(time.monotonic, restarts=False) as controller:
        yield controller


@pytest.fixture
def rehearsed(call, controller):
    """Calls the command with the simulated controller, or with another driver and its settings."""

    def called(*options, driver="", settings=()):
        device = ("--driver", driver) if driver else ("--port", controller.port, "--silence", PATIENT)
        given = [part for setting in settings for part in ("--set", setting)]
        return call("rehearse", *device, *given, "--stroke", 0.03 if driver else 0.04, *options)

    return called


@pytest.fixture
def only(monkeypatch):
    """Leaves these rows in the tables, with other times within which the pusher must rest."""

    def leave(*names: str, times: float = 1.0) -> None:
        for table in ("FAULTS", "CONTRACT"):
            rows = [fault for fault in getattr(rehearse, table) if fault.name in names]
            musts = [replace(fault.must, within=fault.must.within and times * fault.must.within) for fault in rows]
            monkeypatch.setattr(rehearse, table, [fault._replace(must=must) for fault, must in zip(rows, musts, strict=True)])

    return leave


def test_faults_that_end_as_they_must(rehearsed, controller, only):
    only(*QUICK)
    before = dict(controller._settings)
    said = rehearsed("--json")
    if said.returncode:  # on a busy machine a kill takes effect later than recorded; then only this may fail
        assert f"{KILL}: it went too far" in said.stderr
    else:
        assert said.stderr.count("as it must be") == len(QUICK)
        assert '"changed": []' in " ".join(said.stdout.split())
    assert controller.position() == pytest.approx(0.0, abs=1e-9)
    assert controller._settings == before
    assert controller._state == "Idle"


def test_random_damage_of_the_line_ends_as_it_must(rehearsed, controller):
    """In mid-push, during a stop, and during a connection."""
    assert rehearsed("--damage", 3, "--seed", 1).stderr.count("as it must be") == 3
    assert controller.position() == pytest.approx(0.0, abs=1e-9)
    assert controller._state == "Idle"


def test_a_fault_that_ends_otherwise_is_exit_code_1(rehearsed, only):
    only(KILL, times=0.003)  # more than any pusher can
    said = rehearsed()
    assert said.returncode == 1
    assert f"{KILL}: it went too far" in said.stderr


def test_a_fault_that_was_not_caused_is_tried_again_and_says_so(rehearsed, monkeypatch):
    """For example a command without the byte that was to be damaged."""
    (row,) = (fault for fault in FAULTS if fault.name == "a byte of a command is lost")
    monkeypatch.setattr(rehearse, "FAULTS", [row._replace(cause=damaged(to_controller=lambda stage: once(b"no command", b"")))])
    monkeypatch.setattr(faults, "TRIES", 2)
    said = rehearsed()
    assert said.returncode == 1
    assert re.search(f"{row.name}: the push ended before .*, on try 2", said.stderr)


@pytest.fixture
def started(controller):
    """A function that starts a rehearsal in a process of its own, and waits until it is in mid-push."""

    def start(silence: float = PATIENT) -> subprocess.Popen:
        command = [*PROGRAM, "rehearse", "--port", controller.port, "--stroke", "0.04", "--silence", str(silence)]
        given = {"stdin": subprocess.DEVNULL, "stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
        process = subprocess.Popen(command, **given)
        wait_until(lambda: controller.position() > 0.003 or process.poll() is not None, "a motion")
        assert process.poll() is None, process.communicate()
        return process

    return start


@contextlib.contextmanager
def slide(folder):
    """The example of a driver of one's own, whose device lives in a thread."""
    importlib.import_module("own_pusher").Slide(str(folder / "device")).start()
    yield [f"device={folder / 'device'}"]


@contextlib.contextmanager
def marlin(folder):
    with SimulatedMarlin(time.monotonic) as controller:
        yield [f"port={controller.port}", f"silence={PATIENT}"]


@contextlib.contextmanager
def arm(folder):
    with simulated_arm(folder / "log"):
        with visit("waiting") as waiting:
            wait_until(lambda: waiting.node.count_publishers("/tool_pose"), "the start of the arm")
        yield ["source=pose_stamped", "topic=/tool_pose", "origin=[0, 0, 0.12]", "table=[0.5, 0.1, 0.3]", "silence=1"]
    assert "Traceback" not in (folder / "log").read_text()


@pytest.fixture
def examples(install):
    """The examples of drivers, installed."""
    install("[pushfric.pushers]\nslide = own_pusher:SlideConfig\nmarlin = marlin:MarlinConfig\n", EXAMPLES)
    yield
    sys.modules.pop("own_pusher", None)


@pytest.mark.parametrize(
    ("driver", "device", "names"),
    [
        ("slide", slide, ("no fault", KILL)),
        # what the actuator does for every driver was seen; when nobody asks any more, each has to stop by itself
        ("marlin", marlin, (KILL,)),
        # to an arm, both are the same: commands no longer come
        ("twist", arm, ("SIGSTOP of both, as by a suspension",)),
        ("trajectory", arm, (KILL,)),
    ],
)
def test_the_contract_of_every_driver(examples, rehearsed, only, tmp_path, driver, device, names):
    only(*names, times=2)  # for a machine full of tests; a pusher that goes on fails all the same
    with device(tmp_path) as settings:
        assert rehearsed(driver=driver, settings=settings).stderr.count("as it must be") == len(names)


def test_a_way_back_that_a_busy_machine_interrupts_is_tried_again(examples, rehearsed, only, tmp_path, monkeypatch):
    jog, asked, left = Person.jog, [], []

    def interrupted(person: Person, distance: float, speed: float) -> str:
        asked.append(distance)
        if left:
            return jog(person, distance, speed)
        with contextlib.suppress(NoAnswer):  # a busy machine may interrupt it, too
            jog(person, distance / 2, speed)
        left.append(-person.state(new=True).position)
        raise NoAnswer("this process stood still")

    monkeypatch.setattr(Person, "jog", interrupted)
    only("somebody calls actuator/stop", times=2)
    with slide(tmp_path) as settings:
        run = rehearsed(driver="slide", settings=settings)
    assert run.stderr.count("as it must be") == 1, run.stderr
    assert asked[1] == pytest.approx(left[0], abs=2e-3)


def test_a_plug_that_is_pulled_ends_the_rehearsal_with_a_line(controller, started):
    process = started(silence=2.0)
    controller.close()
    out, err = process.communicate(timeout=120)
    assert "Traceback" not in out + err
    assert process.returncode == 1, err
    assert f"error: the line to the controller at {controller.port} is broken: " in err


def test_ctrl_c_stops_the_pusher(controller, started):
    process = started()
    process.send_signal(signal.SIGINT)
    out, err = process.communicate(timeout=120)
    assert process.returncode == 130, err
    assert "Traceback" not in out + err
    rest = controller.position()
    assert controller._motion is None
    time.sleep(0.3)
    assert controller.position() == rest < 0.04


@pytest.mark.parametrize(
    ("arguments", "error"),
    [
        ([], "--stroke is missing: how far the pusher may go forward from where it stands [m]"),
        (["--stroke", 0.005], "--stroke must be at least 19 mm at this speed, got 5 mm"),
        (["--driver", "crane"], f"--driver must be an entry point of pushfric.pushers ({DRIVERS}), got 'crane'"),
        (["--driver", "slide"], "--set: device must be given: socket of the slide"),
        (["--driver", "slide", "--set", "device=here", "--kills", 3], "--kills and --damage are for the driver grbl"),
    ],
)
def test_wrong_input_is_one_line(examples, controller, call, arguments, error):
    said = call("rehearse", "--port", controller.port, *arguments)
    assert (said.stderr, said.returncode) == (f"error: {error}\n", 2)
    assert controller.position() == 0.0


@pytest.mark.parametrize("place", [10, 50], ids=["within the stroke", "beyond it"])
def test_a_pusher_that_does_not_stand_at_zero_is_left_there(controller, rehearsed, place):
    """A cell of the rehearsal would bring it back to 0, behind where the user said that it may move."""
    pathlib.Path(controller.port).write_bytes(b"$J=X%d F3000\n" % place)
    wait_until(lambda: controller.position() == 1e-3 * place and controller._state == "Idle")
    said = rehearsed()
    assert said.stderr == f"error: the controller stands at {place}.000 mm, expected 0: bring it there, or set its work zero\n"
    assert said.returncode == 1
    assert controller.position() == 1e-3 * place


def test_a_controller_in_alarm_is_left_alone(controller, rehearsed):
    controller.alarm(3)
    said = rehearsed()
    assert "the controller is alarm: expected one that rests, unlocked and homed" in said.stderr
    assert said.returncode == 1
    assert controller._state == "Alarm"
