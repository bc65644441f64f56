"""`./pushfric rehearse` on the simulated firmware: a sample of its table, and what it leaves behind."""

import contextlib
import importlib
import pathlib
import signal
import subprocess
import sys
import time

import pytest
from calls import PROGRAM, wait_until
from marlin_firmware import SimulatedMarlin

from pushfric_core.commands.application import STDOUT
from pushfric_core.pushers.grbl import Grbl
from pushfric_core.pushers.pusher import drive
from pushfric_core.pushers.serial_pusher import SerialPusher
from pushfric_core.pushers.serial_settings import SerialSettings
from pushfric_core.simulated.grbl_firmware import SimulatedGrbl
from pushfric_ros.commands import rehearse
from pushfric_ros.node_kit.person import NoAnswer, Person
from pushfric_ros.node_kit.visit import visit
from pushfric_ros.rehearsal.faults import CONTRACT, FAULTS, Fault

EXAMPLES = pathlib.Path(__file__).parents[2] / "examples"
PATIENT = 30.0  # silence, for a busy machine [s]
DRIVERS = "grbl, marlin, slide, trajectory, twist"
QUICK = {"another program sets inches, increments and 200 % feed", "kill -9 of the actuator", "impossible settings"}
"""A fault of the controller, one of the host, and one that is found by questions; test_runaway.py has the others."""


def chosen(*names: str):
    return tuple(fault for fault in FAULTS if fault.name in names)


def call(controller: SimulatedGrbl, **options) -> None:
    given = {"stroke": 0.04, "speed": 0.02, "axis": "X", "baud": 115200, "silence": PATIENT, "kills": 0, "seed": 0}
    rehearse.rehearsal(port=controller.port, json=STDOUT, **given | options)


def test_faults_that_end_as_they_must(monkeypatch, capsys):
    monkeypatch.setattr(rehearse, "FAULTS", chosen(*QUICK))
    with SimulatedGrbl(time.monotonic, restarts=False) as controller:
        before = dict(controller._settings)
        try:
            call(controller)
        except SystemExit:  # on a busy machine a kill takes effect later than recorded; then only this may fail
            assert "kill -9 of the actuator: it went too far" in capsys.readouterr().err
        else:
            said = capsys.readouterr()
            assert said.err.count("as it must be") == len(QUICK)
            assert '"changed": []' in " ".join(said.out.split())
        assert controller.position() == pytest.approx(0.0, abs=1e-9)
        assert controller._settings == before
        assert controller._state == "Idle"


def test_random_damage_of_the_line_ends_as_it_must(capsys):
    """In mid-push, during a stop, and during a connection."""
    with SimulatedGrbl(time.monotonic, restarts=False) as controller:
        call(controller, damage=3, seed=1)
        assert capsys.readouterr().err.count("as it must be") == 3
        assert controller.position() == pytest.approx(0.0, abs=1e-9)
        assert controller._state == "Idle"


def test_a_fault_that_ends_otherwise_is_exit_code_1(monkeypatch, capsys):
    (fault,) = chosen("kill -9 of the actuator")
    monkeypatch.setattr(rehearse, "FAULTS", (fault._replace(within=0.001),))  # more than any pusher can
    with SimulatedGrbl(time.monotonic, restarts=False) as controller, pytest.raises(SystemExit) as ended:
        call(controller)
    assert ended.value.code == 1
    assert "kill -9 of the actuator: it went too far" in capsys.readouterr().err


def started(controller: SimulatedGrbl, silence: float = PATIENT) -> subprocess.Popen:
    """A rehearsal in mid-push."""
    command = [*PROGRAM, "rehearse", "--port", controller.port, "--stroke", "0.04", "--silence", str(silence)]
    process = subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    wait_until(lambda: controller.position() > 0.003 or process.poll() is not None, "a motion")
    assert process.poll() is None, process.communicate()
    return process


@pytest.fixture
def slide(install):
    """The examples of drivers, installed; the module of the slide."""
    install("[pushfric.pushers]\nslide = own_pusher:SlideConfig\nmarlin = marlin:MarlinConfig\n", EXAMPLES)
    yield importlib.import_module("own_pusher")
    sys.modules.pop("own_pusher", None)


def rehearse_slide(device) -> None:
    rehearse.rehearsal(driver="slide", settings=[f"device={device}"], stroke=0.03, speed=0.02, json=STDOUT)


def unhurried(names: set[str]) -> tuple[Fault, ...]:
    """Those rows of the contract, with twice the time for a machine full of tests; a pusher that goes on fails all the same."""
    rows = (fault for fault in CONTRACT if fault.name in names)
    return tuple(fault if fault.within is None else fault._replace(within=2 * fault.within) for fault in rows)


def test_the_contract_of_every_driver(slide, tmp_path, monkeypatch, capsys):
    names = {"no fault", "kill -9 of the actuator"}
    monkeypatch.setattr(rehearse, "CONTRACT", unhurried(names))
    slide.Slide(str(tmp_path / "device")).start()
    rehearse_slide(tmp_path / "device")
    assert capsys.readouterr().err.count("as it must be") == len(names)
    # what the actuator does for every driver was seen; when nobody asks any more, each has to stop by itself
    monkeypatch.setattr(rehearse, "CONTRACT", unhurried({"kill -9 of the actuator"}))
    with SimulatedMarlin(time.monotonic) as controller:
        settings = [f"port={controller.port}", f"silence={PATIENT}"]
        rehearse.rehearsal(driver="marlin", settings=settings, stroke=0.03, speed=0.02, json=STDOUT)
    assert capsys.readouterr().err.count("as it must be") == 1


@pytest.mark.parametrize(
    ("driver", "fault"), [("twist", "SIGSTOP of both, as by a suspension"), ("trajectory", "kill -9 of the actuator")]
)
def test_an_arm_keeps_the_contract(driver, fault, tmp_path, monkeypatch, capsys):
    """To an arm, both are the same: commands no longer come."""
    monkeypatch.setattr(rehearse, "CONTRACT", unhurried({fault}))
    settings = ["source=pose_stamped", "topic=/tool_pose", "origin=[0, 0, 0.12]", "table=[0.5, 0.1, 0.3]", "silence=1"]
    with open(tmp_path / "log", "w") as log:
        arm = subprocess.Popen([sys.executable, EXAMPLES / "arm.py"], stdout=log, stderr=log)
    try:
        with visit("waiting") as waiting:
            wait_until(lambda: waiting.node.count_publishers("/tool_pose"), "the start of the arm")
        rehearse.rehearsal(driver=driver, settings=settings, stroke=0.03, speed=0.02, json=STDOUT)
    finally:
        arm.terminate()
        arm.wait(60)
    assert capsys.readouterr().err.count("as it must be") == 1
    assert "Traceback" not in (tmp_path / "log").read_text()


def test_a_way_back_that_a_busy_machine_interrupts_is_tried_again(slide, tmp_path, monkeypatch, capsys):
    jog, halves = Person.jog, []

    def interrupted(person: Person, distance: float, speed: float) -> str:
        jog(person, distance if halves else distance / 2, speed)
        halves.append(distance)
        if len(halves) == 1:
            raise NoAnswer("this process stood still")
        return ""

    monkeypatch.setattr(Person, "jog", interrupted)
    monkeypatch.setattr(rehearse, "CONTRACT", unhurried({"somebody calls actuator/stop"}))
    slide.Slide(str(tmp_path / "device")).start()
    rehearse_slide(tmp_path / "device")
    assert capsys.readouterr().err.count("as it must be") == 1
    assert halves[1] == pytest.approx(halves[0] / 2, abs=2e-3)


def test_a_plug_that_is_pulled_ends_the_rehearsal_with_a_line():
    with SimulatedGrbl(time.monotonic, restarts=False) as controller:
        process = started(controller, silence=2.0)
        controller.unplug()
        out, err = process.communicate(timeout=120)
        assert "Traceback" not in out + err
        assert process.returncode == 1, err
        assert f"error: the line to the controller at {controller.port} is broken: " in err


def test_ctrl_c_stops_the_pusher():
    with SimulatedGrbl(time.monotonic, restarts=False) as controller:
        process = started(controller)
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
def test_wrong_input_is_one_line(slide, call, arguments, error):
    with SimulatedGrbl(time.monotonic, restarts=False) as controller:
        said = call("rehearse", "--port", controller.port, *arguments)
        assert said.stderr == f"error: {error}\n"
        assert said.returncode == 2
        assert controller.position() == 0.0


def test_a_pusher_that_does_not_stand_at_zero_is_left_there(call):
    """A cell of the rehearsal would bring it back to 0, behind where the user said that it may move."""
    with (
        SimulatedGrbl(time.monotonic, restarts=False) as controller,
        contextlib.closing(SerialPusher(SerialSettings(controller.port, silence=PATIENT), Grbl())) as driver,
    ):
        driver.connect()
        drive(driver)
        driver.move_to(0.01, 0.05)
        drive(driver)
        driver.close()
        said = call("rehearse", "--port", controller.port, "--stroke", 0.04, "--silence", PATIENT)
        assert said.stderr == ("error: the controller stands at 10.000 mm, expected 0: bring it there, or set its work zero\n")
        assert said.returncode == 1
        assert controller.position() == 0.01


def test_a_controller_in_alarm_is_left_alone(call):
    with SimulatedGrbl(time.monotonic, restarts=False) as controller:
        controller.alarm(3)
        said = call("rehearse", "--port", controller.port, "--stroke", 0.06)
        assert "the controller is alarm: expected one that rests, unlocked and homed" in said.stderr
        assert said.returncode == 1
        assert controller._state == "Alarm"
