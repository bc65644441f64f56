"""The view node in a graph whose other nodes are played by the test."""

import contextlib
import json
import urllib.error
import urllib.request

import pytest
from composition import made
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from geometry_msgs.msg import Point, PoseWithCovarianceStamped, Vector3
from rclpy.serialization import serialize_message
from sensor_msgs.msg import CompressedImage
from std_msgs.msg import Empty, String
from std_srvs.srv import Trigger
from tornado.ioloop import IOLoop
from tornado.websocket import websocket_connect

from pushfric_core.errors import InvalidInput
from pushfric_core.files.estimator_settings import EstimatorSettings
from pushfric_msgs.msg import FrictionEstimate, Observation, PlanProgress, PusherState
from pushfric_msgs.srv import SelectPush
from pushfric_ros.messages.conversions import nothing_known
from pushfric_ros.node_kit.qos import LATCHED, RELIABLE, SENSOR_DATA
from pushfric_ros.nodes.view import ViewNode

PATIENCE = 60.0


class Cell:
    """The nodes around a view."""

    def __init__(self, ros, **parameters) -> None:
        self.ros = ros
        self.node = ros.node("estimator", namespace="/cell")
        publisher = self.node.create_publisher
        self.estimates = publisher(FrictionEstimate, "friction_estimate", LATCHED)
        self.observations = publisher(Observation, "observation", RELIABLE)
        self.plan = publisher(PlanProgress, "plan_progress", LATCHED)
        self.settings = publisher(String, "estimator_settings", LATCHED)
        self.images = publisher(CompressedImage, "overlay/compressed", SENSOR_DATA)
        self.poses = publisher(PoseWithCovarianceStamped, "object_pose", SENSOR_DATA)
        self.pushers = publisher(PusherState, "pusher_state", RELIABLE)
        self.health = publisher(DiagnosticArray, "/diagnostics", RELIABLE)
        self.view = ros.compose(made(ViewNode, object="rubber_rect4", port=0, **parameters))
        self.url = self.view.url
        for out in (self.estimates, self.observations, self.plan, self.settings):
            ros.wait_for(out.get_subscription_count, PATIENCE, f"the view's subscription to {out.topic_name}")

    def push(self, push: int, stamp: int, estimate_first: bool = False) -> None:
        """An observation and the estimate after it, in either order."""
        observation = Observation(push_id=push, contact_point=Point(x=0.01), contact_normal=Vector3(y=-1.0))
        estimate = FrictionEstimate(status=FrictionEstimate.STATUS_OPTIMAL, data_points=stamp, pushes=push + 1)
        estimate.contact_friction.max = float("inf")
        observation.twist.linear.y = 0.02
        for msg in (observation, estimate):
            msg.header.stamp.sec = stamp
        first, second = (self.observations, observation), (self.estimates, estimate)
        for out, msg in (second, first) if estimate_first else (first, second):
            out.publish(msg)

    def post(self, what: str, **headers: str) -> tuple[int, dict]:
        """Send a request as a page does."""
        request = urllib.request.Request(f"{self.url.partition('?')[0]}{what}", method="POST", headers=headers)
        try:
            with urllib.request.urlopen(request, timeout=PATIENCE) as answer:
                return answer.status, json.load(answer)
        except urllib.error.HTTPError as refusal:
            return refusal.code, json.load(refusal)


class Visitor:
    """An open page without a browser."""

    def __init__(self, url: str, token: str = "") -> None:
        self.story, self.pictures, self.wholes = {}, [], 0
        self._loop = IOLoop(make_current=False)
        live = f"{url.partition('?')[0].replace('http', 'ws', 1)}live?token={token}"
        self._socket = self._loop.run_sync(lambda: websocket_connect(live), timeout=PATIENCE)

    def until(self, condition):
        """Read messages until a condition holds, which must happen; returns its value."""
        while not (held := condition()):
            message = self._loop.run_sync(self._socket.read_message, timeout=PATIENCE)
            if message is None:
                raise ConnectionError(self._socket.close_code, self._socket.close_reason)
            if isinstance(message, bytes):
                self.pictures.append(message)
                continue
            ((kind, change),) = json.loads(message).items()
            self.wholes += kind == "all"
            self.story |= change
            self.story = {key: value for key, value in self.story.items() if value is not None}
        return held

    def say(self, text: str) -> None:
        self._loop.run_sync(lambda: self._socket.write_message(text), timeout=PATIENCE)

    def close(self) -> None:
        async def leave():
            self._socket.close()
            while await self._socket.read_message() is not None:
                pass

        self._loop.run_sync(leave, timeout=PATIENCE)
        self._loop.close(all_fds=True)


@pytest.fixture
def cell(ros):
    return Cell(ros)


def test_a_late_visitor_is_told_everything_from_the_start(cell):
    with contextlib.closing(Visitor(cell.url)) as early:
        for push, stamp in ((0, 1), (0, 2), (1, 3)):
            cell.push(push, stamp, estimate_first=stamp == 2)
        cell.plan.publish(PlanProgress(phase=PlanProgress.PHASE_PLACING, push_id=2, count=5, message="place it"))
        early.until(lambda: "plan" in early.story and early.story.get("moment/2", {}).get("after"))
        late = Visitor(cell.url)
        late.until(lambda: late.wholes)
        told, told_early = ({key: one.story[key] for key in one.story if not key.startswith("node/")} for one in (late, early))
        assert told == told_early  # except for the nodes' health, which goes on changing
        assert late.story["plan"]["message"] == "place it"
        moments = [late.story[f"moment/{seen}"] for seen in range(3)]
        assert [moment["push"] for moment in moments] == [0, 0, 1]
        assert [moment["after"]["data_points"] for moment in moments] == [1, 2, 3]
        assert late.story["estimate"]["mu_c"]["max"] == "inf"
        late.close()


def test_only_somebody_who_looks_costs_images_and_poses(cell):
    moving = (cell.images, cell.poses, cell.pushers)
    assert [out.get_subscription_count() for out in moving] == [0, 0, 0]
    visitor = Visitor(cell.url)
    for out in moving:
        cell.ros.wait_for(out.get_subscription_count, PATIENCE, f"a subscription to {out.topic_name}")
    cell.node.create_timer(0.05, lambda: cell.images.publish(CompressedImage(format="jpeg", data=b"picture")))
    visitor.until(lambda: b"picture" in visitor.pictures)
    visitor.say('{"looks": false}')  # a page in the background
    for out in moving:
        cell.ros.wait_for(lambda out=out: not out.get_subscription_count(), PATIENCE, f"the end of that to {out.topic_name}")
    visitor.say('{"looks": true}')
    cell.ros.wait_for(cell.images.get_subscription_count, PATIENCE, "a new subscription")
    visitor.close()
    for out in moving:
        cell.ros.wait_for(lambda out=out: not out.get_subscription_count(), PATIENCE, f"the end of that to {out.topic_name}")


def test_keyframes_are_kept_for_those_who_come_later(cell):
    keyframes = cell.ros.publisher(cell.node, CompressedImage, "keyframes/compressed", RELIABLE)  # though nobody looks
    cell.push(0, 1)
    with contextlib.closing(Visitor(cell.url)) as visitor:
        visitor.until(lambda: "moment/0" in visitor.story)
        keyframes.publish(CompressedImage(format="jpeg", data=b"a picture"))
        visitor.until(lambda: "picture/0" in visitor.story)
        assert visitor.story["picture/0"]["at"] == 1
        with urllib.request.urlopen(f"{cell.url}picture/0", timeout=PATIENCE) as answer:
            assert (answer.headers["Content-Type"], answer.read()) == ("image/jpeg", b"a picture")
        with pytest.raises(urllib.error.HTTPError, match="404"):
            urllib.request.urlopen(f"{cell.url}picture/1", timeout=PATIENCE)


def test_pose_pusher_and_the_cells_own_nodes_are_shown(cell):
    with contextlib.closing(Visitor(cell.url)) as visitor:
        cell.ros.wait_for(cell.pushers.get_subscription_count, PATIENCE, "a subscription to pusher_state")
        pose = PoseWithCovarianceStamped()
        pose.pose.pose.position.x, pose.pose.pose.orientation.w, pose.header.frame_id = 0.1, 1.0, "table"
        pose.header.stamp.sec = 1
        cell.node.create_timer(0.05, lambda: cell.poses.publish(pose))
        cell.pushers.publish(PusherState(mode=PusherState.MODE_RUNNING, position=0.02, push_id=PusherState.NO_PUSH))
        values = [KeyValue(key="frames/s", value="14.0")]
        statuses = [
            DiagnosticStatus(name=name, message="no frames", level=b"\2", values=values) for name in ("/cell/tracker", "/b")
        ]
        cell.health.publish(DiagnosticArray(status=statuses))
        visitor.until(lambda: {"pose", "pusher", "node/tracker"} <= set(visitor.story))
        assert visitor.story["pose"] == [0.1, 0.0, 0.0]
        assert (visitor.story["pusher"]["mode"], visitor.story["pusher"]["position"]) == ("running", 0.02)
        assert visitor.story["node/tracker"] == {"level": "error", "message": "no frames", "values": {"frames/s": "14.0"}}
        assert not any(name.endswith("/b") for name in visitor.story)


def test_what_is_left_out_stays_when_estimation_starts_again(cell):
    with contextlib.closing(Visitor(cell.url)) as visitor:
        for push in (0, 1):
            cell.push(push, push + 1)
        visitor.until(lambda: visitor.story.get("moment/1", {}).get("after"))
        cell.settings.publish(String(data=EstimatorSettings().without([0]).to_text()))
        visitor.until(lambda: visitor.story["push/0"]["excluded"])
        cell.estimates.publish(nothing_known("rubber_rect4"))
        visitor.until(lambda: "push/1" not in visitor.story)
        assert {"push/0", "moment/0"} <= set(visitor.story)
        assert "moment/1" not in visitor.story
        assert "estimate" not in visitor.story


def test_each_kind_of_message_that_cannot_be_shown_is_in_the_log(cell, capfd):
    log = []
    cell.observations.publish(Observation())  # without a normal
    cell.settings.publish(String(data="nothing of the kind"))
    cell.plan.publish(serialize_message(PlanProgress())[:8])  # of another version
    for kind in ("Observation not shown", "String not shown", "PlanProgress not shown"):
        cell.ros.wait_for(lambda kind=kind: log.append(capfd.readouterr().err) or kind in "".join(log), PATIENCE, kind)


def test_requests_reach_their_services_and_their_answers_the_visitor(cell):
    stopped, excluded, kept = [], [], []

    def answer(request, response):
        response.success, response.message = True, "as you like"
        return response

    def exclude(request, response):
        excluded.append(request.push_id)
        response.message = "no such push"
        return response

    def keep(request, response):
        kept.append(request.push_id)
        return response

    cell.node.create_subscription(Empty, "stop", stopped.append, RELIABLE)
    assert cell.post("stop")[1] == {"done": False, "message": "no service /cell/actuator/stop: nobody there can do it"}
    for name in ("actuator/stop", "actuator/reset", *(f"experiment/{what}" for what in ("repeat", "skip", "end"))):
        cell.node.create_service(Trigger, name, answer)
    cell.node.create_service(SelectPush, "estimator/exclude_push", exclude)
    cell.node.create_service(SelectPush, "estimator/keep_push", keep)
    for client in cell.view._services_of.values():
        cell.ros.wait_for(client.service_is_ready, PATIENCE, f"the service {client.srv_name}")
    for what in ("stop", "reset", "repeat", "skip", "end"):
        assert cell.post(what) == (200, {"done": True, "message": "as you like"})
    assert cell.post("exclude/3") == (200, {"done": False, "message": "no such push"})
    assert cell.post("keep/4")[0] == 200
    assert (excluded, kept) == ([3], [4])
    cell.ros.wait_for(lambda: stopped, PATIENCE, "the message on stop")


def test_without_the_token_only_a_stop_is_taken(ros):
    cell = Cell(ros, token="a-secret-word")
    assert cell.url.endswith("/?token=a-secret-word")
    assert cell.post("stop")[0] == 200
    for what in ("reset", "skip", "end", "exclude/1", "keep/1", "reset?token=another", "reset?token=%C3%A9"):
        assert cell.post(what) == (401, {"done": False, "message": "the token is missing or wrong"})
    assert cell.post("reset?token=a-secret-word")[0] == 200
    assert cell.post("reset", Authorization="Bearer a-secret-word")[0] == 200
    with pytest.raises(urllib.error.HTTPError, match="401"):
        urllib.request.urlopen(f"{cell.url.partition('?')[0]}picture/0", timeout=PATIENCE)
    refused = Visitor(cell.url)
    with pytest.raises(ConnectionError, match=r"4001. the token"):
        refused.until(lambda: refused.wholes)
    assert not refused.story
    with contextlib.closing(Visitor(cell.url, "a-secret-word")) as welcome:
        welcome.until(lambda: welcome.wholes)


def test_a_taken_port_is_refused_in_one_line(ros):
    cell = Cell(ros)
    port = int(cell.url.rpartition(":")[2].rstrip("/"))
    for parameters, said in (({"port": port}, "Address already in use"), ({"host": "no-such-host.invalid"}, "no-such-host")):
        with pytest.raises(InvalidInput, match=f"^the page cannot be served at .*{said}") as refusal:
            made(ViewNode, object="rubber_rect4", **parameters)
        assert "\n" not in str(refusal.value)
