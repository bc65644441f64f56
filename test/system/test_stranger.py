"""Somebody who knows no ROS carries out a plan in a browser: by keys, and with no more than what a screen reader is told."""

import contextlib
import copy
import pathlib
import re
import subprocess
import sys
import threading

import pytest
from axe import violations
from calls import PROGRAM
from geometry_msgs.msg import PoseStamped
from playwright.sync_api import Page, expect
from sensor_msgs.msg import Image

from pushfric_msgs.msg import PusherState
from pushfric_ros.graph import graph
from pushfric_ros.node_kit.qos import LATCHED, RELIABLE, SENSOR_DATA

PATIENCE = 120.0  # [s]
PLAN = """\
pushes:
  - {edge: 0, offset: 0.03}
  - {edge: 2, offset: -0.02}
  - {edge: 1, offset: 0.01}
  - {edge: 3, offset: -0.01}
  - {edge: 0, offset: -0.03}
"""
PUSHES = 5
STOPPED, COVERED, MISPLACED = 1, 2, 3
"""Indices of the pushes in which something happens."""

TRUE, SHOWN, LAID = "camera/image_raw", "image_raw", "laid"
"""The topic on which the camera publishes, that which the tracker receives, and where the object is laid."""

RUN = f"""
import pathlib, sys
from dataclasses import replace
from rich.console import Console
from pushfric_core.cell.node_settings import PlanConfig, ViewConfig
from pushfric_ros.commands.demo import demo_cell
from pushfric_ros.commands.watch import watch
from pushfric_ros.graph import graph

folder = pathlib.Path(sys.argv[1])
plan = PlanConfig(str(folder / "plan.yaml"), distance=0.03, speed=0.01)
specs = graph.simulated_cell(replace(demo_cell("wood_rect4", folder), plan=plan), str(folder / "bag"), seed=1, speed=1.0)
changed = {{
    "simulated_cell": lambda spec: replace(spec, remappings={{**spec.remappings, "{SHOWN}": "{TRUE}", "placement": "{LAID}"}}),
    "experiment": lambda spec: replace(spec, parameters={{**spec.parameters, "lost_object": plan.lost_object}}),
}}
specs = [changed.get(spec.name, lambda spec: spec)(spec) for spec in specs]
ended, _ = watch(
    Console(stderr=True, width=200), graph.with_view(specs, "wood_rect4", ViewConfig()), graph.NAMESPACE, "pushing", live=False,
    recorded=folder / "bag",
)
sys.exit(ended.code)
"""


class Hands:
    """What happens at the cell: the object is laid where it is asked for, once 50 mm beside; a cloth falls over the camera."""

    def __init__(self, ros) -> None:
        node = ros.node("hands", namespace=graph.NAMESPACE)
        self.cover_in: int | None = None  # index of the push in which the cloth falls
        self.covered = False
        self.misplace_in = 0  # at which placement from now the object is laid beside its place
        self.asked: PoseStamped | None = None
        self.state = PusherState(push_id=PusherState.NO_PUSH)
        self._shown = node.create_publisher(Image, SHOWN, SENSOR_DATA)
        self._laid = node.create_publisher(PoseStamped, LAID, LATCHED)
        node.create_subscription(Image, TRUE, self._on_image, SENSOR_DATA)
        node.create_subscription(PoseStamped, "placement", self._on_placement, LATCHED)
        node.create_subscription(PusherState, "pusher_state", self._on_state, RELIABLE)

    def lay(self, beside: float) -> None:
        """Lay the object where it was asked for, or beside it [m]."""
        laid = copy.deepcopy(self.asked)
        laid.pose.position.x += beside
        self._laid.publish(laid)

    def pushes(self, index: int) -> bool:
        """Whether the push with this index is under way, the first time, and moves."""
        return self.state.push_id == index and self.state.position > 0.003

    def _on_image(self, msg: Image) -> None:
        if self.covered:
            msg.data = bytes(len(msg.data))
        self._shown.publish(msg)

    def _on_placement(self, msg: PoseStamped) -> None:
        self.asked, self.misplace_in = msg, self.misplace_in - 1
        self.lay(beside=0.05 if self.misplace_in == 0 else 0.0)

    def _on_state(self, msg: PusherState) -> None:
        self.state = msg
        if self.cover_in is not None and self.pushes(self.cover_in):  # here, so that a busy machine is not too late
            self.cover_in, self.covered = None, True


@pytest.fixture
def run(tmp_path):
    """The address of a run's page, and its process."""
    (tmp_path / "plan.yaml").write_text(PLAN)
    command = [sys.executable, "-c", RUN, str(tmp_path)]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as process, contextlib.ExitStack() as end:
        end.callback(process.wait, PATIENCE)
        end.callback(process.terminate)
        url = next(line.split()[1] for line in process.stderr if line.startswith("view: http"))
        threading.Thread(target=lambda: print(process.stderr.read())).start()  # pytest shows it if the test fails
        yield url, process


def test_a_stranger_carries_out_a_plan(browser, ros, run, tmp_path):
    url, process = run
    hands = Hands(ros)
    context = browser.new_context(viewport={"width": 1280, "height": 900}, accept_downloads=True)
    page = context.new_page()
    failures: list[str] = []
    page.on("pageerror", lambda error: failures.append(str(error)))
    page.goto(url)
    status = page.get_by_role("status").filter(has_text=re.compile(f"of {PUSHES}|Repeat|Reset|pusher", re.IGNORECASE)).first
    expect.set_options(timeout=PATIENCE * 1e3)

    ros.wait_for(lambda: hands.pushes(STOPPED), PATIENCE, "the push that is stopped")
    page.keyboard.press("Space")
    expect(page.get_by_role("alert")).to_contain_text("nothing moves until")
    go_on(page, "Repeat")

    hands.cover_in = COVERED
    ros.wait_for(lambda: hands.covered, PATIENCE, "the push in which the camera is covered")
    expect(status).to_contain_text("Repeat it, skip it, or end the run?")
    expect(page.locator("#seen")).to_have_class(re.compile("problem"))
    hands.covered, hands.misplace_in = False, 2
    go_on(page, "Repeat")

    expect(status).to_contain_text(f"Push {MISPLACED + 1} of {PUSHES}: place the object at")
    expect(page.locator("#place")).to_contain_text(re.compile("Lay it onto the dashed outline: .*mm.* to go"))
    expect(status).to_contain_text(re.compile("move it by about .0 mm"))
    hands.lay(beside=0.0)
    expect(status).to_contain_text(f"Push {MISPLACED + 2} of {PUSHES}")

    expect(status).to_contain_text(f"{PUSHES} of {PUSHES} pushes done")
    save = page.get_by_role("link", name="Save the result as one page")
    expect(save).to_be_visible()
    with page.expect_download() as download:
        save.press("Enter")
    saved = pathlib.Path(download.value.path()).read_text(encoding="utf-8")
    assert saved == (tmp_path / "bag/report.html").read_text(encoding="utf-8")
    expect(page.get_by_role("heading", name="Predictions tested on the last pushes")).to_be_visible()
    expect(page.locator("#rows tr")).to_have_count(PUSHES + 2)  # two of them twice
    code = process.wait(PATIENCE)
    assert code == subprocess.call([*PROGRAM, "bag", "verify", tmp_path / "bag"]) < 2  # a busy machine loses images
    expect(page.locator("#connection")).to_contain_text("the run has ended")
    for width, scheme in ((1280, "light"), (360, "dark")):
        page.set_viewport_size({"width": width, "height": 900})
        page.emulate_media(color_scheme=scheme)
        assert page.evaluate("document.documentElement.scrollWidth") == width
        assert violations(page) == {}
    context.close()
    assert failures == []


def go_on(page: Page, choice: str) -> None:
    """Do what the page asks for after an abort, with its buttons."""
    prompt = page.locator("#prompt")
    expect(prompt).to_contain_text(re.compile("press Reset|Repeat it, skip it, or end the run"))
    while "press Reset" in prompt.inner_text():
        press(page, "Reset")
        with contextlib.suppress(AssertionError):  # then a stranger presses it again
            expect(prompt).not_to_contain_text("press Reset", timeout=10e3)
    expect(prompt).to_contain_text("Repeat it, skip it, or end the run?")
    press(page, choice)
    expect(page.get_by_role("alert")).to_contain_text("is repeated")


def press(page: Page, name: str) -> None:
    """Press a button with the keyboard once it can be pressed, which may be a moment after the prompt that names it."""
    button = page.get_by_role("button", name=name)
    expect(button).to_be_enabled()
    button.press("Enter")
