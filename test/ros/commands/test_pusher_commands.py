"""What a person at the pusher of a running cell can do with the commands stop, reset, status, echo and jog."""

import os
import pty
import re
import select
import signal
import subprocess
import sys
import termios
import time

import pytest
from calls import PROGRAM, invoked, wait_until
from composition import made
from stage import STAGE

from pushfric_core.simulated.grbl_firmware import SimulatedGrbl
from pushfric_msgs.msg import PusherState
from pushfric_ros.commands.watch import Keys
from pushfric_ros.node_kit.person import NoAnswer, Person, line
from pushfric_ros.node_kit.qos import RELIABLE
from pushfric_ros.nodes.actuator import ActuatorNode


def test_a_person_jogs_stops_and_resets(ros):
    with SimulatedGrbl(time.monotonic) as controller, Person("/person_cell") as person:
        ros.compose(made(ActuatorNode, "/person_cell", port=controller.port, **STAGE))

        def wait_for_idle() -> PusherState:
            wait_until(lambda: person.state(new=True).mode == PusherState.MODE_IDLE, "an idle pusher", 60.0)
            return person.state()

        wait_for_idle()
        assert re.fullmatch(r"reached(, unevenly: .*)?: 10.000 mm", person.jog(0.010, 0.05))
        assert controller.position() == pytest.approx(0.010)
        assert line(wait_for_idle()) == "idle at 10.000 mm, 0.00 mm/s"
        person.say_stop()
        assert person.call("actuator/stop") == "stopped: nothing moves until a reset"
        with pytest.raises(NoAnswer, match=r"refuses: the pusher must be idle, it is hold: .* nothing moves until a reset"):
            person.jog(0.010, 0.05)
        assert person.call("actuator/reset") == "released"
        assert person.health()["fault"] in ("none", "stopped")
        wait_for_idle()
        with pytest.raises(NoAnswer, match=r"the actuator refuses: it would end at .* beyond the stroke of"):
            person.jog(5.0, 0.05)
        assert re.fullmatch(r"reached(, unevenly: .*)?: -10.000 mm", person.jog(-0.010, 0.05))


def test_without_a_cell_a_person_is_told_so(monkeypatch):
    monkeypatch.setattr("pushfric_ros.node_kit.person.ANSWER_TIMEOUT", 0.2)
    with Person("/nobody") as person, pytest.raises(NoAnswer) as refused:
        person.call("actuator/stop")
    assert re.match(r"no service /nobody/actuator/stop; (no cell runs|running) on this machine", str(refused.value))
    assert "no pusher_state comes" in str(invoked("status", "--namespace", "nobody").exception)
    assert "like /cell or /hall/cell_2, got '/no body'" in str(invoked("status", "--namespace", "no body").exception)


def test_keys_reach_a_process_that_was_stopped_and_went_on(monkeypatch):
    ours, theirs = pty.openpty()
    with os.fdopen(ours, "wb", 0) as keyboard, os.fdopen(theirs) as terminal, monkeypatch.context() as patch:
        patch.setattr(sys, "stdin", terminal)
        line_by_line = termios.tcgetattr(terminal)
        with Keys() as keys:
            for before in (keys, None):
                if before is None:
                    termios.tcsetattr(terminal, termios.TCSANOW, line_by_line)  # as a shell does
                    assert keys.pressed() == ""
                keyboard.write(b" ")
                assert select.select([terminal], [], [], 10)[0]
                assert keys.pressed() == " "
        assert termios.tcgetattr(terminal) == line_by_line


def test_a_jog_that_is_interrupted_ends(ros):
    with SimulatedGrbl(time.monotonic) as controller:
        ros.compose(made(ActuatorNode, "/person_cell", port=controller.port, **STAGE | {"owner_timeout": 60.0}))
        state = ros.heard(ros.node("peer", namespace="/person_cell"), PusherState, "pusher_state", RELIABLE)
        ros.wait_for(lambda: state and state[-1].mode == PusherState.MODE_IDLE, what="the pusher")
        with subprocess.Popen([*PROGRAM, "jog", "0.05", "--speed", "0.001", "--namespace", "/person_cell"]) as jog:
            ros.wait_for(lambda: state[-1].position > 1e-4, what="the jog")
            jog.send_signal(signal.SIGINT)
            ros.wait_for(lambda: jog.poll() is not None, what="its end")
        assert jog.returncode == 130
        ros.wait_for(lambda: state[-1].mode == PusherState.MODE_IDLE, what="the pusher at rest")
        assert state[-1].position < 0.04
