"""The live view in a browser, on a simulated cell of real processes; one run for all tests that need one, in order."""

import contextlib
import dataclasses
import math
import os
import pathlib
import re
import signal
import subprocess
import threading
import time

import cv2
import numpy as np
import pytest
from axe import AXE, WATCH_SHIFTS, restless, violations
from calls import PROGRAM, killed_at_the_end, pushfric
from composition import made
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped, Vector3
from playwright.sync_api import Browser, Page, expect
from std_msgs.msg import String

from pushfric_core.bags.samples import pose_from_msg
from pushfric_core.cell.node_settings import PlanConfig, SimulationConfig, ViewConfig
from pushfric_core.files.object_file import load_object
from pushfric_core.geometry.planar import TABLE, Pose
from pushfric_core.vision.camera import Camera, Lens, save_camera
from pushfric_msgs.msg import FrictionEstimate, ObjectChange, Observation, PlanProgress, PusherState, Reason, RejectedPush
from pushfric_msgs.srv import SelectPush
from pushfric_ros.commands.demo import demo_cell
from pushfric_ros.graph import graph
from pushfric_ros.graph.supervisor import Supervisor
from pushfric_ros.messages.conversions import pose_to_msg
from pushfric_ros.node_kit.qos import LATCHED, RELIABLE, SENSOR_DATA
from pushfric_ros.nodes.view import ViewNode

PATIENCE = 120.0  # [s]
OBJECT = "wood_rect4"
STROKE = 0.05  # of each push [m]
PUSHES = 80
"""More pushes than the tests take."""


SCREEN = {"width": 1200, "height": 1270}

expect.set_options(timeout=PATIENCE * 1e3)


@contextlib.contextmanager
def visit(browser: Browser, url: str, **kwargs):
    """A page of a new visitor, on which nothing fails, and nothing moves that was not asked to."""
    context = browser.new_context(**kwargs)
    context.add_init_script(WATCH_SHIFTS)
    page = context.new_page()
    failures: list[str] = []
    page.on("pageerror", lambda error: failures.append(str(error)))
    # an image in the page's own memory may be given up for the next one, and a run may end before its last picture is fetched
    given_up = re.compile("^blob:|/picture/")
    page.on("requestfailed", lambda request: failures.extend([request.url] * (not given_up.search(request.url))))
    page.on("request", lambda request: failures.extend([request.url] * (not request.url.startswith((url, "blob:")))))
    page.goto(url)
    yield page
    moved = restless(page)
    context.close()
    assert failures == []
    assert moved == []


def seen(push: int, second: int = 0) -> Observation:
    """An observation of a push."""
    observation = Observation(push_id=push, contact_normal=Vector3(y=-1.0))
    observation.twist.linear.y, observation.header.stamp.sec = 0.02, second
    return observation


def test_a_simulated_object_is_laid_by_pointer_and_keys(browser, ros):
    """A cell that lays it 30 mm beside its place, as placement_error does, can be helped from the page alone."""
    cell = ros.node("simulated_cell", namespace="/laid")
    poses = cell.create_publisher(PoseWithCovarianceStamped, "object_pose", SENSOR_DATA)
    health = cell.create_publisher(DiagnosticArray, "/diagnostics", RELIABLE)
    plan = cell.create_publisher(PlanProgress, "plan_progress", LATCHED)
    where = [PoseStamped()]
    cell.create_subscription(PoseStamped, "hand", where.append, RELIABLE)
    wanted = Pose(0.03, 0.04, 0.5)
    plan.publish(PlanProgress(phase=PlanProgress.PHASE_PLACING, count=1, placement=pose_to_msg(wanted), message="place it"))

    def show() -> None:
        msg = PoseWithCovarianceStamped()
        msg.header.frame_id, msg.pose.pose = TABLE, where[-1].pose
        poses.publish(msg)
        health.publish(DiagnosticArray(status=[DiagnosticStatus(name="/laid/simulated_cell")]))

    cell.create_timer(0.05, show)
    view = ros.compose(made(ViewNode, "/laid", object=OBJECT))
    with visit(browser, view.url) as page:
        place, map_ = page.locator("#place"), page.locator("#map")
        expect(place).to_contain_text("50 mm, turn ↺ 29° to go")
        expect(page.locator("#hand")).to_contain_text("Drag the object")

        def middle(of: str) -> tuple[float, float]:
            """Where something is on the screen."""
            box = f"document.querySelector('#map {of}').getBoundingClientRect()"
            return tuple(page.evaluate(f"(() => {{ const b = {box}; return [b.x + b.width / 2, b.y + b.height / 2]; }})()"))

        def drag(what: str, to: tuple[float, float]) -> None:
            page.mouse.move(*middle(what))
            page.mouse.down()
            page.mouse.move(*to, steps=3)
            page.mouse.up()
            # in its new size
            page.evaluate("new Promise((drawn) => requestAnimationFrame(() => requestAnimationFrame(drawn)))")

        drag(".outline", middle(".ghost"))
        expect(place).to_have_text(re.compile(r"outline: [0-2] mm, turn ↺ 29° to go"))
        u, v = middle(".ghost")
        drag(".handle", (u + 100 * math.cos(wanted.theta), v - 100 * math.sin(wanted.theta)))
        expect(place).to_have_text(re.compile(r"outline: [0-2] mm(, turn . [0-5]°)? to go"))
        x = where[-1].pose.position.x
        with page.expect_event("requestfinished", lambda request: "/lay/" in request.url):  # it frees its connection
            map_.press("ArrowRight")
        ros.wait_for(lambda: where[-1].pose.position.x == pytest.approx(x + 0.002, abs=2e-4), PATIENCE, "a key's effect")
        turn = pose_from_msg(where[-1].pose).theta
        map_.press("Shift+ArrowRight")
        ros.wait_for(lambda: pose_from_msg(where[-1].pose).theta == pytest.approx(turn - 0.05, abs=2e-3), PATIENCE, "a turn")


def test_the_game_turns_its_cards_by_what_happens_in_the_cell(browser, ros):
    """By keys alone; p_CF is hidden until it is guessed."""
    cell = ros.node("simulated_cell", namespace="/played")
    plan = cell.create_publisher(PlanProgress, "plan_progress", LATCHED)
    fault = cell.create_publisher(String, "pusher_fault", LATCHED)
    observations = cell.create_publisher(Observation, "observation", RELIABLE)
    estimates = cell.create_publisher(FrictionEstimate, "friction_estimate", LATCHED)
    health = cell.create_publisher(DiagnosticArray, "/diagnostics", RELIABLE)
    lamp = ["on"]

    def report() -> None:
        values = [KeyValue(key="lamp", value=f"the lamp is {lamp[0]}")]
        nodes = (DiagnosticStatus(name="/played/simulated_cell", values=values), DiagnosticStatus(name="/played/tracker"))
        health.publish(DiagnosticArray(status=list(nodes)))

    def turn_over(msg: String) -> None:
        assert msg.data == "lamp"
        lamp[0] = "off" if lamp[0] == "on" else "on"

    cell.create_subscription(String, "switch", turn_over, RELIABLE)
    reporting = cell.create_timer(0.1, report)
    placing, pushing, finished = PlanProgress.PHASE_PLACING, PlanProgress.PHASE_PUSHING, PlanProgress.PHASE_FINISHED

    def go_on(phase: int, completed: int = 0, **more: int) -> None:
        plan.publish(PlanProgress(phase=phase, count=7, completed=completed, push_id=completed, message="go on", **more))

    view = ros.compose(made(ViewNode, "/played", object=OBJECT, played=True))
    ros.wait_for(estimates.get_subscription_count, PATIENCE, "the view's subscription")
    with visit(browser, view.url) as page:
        card = page.locator("#card")

        def shows(title: str) -> None:
            expect(card).to_contain_text(f": {title}. ")

        go_on(placing)
        shows("Place")
        go_on(placing, in_place=True)
        shows("Push")
        go_on(placing, completed=1)
        shows("Stop")
        go_on(pushing, completed=1)
        fault.publish(String(data="stopped"))
        shows("Go on")
        fault.publish(String(data="none"))
        go_on(placing, completed=1, aborted=1)
        shows("Darkness")
        page.locator("#lamp").press("Enter")
        shows("Light")
        expect(page.locator("#lamp")).to_have_attribute("aria-pressed", "true")
        page.locator("#lamp").press("Enter")
        shows("Guess")
        observations.publish(seen(2))
        estimate = FrictionEstimate(status=FrictionEstimate.STATUS_OPTIMAL, object=OBJECT)
        estimate.center_of_friction.x, estimate.spread.center_of_friction.x = 0.007, math.nan
        estimates.publish(estimate)
        expect(page.locator("#drawing .center")).to_have_count(1)
        expect(page.locator("#drawing .center")).to_be_hidden()
        expect(page.locator("#guess")).to_be_hidden()
        go_on(placing, completed=3, aborted=1)
        expect(page.locator("#guess")).to_be_visible()
        expect(page.locator("#guess")).to_be_disabled()
        for _ in range(4):
            page.locator("#drawing").press("ArrowRight")
        page.locator("#guess").press("Enter")
        shows("Cheat")
        expect(card).to_contain_text("You guessed p_CF 3.0 mm from where pushfric says")
        expect(page.locator("#drawing .center")).to_be_visible()
        go_on(pushing, completed=3, aborted=1)
        go_on(placing, completed=3, aborted=2)
        shows("Found")
        go_on(finished, completed=3, aborted=2)
        shows("Result")
        expect(page.locator("#seen")).to_contain_text("The object is")
        reporting.cancel()  # the nodes of a run that is over end, which is no fault of the tracker
        expect(page.locator("#seen")).to_have_text("")
        assert violations(page) == {}


def test_a_push_that_is_left_out_says_why_and_can_be_kept(browser, ros):
    kept = []

    def keep(request, response):
        kept.append(request.push_id)
        response.success, response.message = True, "kept: 4 observations of 2 pushes are in"
        return response

    estimator = ros.node("estimator", namespace="/left_out")
    observations = estimator.create_publisher(Observation, "observation", RELIABLE)
    estimates = estimator.create_publisher(FrictionEstimate, "friction_estimate", LATCHED)
    estimator.create_service(SelectPush, "estimator/keep_push", keep)
    view = ros.compose(made(ViewNode, "/left_out", object=OBJECT))
    for out in (observations, estimates):
        ros.wait_for(out.get_subscription_count, PATIENCE, f"the view's subscription to {out.topic_name}")
    for push in (0, 1):
        observations.publish(seen(push, push + 1))
    reason = "it moves otherwise than the others say"
    left = FrictionEstimate(status=FrictionEstimate.STATUS_OPTIMAL, objective=0.004, data_points=1)
    left.rejected = [RejectedPush(push_id=1, reason=Reason(code=Reason.PUSH_CONTRADICTS, text=reason))]
    left.header.stamp.sec = 1
    left.change = ObjectChange(since_push=1)
    with visit(browser, view.url) as page:
        both = FrictionEstimate(status=FrictionEstimate.STATUS_OPTIMAL, objective=0.006, data_points=2)
        both.header.stamp.sec = 2
        for estimate, said in ((both, "3 mm"), (left, "4 mm")):
            estimates.publish(estimate)
            expect(page.locator("#line .value_text").nth(1)).to_have_text(said)  # now, also of a push that is left out
        row = page.locator('#rows tr[data-push="1"]')
        expect(row).to_contain_text(f"left out: {reason}")
        expect(page.locator("#trust")).to_contain_text("another one since push 1")
        row.get_by_role("button", name="Keep push 1").click()
        expect(page.locator("#answer")).to_have_text("Keep push 1: kept: 4 observations of 2 pushes are in")
        assert kept == [1]
        expect(page.locator('#rows tr[data-push="0"]').get_by_role("button")).to_have_text("Exclude")


def test_whoever_looks_through_moments_does_not_wait_for_news(browser, ros):
    """What is drawn of the whole run stays as it is meanwhile; of a long one, it takes longer than a frame."""
    cell = ros.node("estimator", namespace="/looked_through")
    observations = cell.create_publisher(Observation, "observation", RELIABLE)
    view = ros.compose(made(ViewNode, "/looked_through", object=OBJECT))
    ros.wait_for(observations.get_subscription_count, PATIENCE, "the view's subscription")

    for push in range(3):
        observations.publish(seen(push, push + 1))
    with visit(browser, view.url) as page:
        slider, frames = page.locator("#moment"), []
        expect(slider).to_have_js_property("max", "3")
        page.on("websocket", lambda socket: socket.on("framereceived", lambda frame: frames.append(frame)))
        page.reload()
        expect(slider).to_have_js_property("max", "3")
        page.evaluate("""() => {
          const slider = document.getElementById("moment");
          window.looks = true;
          window.before = document.getElementById("line").firstElementChild;
          const look = () => {
            slider.value = Number(slider.value) === 1 ? 2 : 1;
            slider.dispatchEvent(new Event("input"));
            if (window.looks) requestAnimationFrame(look);
          };
          look();
        }""")
        observations.publish(seen(3, 4))
        ros.wait_for(lambda: page.evaluate("0") or any("moment/3" in str(frame) for frame in frames), PATIENCE, "the news")
        page.evaluate("new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))")
        assert page.evaluate("window.before === document.getElementById('line').firstElementChild")
        page.evaluate("window.looks = false")
        expect(slider).to_have_js_property("max", "4")


@pytest.fixture
def table(tmp_path) -> Camera:
    """A tilted camera over an empty table; its picture is in a folder."""
    lens = Lens(640, 480, np.array(((560.0, 0, 330), (0, 560, 236), (0, 0, 1))), np.array((-0.2, 0.08, 0.001, -0.0005, 0)))
    turn = cv2.Rodrigues(np.array((0.25, -0.1, 0.0)))[0] @ np.diag((1.0, -1, -1))
    shift = np.array((0, 0, 0.6)) - turn @ (0.2, 0.15, 0)
    (tmp_path / "pictures").mkdir()
    cv2.imwrite(str(tmp_path / "pictures/table.png"), np.full((480, 640), 60, np.uint8))
    return lens.over(lens.K @ np.column_stack((turn[:, :2], shift)))


@contextlib.contextmanager
def edited(folder: pathlib.Path, *options: str):
    """A command `edit` of block.yaml in a folder, and the address of its page."""
    command = [*PROGRAM, "edit", "block.yaml", "--port", "0", *options]
    with killed_at_the_end(command, stderr=subprocess.PIPE, text=True, cwd=folder) as editor:
        yield editor, editor.stderr.readline().split()[1]


def test_an_object_is_drawn_by_keys_alone(browser, tmp_path):
    """A rectangle of 80 x 60 mm on two feet, on an empty sheet."""
    with edited(tmp_path) as (editor, url):
        with visit(browser, url) as page:
            sheet, prompt, save = page.locator("#picture"), page.locator("#prompt"), page.locator("#save")
            expect(prompt).to_have_text("Draw the outline: 3 or more corners")
            for keys in (["ArrowLeft"] * 4 + ["ArrowDown"] * 3, ["ArrowRight"] * 4 + ["ArrowDown"] * 3, ["ArrowUp"] * 3):
                sheet.press("Enter")
                for key in keys:
                    sheet.press(f"Shift+{key}")
            expect(sheet).to_have_attribute("aria-label", "The object from above, Corner 2 at x 0 mm, y 30 mm")
            sheet.press("Enter")  # in the middle of the edge after this corner
            expect(page.locator("#x")).to_have_value("-20")
            page.locator("#x").fill("40")
            page.locator("#y").fill("30")
            expect(page.locator("#trust")).to_contain_text(
                "the outline must be a simple polygon with an area: Self-intersection"
            )
            expect(save).to_be_disabled()
            sheet.press("PageUp")
            page.locator("#x").fill("-40")
            expect(page.locator("#trust")).to_contain_text("Self-intersection")
            for x in ("40", "-40"):  # the two change places
                page.locator("#x").fill(x)
                sheet.press("PageDown")
            expect(save).to_be_enabled()
            expect(page.locator("#trust")).to_have_text("4 corners, 36 support points")
            page.get_by_label("at the points drawn").press("Space")
            expect(prompt).to_have_text("Draw the points where it touches the table")
            expect(save).to_be_disabled()
            for key in ("ArrowLeft", "ArrowRight"):
                sheet.press("Enter")
                sheet.press(f"Shift+{key}")
            expect(page.locator("#trust")).to_have_text("4 corners, 2 support points")
            expect(page.locator("body")).to_have_attribute("aria-busy", "false")
            page.reload()
            expect(page.locator("#trust")).to_have_text("4 corners, 2 support points")
            save.press("Enter")
            expect(prompt).to_have_text("Saved")
        assert editor.wait(PATIENCE) == 0
        assert editor.stderr.read() == "wrote block.yaml: 80.0 x 60.0 mm, 4 corners, 2 support points\n"
    model = load_object(str(tmp_path / "block.yaml"))
    assert sorted(model.outline.vertices.tolist()) == [[-0.04, -0.03], [-0.04, 0.03], [0.04, -0.03], [0.04, 0.03]]
    assert model.support_points.tolist() == [[-0.01, 0.0], [0.01, 0.0]]


def test_a_corner_is_dragged_over_a_picture(browser, tmp_path, table):
    """On a screen; and people can read and use the page on a phone, too."""
    corners = [[-0.05, -0.05], [0.05, -0.05], [0.05, 0.05], [-0.05, 0.05]]
    (tmp_path / "block.yaml").write_text(f"name: block\noutline: {corners}\nsupport: {{points: {corners}}}\n")
    save_camera(table, tmp_path / "camera.yaml")
    with edited(tmp_path, "--picture", "pictures", "--camera", "camera.yaml") as (editor, url):
        for width, scheme in ((360, "dark"), (1280, "light")):
            with visit(browser, url, viewport={"width": width, "height": 900}, color_scheme=scheme) as page:
                expect(page.locator("#picture image")).to_have_count(1)
                assert page.evaluate("document.documentElement.scrollWidth") == width
                assert violations(page) == {}
                if width < 1000:
                    continue
                box = page.locator("#picture").bounding_box()
                scale = box["width"] / 160  # px per mm: the sheet shows 160 mm
                page.mouse.move(box["x"] + 130 * scale, box["y"] + 30 * scale)
                page.mouse.down()
                page.mouse.move(box["x"] + 140 * scale, box["y"] + 20 * scale, steps=3)
                page.mouse.up()
                expect(page.locator("#rows tr")).to_have_count(4)
                expect(page.locator("#x")).to_have_value(re.compile(r"^(59\.|60)"))
                page.locator("#x").fill("60")
                page.locator("#y").fill("60")
                page.get_by_label("support points", exact=True).check()
                page.locator("#rows button").first.click()
                expect(page.locator("#trust")).to_have_text("4 corners, 3 support points")
                page.locator("#save").click()
                expect(page.locator("#prompt")).to_have_text("Saved")
        assert editor.wait(PATIENCE) == 0
    model = load_object(str(tmp_path / "block.yaml"))
    assert model.outline.vertices.tolist() == [*corners[:2], [0.06, 0.06], corners[3]]
    assert model.support_points.tolist() == corners[1:]


def test_a_scan_gives_the_outline(browser, tmp_path):
    """It is proposed, spoilt, found again and saved."""
    scan = np.full((300, 400), 245, np.uint8)
    scan[80:240, 80:320] = 60
    cv2.imwrite(str(tmp_path / "scan.png"), cv2.GaussianBlur(scan, (0, 0), 1.0))
    with edited(tmp_path, "--picture", "scan.png", "--width", "0.2") as (editor, url):
        with visit(browser, url, viewport=SCREEN) as page:
            expect(page.locator("#trust")).to_have_text(re.compile("^4 corners"))
            page.locator("#rows button").first.click()
            expect(page.locator("#trust")).to_have_text(re.compile("^3 corners"))
            page.locator("#find").click()
            expect(page.locator("#trust")).to_have_text(re.compile("^4 corners"))
            with visit(browser, url) as other:
                other.locator("#rows button").first.click()
                expect(other.locator("#trust")).to_have_text(re.compile("^3 corners"))
            page.locator("#save").click()  # saves what it shows
            expect(page.locator("#prompt")).to_have_text("Saved")
        assert editor.wait(PATIENCE) == 0
    size = load_object(str(tmp_path / "block.yaml")).outline.size
    np.testing.assert_allclose(size, (0.12, 0.08), atol=1e-3)


@pytest.fixture(scope="module")
def recorded(tmp_path_factory) -> str:
    """Address of the page of a recorded run."""
    file = tmp_path_factory.mktemp("recorded") / "page.html"
    assert pushfric("report", pathlib.Path(__file__).parents[2] / "bags/rubber_rect4", "--html", file).returncode == 0
    return file.as_uri()


TOO_NARROW = """[...document.querySelectorAll("section.wide td")]
  .filter(cell => cell.scrollWidth > cell.clientWidth + 1).map(cell => cell.textContent)"""
"""The cells that their text does not fit in, so that it lies over the next one's."""


@pytest.mark.parametrize("width", [1280, 360])
@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_the_same_page_shows_a_run_that_is_over(browser, recorded, scheme, width):
    """In one file, by keys alone."""
    with visit(browser, recorded, viewport={"width": width, "height": 800}, color_scheme=scheme) as page:
        expect(page.locator("#moment_name")).to_have_text(re.compile(r"^push 14, observation (\d) of \1, "))
        expect(page.locator("#stop")).to_be_hidden()
        expect(page.locator("#trust")).to_contain_text("may be used")
        expect(page.locator("#mu")).to_have_text("≥ 0.718")  # as estimate says in the tutorial
        page.locator("#moment").press("PageUp")
        page.locator("#compare").press("Enter")
        for _ in range(4):
            page.locator("#moment").press("PageUp")
        expect(page.locator("#pinned_name")).to_have_text(re.compile("^push 13, "))
        expect(page.locator("#shown_name")).to_have_text(re.compile("^push 9, "))
        expect(page.locator("#drawing .weight.pinned")).not_to_have_count(0)
        expect(page.locator("#prediction_drawing .predicted")).to_have_count(1)
        assert page.evaluate("document.documentElement.scrollWidth") == width
        assert page.evaluate(TOO_NARROW) == []
        assert violations(page) == {}


def test_a_report_of_few_data_is_legible_and_does_not_look_usable(browser, tmp_path):
    heads = "contact_x,contact_y,normal_x,normal_y,vx,vy,omega,push_id"
    (tmp_path / "data.csv").write_text(f"{heads}\n0.01,-0.032,0,-1,0,0.02,0.1,1\n")
    pushfric("report", "data.csv", "--object", "rubber_rect4", "--html", "page.html", cwd=tmp_path)  # ends with 1: not usable
    with visit(browser, (tmp_path / "page.html").as_uri()) as page:
        expect(page.locator("#now")).to_have_class("finished unusable")
        left = page.locator("#friction_chart").bounding_box()["x"]
        assert all(one.bounding_box()["x"] > left for one in page.locator("#friction_chart .strong").all())


def test_a_line_whose_width_changes_while_a_moment_is_chosen_is_drawn_again(browser, recorded):
    with contextlib.closing(browser.new_page()) as page:
        page.goto(recorded)
        expect(page.locator("#line .curve")).not_to_have_count(0)
        page.evaluate("""window.before = document.getElementById("line").firstElementChild; document.body.style.width = "700px";
          document.getElementById("moment").dispatchEvent(new Event("input")); window.dispatchEvent(new Event("resize"));""")
        page.wait_for_function("window.before !== document.getElementById('line').firstElementChild")


def test_a_report_prints_on_two_sheets(browser, recorded):
    """Also from dark colours; all of it is text and lines, none of it a picture."""
    with contextlib.closing(browser.new_page(color_scheme="dark")) as page:  # on paper, everything moves
        page.goto(recorded)
        expect(page.locator("#line .curve")).not_to_have_count(0)
        printed = page.pdf(prefer_css_page_size=True)
        assert len(re.findall(rb"/Type /Page\b", printed)) == 2
        assert b"/Subtype /Image" not in printed
        page.emulate_media(media="print")
        assert page.evaluate("getComputedStyle(document.documentElement).getPropertyValue('--card')") == "#ffffff"
        for part in ("#plane", "#friction", "#time", "#predictions", "#table", "#settings", "#trust"):
            expect(page.locator(part)).to_be_visible()


COUNT_TONES = """() => {
  window.tones = 0;
  const start = OscillatorNode.prototype.start;
  OscillatorNode.prototype.start = function (...when) { window.tones += 1; return start.apply(this, when); };
}"""


@contextlib.contextmanager
def slow_run(folder: pathlib.Path, **changes):
    """The address of a run with a view, and its processes: slow pushes, so that one can be stopped on its way."""
    pushes = ("{edge: 0, offset: 0.03}", "{edge: 2, offset: -0.02}")
    (folder / "plan.yaml").write_text(f"pushes: [{', '.join(pushes * (PUSHES // 2))}]")
    plan = PlanConfig(str(folder / "plan.yaml"), distance=STROKE, speed=0.01)
    cell = dataclasses.replace(demo_cell(OBJECT, folder), plan=plan, **changes)
    specs = graph.simulated_cell(cell, str(folder / "bag"), seed=1, speed=1.0)
    said, served = [], threading.Event()

    def say(name: str, line: str) -> None:
        print(f"{name}: {line}")  # pytest shows it if a test fails
        said.append((name, line))
        if name == "view" and line.startswith("http"):  # the middleware may have something to say, too
            served.set()

    over = threading.Event()

    def supervise() -> None:
        while not over.wait(0.05):
            ended = supervisor.poll()
            if ended is not None:
                print(ended)
                return

    with Supervisor(graph.with_view(specs, OBJECT, ViewConfig()), graph.NAMESPACE, say) as supervisor:
        thread = threading.Thread(target=supervise)
        thread.start()
        try:
            assert served.wait(PATIENCE), said
            (url,) = [line for name, line in said if name == "view" and line.startswith("http")]
            assert url.startswith("http://127.0.0.1:")
            yield url, supervisor
        finally:
            over.set()
            thread.join()


def test_an_emergency_stop_at_rest_is_the_prompt_at_once_and_the_run_goes_on_after_it(browser, tmp_path):
    aside = SimulationConfig(placement_error=0.03)  # the cell waits for somebody who lays the object right
    sizes = ({"width": 1280, "height": 800}, {"width": 360, "height": 740})
    with slow_run(tmp_path, simulation=aside) as (url, _), contextlib.ExitStack() as visits:
        pages = [visits.enter_context(visit(browser, url, viewport=size)) for size in sizes]
        for page in pages:
            expect(page.locator("#prompt")).to_contain_text(f"Push 1 of {PUSHES}: place the object at")
            switch, prompt = page.locator("#emergency_stop"), page.locator("#prompt")
            switch.click()
            for one in pages:
                expect(one.locator("#prompt")).to_contain_text("The emergency stop is pressed: release it")
                expect(one.locator("#reset")).to_be_enabled()
            switch.click()
            expect(prompt).to_contain_text("press Reset")
            page.locator("#reset").click()
            expect(prompt).to_contain_text(f"Push 1 of {PUSHES}: place the object at")


@pytest.fixture(scope="module")
def running(browser, tmp_path_factory):
    with slow_run(tmp_path_factory.mktemp("cell")) as run:
        yield run


@pytest.fixture(scope="module")
def url(running) -> str:
    """Where the run is shown."""
    return running[0]


def first_row(page: Page) -> list[str]:
    """The table's line of the first push, once an observation of the second has come: from then on it stays as it is."""
    expect(page.locator('#rows tr[data-push="1"] td').nth(1)).to_have_text(re.compile("^[1-9]"))
    return page.locator("#rows tr").first.locator("td").all_text_contents()  # of rows out of sight, too


def test_the_page_shows_the_run(browser, url):
    with visit(browser, url) as page:
        expect(page.locator("#object")).to_have_text(OBJECT)
        expect(page.locator("#prompt")).to_contain_text(f"of {PUSHES}")
        expect(page.locator("#points")).to_contain_text("observation")
        expect(page.locator("#center")).to_contain_text("mm")
        expect(page.locator("#overlay")).to_be_visible()
        expect(page.locator("#overlay")).to_have_js_property("naturalWidth", 640)
        expect(page.locator("#drawing .weight")).not_to_have_count(0)
        expect(page.locator("#drawing .tip")).to_have_count(1)
        for node in ("tracker", "actuator", "estimator", "experiment", "recorder", "view"):
            expect(page.locator(f'#nodes [data-node="node/{node}"]')).to_have_count(1)


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_a_phone_shows_it_without_scrolling_sideways(browser, url, scheme):
    with visit(browser, url, viewport={"width": 360, "height": 740}, color_scheme=scheme, is_mobile=True) as page:
        first_row(page)
        assert page.evaluate("[document.documentElement.scrollWidth, window.innerWidth]") == [360, 360]
        expect(page.locator("#stop")).to_be_in_viewport()


@pytest.mark.parametrize("width", [1280, 360])
@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_nothing_keeps_people_from_reading_and_using_the_page(browser, url, scheme, width):
    """Contrast, names and roles, by the rules of axe-core."""
    if not AXE.exists():
        pytest.skip("no axe-core: npm install --no-package-lock --prefix test brings it")
    with visit(browser, url, viewport={"width": width, "height": 800}, color_scheme=scheme) as page:
        first_row(page)
        page.locator("#nodes details").first.evaluate("details => { details.open = true; }")
        assert violations(page) == {}


def test_any_moment_is_looked_back_at_and_compared_by_keys(browser, url):
    with visit(browser, url) as page:
        first = first_row(page)
        expect(page.locator('#rows tr[data-push="1"] td').nth(2)).to_have_text(re.compile("[0-9]"))
        slider, name = page.locator("#moment"), page.locator("#moment_name")
        expect(name).to_have_text("now")
        slider.press("Home")
        expect(name).to_have_text(re.compile(f"^push 1, observation 1 of {first[1]}, "))
        expect(page.locator("#prediction_caption")).to_contain_text("Nothing was predicted")
        expect(page.locator("#drawing .tip")).to_have_count(0)
        page.locator("#compare").press("Enter")
        slider.press("PageDown")
        expect(name).to_have_text(re.compile(f"^push 1, observation {first[1]} of {first[1]}, "))
        expect(slider).to_have_attribute("aria-valuetext", name.inner_text())
        expect(page.locator("#center")).to_contain_text(f"{first[2]}, {first[3]}")
        expect(page.locator("#pushes")).to_have_text("of 1 push")
        expect(page.locator("#drawing .weight")).not_to_have_count(0)
        expect(page.locator("#shown_name")).to_have_text(f"push 1, {first[1]} of {first[1]}")
        expect(page.locator("#comparison tbody tr").first.locator("td").nth(1)).to_have_text(first[2])
        slider.press("ArrowRight")
        expect(name).to_have_text(re.compile("^push 2, observation 1 of "))
        expect(page.locator("#prediction_caption")).to_contain_text("° off")
        expect(page.locator("#overlay")).to_have_js_property("naturalWidth", 640)
        expect(page.locator("#seen")).to_have_text(re.compile(r"^Taken \d+\.\d s (before|after) this moment"))
        page.locator("#compare").press("Enter")
        expect(page.locator("#comparison")).to_be_hidden()
        page.locator("#to_now").press("Enter")
        expect(name).to_have_text("now")
        expect(page.locator("#drawing .tip")).to_have_count(1)


def begins(state: PusherState) -> bool:
    """Whether a push has begun to move, and most of its way is ahead."""
    return state.push_id != PusherState.NO_PUSH and 0.002 < state.position < STROKE / 4


def test_a_click_stops_a_push(browser, url, ros):
    states = ros.heard(ros.node("onlooker", namespace=graph.NAMESPACE), PusherState, "pusher_state", RELIABLE)
    with visit(browser, url) as page:
        page.evaluate(COUNT_TONES)
        page.locator("#sound").press("Enter")
        expect(page.locator("#sound")).to_have_attribute("aria-pressed", "true")
        page.wait_for_function("window.tones > 0")
        expect(page.locator("#stop")).to_be_enabled()
        ros.wait_for(lambda: states and begins(states[-1]), PATIENCE, "a push")
        pushed = states[-1].push_id
        page.evaluate("window.tones = 0")
        page.locator("#stop").click()
        ros.wait_for(lambda: states[-1].mode == PusherState.MODE_HOLD and states[-1].speed == 0, PATIENCE, "rest")
        expect(page.locator("#answer")).to_contain_text("nothing moves until")
        expect(page.locator("#prompt")).to_contain_text("press Reset")
        page.wait_for_function("window.tones > 0")
        at_rest = states[-1].position
        assert 0 < at_rest < STROKE
        expect(page.locator(f'#rows tr[data-push="{pushed}"]')).to_contain_text("aborted")
        count = len(states)
        ros.wait_for(lambda: len(states) > count + 20, PATIENCE, "more states")
        assert {state.position for state in states[count:]} == {at_rest}
        page.locator("#reset").click()
        expect(page.locator("#answer")).to_contain_text("Released")
        expect(page.locator("#prompt")).to_contain_text("Repeat it, skip it, or end the run?")
        expect(page.locator("#details")).to_contain_text("experiment/repeat")
        page.locator("#repeat").click()
        expect(page.locator("#answer")).to_contain_text("is repeated")
        ros.wait_for(lambda: states[-1].push_id == pushed + PUSHES, PATIENCE, "the same push again")
        expect(page.locator(f'#rows tr[data-push="{pushed + PUSHES}"]')).to_contain_text(f"{pushed + 1} (again)")
        expect(page.locator(f'#rows tr[data-push="{pushed + PUSHES}"] + tr')).to_have_attribute("data-push", f"{pushed + 1}")


def test_the_space_bar_stops_a_push_that_the_page_has_lost_sight_of(browser, url, ros):
    """Its connection was cut before the push, and another button has the focus."""
    states = ros.heard(ros.node("onlooker", namespace=graph.NAMESPACE), PusherState, "pusher_state", RELIABLE)
    page, sockets = browser.new_page(), []
    page.route_web_socket("**/live*", lambda socket: sockets.append((socket, len(sockets) == 0 and socket.connect_to_server())))
    page.goto(url)
    expect(page.locator("#stop")).to_be_enabled()
    expect(page.locator("#prompt")).to_have_attribute("role", "status")
    expect(page.locator("#skip")).to_be_enabled()
    page.locator("#skip").focus()
    expect(page.locator("#skip")).to_be_focused()
    sockets[0][0].close()
    expect(page.locator("#connection")).to_contain_text(re.compile(r"no connection for \d+ s"))
    expect(page.locator("#stop")).to_be_enabled()
    ros.wait_for(lambda: states and begins(states[-1]), PATIENCE, "a push")
    page.keyboard.press("Space")
    ros.wait_for(lambda: states[-1].mode == PusherState.MODE_HOLD and states[-1].speed == 0, PATIENCE, "rest")
    expect(page.locator("#answer")).to_contain_text("nothing moves until")
    # all that a view knows which has just begun again
    page.route_web_socket("**/live*", lambda socket: socket.send('{"all": {"fault": "none"}}'))
    page.reload()
    expect(page.locator("#connection")).to_have_text("")
    expect(page.locator("#stop")).to_be_enabled()
    page.close()
    with visit(browser, url) as other:
        other.locator("#reset").click()
        expect(other.locator("#answer")).to_contain_text("Released")
        expect(other.locator("#skip")).to_be_enabled()
        expect(other.locator("#prompt")).to_contain_text("Repeat it")
        other.locator("#skip").press("Enter")
        expect(other.locator("#count")).to_have_text(re.compile(rf"^\d+ of {PUSHES} pushes done, .*skipped$"))


def test_a_push_is_excluded_and_another_given_up(browser, url):
    with visit(browser, url) as page, visit(browser, url) as other:
        page.locator("#rows tr").first.get_by_role("button").click()
        for one in (page, other):
            expect(one.locator("#rows tr").first).to_contain_text("excluded")
            expect(one.locator("#rows tr").first.get_by_role("button")).to_have_text("Keep")
        expect(page.locator("#answer")).to_have_text(re.compile("^Exclude push 1: .* observations"))
        deadline = time.monotonic() + PATIENCE
        while "is skipped" not in page.locator("#answer").inner_text():  # between two pushes there is no push to give up
            assert time.monotonic() < deadline
            expect(page.locator("#prompt")).to_contain_text(re.compile(f"^Push .* of {PUSHES}"))
            with page.expect_response("**/skip"):
                page.locator("#skip").click()


def test_a_page_left_open_begins_afresh_with_the_next_run(browser, url):
    page, sockets = browser.new_page(), []
    said = '{"all": {"doubts": ["of run 1"], "files": {}, "tables": {}, "made": ""}}', '{"all": {"fault": "none"}}'
    page.route_web_socket("**/live*", lambda socket: sockets.append(socket) or socket.send(said[len(sockets) > 1]))
    page.goto(url)
    expect(page.locator("#doubts")).to_have_text("✗ of run 1")
    sockets[0].close(code=1001)
    expect(page.locator("#doubts")).to_have_text("")
    page.route("**/stop", lambda route: route.fulfill(json={"done": True, "message": ""}))
    page.locator("#stop").click()
    expect(page.locator("#answer")).to_have_text("Stop: done")
    page.close()


OF_NOW = {
    ("tracker", "actuator", "experiment", "estimator", "recorder"): (
        "#seen, #place, #map .way, #map .outline, #drawing .tip, #map .tip, #map .ghost, #trust"
    ),
    ("simulated_cell",): "#seen, #place, #map .way, #map .outline",
    ("view",): "#seen, #place, #trust, #map .way, #map .outline, #drawing .tip, #map .tip",
}
"""What nodes say of the present, or what is drawn from it. Each of the first says another part."""

CLAIMS = r"""(of) => [...document.querySelectorAll(of)]
  .filter(one => one instanceof SVGElement || /✓|\d mm/.test(one.textContent)).map(one => one.id || one.classList[0])"""
"""Those of them that are drawn, or hold a tick or a distance."""


@pytest.mark.parametrize("nodes", OF_NOW, ids=lambda nodes: nodes[0])
def test_nothing_that_nodes_say_is_shown_beyond_its_age(browser, running, nodes, monkeypatch):
    """Also to a visitor who comes late."""
    url, supervisor = running
    # a stopped process would be taken for hung before it goes on
    monkeypatch.setattr("pushfric_ros.graph.supervisor.STOPPED", 60.0)
    late = contextlib.nullcontext() if "view" in nodes else visit(browser, url)

    def rows(page: Page):
        return [page.locator(f'#nodes [data-node="node/{node}"]') for node in nodes]

    with visit(browser, url) as page:
        for row in rows(page):
            expect(row).not_to_have_class("stale")
        processes = [supervisor.processes[node] for node in nodes]
        for process in processes:
            os.kill(process, signal.SIGSTOP)
        try:
            for row in rows(page):
                expect(row).to_have_class("stale")
                expect(row).to_contain_text("does not report")
            page.wait_for_function(f"(of) => !({CLAIMS})(of).length", arg=OF_NOW[nodes])
            assert violations(page) == {}
            with late as other:
                if other is not None:
                    for row in rows(other):
                        expect(row).to_have_class("stale")
                    other.wait_for_function(f"(of) => !({CLAIMS})(of).length", arg=OF_NOW[nodes])
        finally:
            for process in processes:
                os.kill(process, signal.SIGCONT)
        for row in rows(page):
            expect(row).not_to_have_class("stale")
