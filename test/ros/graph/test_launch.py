"""How `ros2 launch` ends, with ROS 2's own launch and processes that stand for the nodes."""

import sys

import pytest

from pushfric_ros.graph.graph import NodeSpec

launch = pytest.importorskip("launch")
pytest.importorskip("launch_ros")
actions, handlers = launch.actions, launch.event_handlers

ENDS = "import sys; sys.exit({})"
LEADS = """
import pathlib, sys, time
while not pathlib.Path(sys.argv[1]).exists():
    time.sleep(0.01)
sys.exit({})
"""
STAYS = """
import signal, sys, time
signal.signal(signal.SIGINT, lambda *_: sys.exit({}))
open(sys.argv[1], "w").close()
time.sleep(600)
"""


@pytest.mark.parametrize(
    ("leader", "other", "respawn", "found", "code", "said"),
    [
        (LEADS.format(0), STAYS.format(0), False, (), 0, ""),
        (LEADS.format(0), STAYS.format(0), True, (), 0, ""),
        (
            ENDS.format(0),
            STAYS.format(0),
            False,
            ("2 of 14 pushes were aborted", "more"),
            1,
            "2 of 14 pushes were aborted; more",
        ),
        (LEADS.format(0), STAYS.format(1), False, ("unread",), 1, "other ended with exit code 1"),
        (LEADS.format(3), STAYS.format(0), False, ("unread",), 1, "leader ended with exit code 3"),
        (STAYS.format(0), ENDS.format(0), False, ("unread",), 1, "other ended with exit code 0"),
        (STAYS.format(0), ENDS.format(2), True, ("unread",), 1, "other ended with exit code 2"),
        (STAYS.format(0), ENDS.format(1), True, (), 1, "other ended with exit code 1, 3 times within 30 s"),
        (STAYS.format(0), "import os; os.kill(os.getpid(), 9)", False, (), 1, "other was killed by SIGKILL"),
    ],
)
def test_a_run_that_failed_ends_with_1_and_says_why(caplog, tmp_path, leader, other, respawn, found, code, said):
    from pushfric_ros.graph.launch import _Course

    def process(program, **options):
        return actions.ExecuteProcess(cmd=[sys.executable, "-c", program, str(tmp_path / "up")], output="screen", **options)

    nodes = {
        process(leader): NodeSpec("leader", ends_run=True),
        process(other, respawn=respawn, respawn_delay=0.1): NodeSpec("other", respawn=respawn),
    }
    course = _Course(nodes, lambda: found)
    service = launch.LaunchService(noninteractive=True)
    described = [*map(actions.RegisterEventHandler, course.handlers), *nodes]
    service.include_launch_description(launch.LaunchDescription(described))
    assert service.run() == code
    assert [line.rpartition("traceback): ")[2] for line in caplog.messages if "Caught exception" in line] == [said] * code
