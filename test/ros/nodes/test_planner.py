"""The planner's answers: what the core predicts from the same observations, over the real middleware."""

import numpy as np
import pytest
from composition import made
from geometry_msgs.msg import Point
from problems import observations_of
from rclpy.node import Node
from std_srvs.srv import Trigger

from pushfric_core.estimation.estimate import friction_model
from pushfric_core.estimation.estimator import Estimator
from pushfric_core.geometry.contact import PushingLine
from pushfric_core.geometry.planar import Pose, Wrench
from pushfric_core.geometry.table_1 import TABLE_1
from pushfric_core.mechanics.limit_surface import LimitSurface, named_ellipsoid
from pushfric_core.mechanics.prediction import motion_cone, predict
from pushfric_core.mechanics.strokes import predict_strokes
from pushfric_msgs.msg import Basis, FrictionModel, Observation
from pushfric_msgs.srv import GetLimitSurface, MotionCone, PredictPush, PredictStroke, StablePushes
from pushfric_ros.messages.conversions import observation_to_msg
from pushfric_ros.node_kit import turns
from pushfric_ros.node_kit.diagnostics import Level
from pushfric_ros.node_kit.planner_client import QUESTIONS, planner_client
from pushfric_ros.node_kit.qos import LATCHED, RELIABLE
from pushfric_ros.nodes.estimator import EstimatorNode
from pushfric_ros.nodes.planner import PlannerNode

NAME = "wood_rect3"
KNOWN = TABLE_1[NAME]
DATA = observations_of(KNOWN.outline, KNOWN.support, KNOWN.mu_c, 6, np.random.default_rng(5))
CONTACTS, NORMALS = np.array(((0.0, -0.032), (0.0635, 0.01))), np.array(((0.0, -1.0), (1.0, 0.0)))
VELOCITIES = np.array(((0.01, 0.02), (0.02, 0.0)))
CENTERS, TURNS = np.array(((-0.4, 0.0), (0.0, -0.01))), np.array((1, -1))
STARTS = [Pose(0.0, 0.0, 0.1), Pose(0.01, 0.0, -0.2)]
LINES = [PushingLine((0.0, -0.1), (0.0, 1.0), 0.003), PushingLine((-0.1, 0.01), (1.0, 0.0), 0.003)]
POSITIONS = [0.1, 0.08]


def push_request(points=CONTACTS, normals=NORMALS, velocities=VELOCITIES, **more):
    contacts = {"contact_points": points.ravel(), "contact_normals": normals.ravel()}
    return PredictPush.Request(**contacts, tip_velocities=velocities.ravel(), **more)


def many_pushes(count, **more):
    rng = np.random.default_rng(count)
    outline = KNOWN.outline
    edges = rng.integers(len(outline.edges), size=count)
    points = outline.vertices[edges] + rng.uniform(0.1, 0.9, (count, 1)) * outline.edges[edges]
    normals = outline.normals[edges]
    pushes = points, normals, 0.01 * (rng.normal(size=(count, 2)) - 2 * normals)
    return pushes, push_request(*pushes, **more)


def cone_request():
    return MotionCone.Request(contact_points=CONTACTS.ravel(), contact_normals=NORMALS.ravel())


def turn_request():
    return StablePushes.Request(
        contact_points=CONTACTS.ravel(),
        contact_normals=NORMALS.ravel(),
        half_widths=[0.02, 0.01],
        centers_of_rotation=CENTERS.ravel(),
        turns=TURNS.tolist(),
    )


def stroke_request(**more):
    return PredictStroke.Request(
        starts=np.ravel(STARTS),
        origins=np.ravel([line.origin for line in LINES]),
        directions=np.ravel([line.direction for line in LINES]),
        tip_radii=[line.tip_radius for line in LINES],
        positions=POSITIONS,
        **more,
    )


@pytest.fixture(scope="module")
def model():
    """What the estimator makes of DATA."""
    return friction_model(Estimator(KNOWN.support_points).add(DATA))


class Cell:
    """An estimator, a planner, and a node that asks it."""

    def __init__(self, ros, **planner):
        self.ros = ros
        self.node = ros.node("asking", namespace="/cell")
        self.planner = ros.compose(made(PlannerNode, **planner))
        self.models = ros.heard(self.node, FrictionModel, "friction_model", LATCHED)

    def estimate(self, observations=DATA):
        """Start the estimator, and wait until the planner has the model of these observations."""
        self.ros.compose(made(EstimatorNode, object=NAME, source="observations"))
        self.observe(observations)

    def observe(self, observations):
        """Tell the estimator of observations, and wait until the planner has the model of so many."""
        out = self.ros.publisher(self.node, Observation, "observation", RELIABLE)
        for observation in observations:
            out.publish(observation_to_msg(observation, NAME))
        self.wait_for_model(len(observations))

    def wait_for_model(self, count):
        self.ros.wait_for(lambda: self.planner._known.basis.object == NAME, what="the estimator's first model")
        self.ros.wait_for(lambda: self.planner._known.basis.data_points == count, what="the planner's model")

    def client(self, name, kind=None, node=None):
        node = node or self.node
        client = node.create_client(kind, name) if kind else planner_client(node, QUESTIONS[name])
        self.ros.wait_for(client.service_is_ready, what=name)
        return client

    def ask(self, name, request, kind=None, client=None):
        return self.ros.result((client or self.client(name, kind)).call_async(request), f"the answer of {name}")

    def figures(self):
        return self.planner._health().values


@pytest.fixture
def cell(ros):
    """A cell whose planner has the model of DATA."""
    cell = Cell(ros)
    cell.estimate()
    return cell


def own_services(cell):
    """Names of the planner's services that are for single clients."""
    return [one.service_name for one in cell.planner.services if "/client_" in one.service_name]


def numbers(array):
    return np.ravel(array).tolist()


def test_answers_are_those_of_the_core_to_the_last_bit(cell, model):
    """Those that test_doors.py does not ask for."""
    found, expected = cell.ask("predict_push", push_request(with_samples=True)), predict(model, CONTACTS, NORMALS, VELOCITIES)
    assert list(found.sample_twists) == expected.samples.twists.ravel().tolist()
    assert list(found.weights) == model.share.tolist()

    moved = cell.ask("predict_stroke", stroke_request(with_samples=True))
    strokes = predict_strokes(model, KNOWN.outline, STARTS, LINES, POSITIONS)
    assert list(moved.ends) == numbers(strokes.means)
    assert list(moved.sample_ends) == strokes.poses.ravel().tolist()
    assert list(moved.covariances) == strokes.covariance.ravel().tolist()
    assert strokes.means[0, 1] > 0.02

    cones, cone = cell.ask("motion_cone", cone_request()), motion_cone(model, CONTACTS, NORMALS)
    assert (list(cones.right), list(cones.left)) == (numbers(cone.right), numbers(cone.left))


def test_the_mean_alone_moves_as_with_its_samples(cell, model):
    alone = cell.ask("predict_push", push_request(mean_only=True, with_samples=True))
    assert list(alone.twists) == numbers(predict(model, CONTACTS, NORMALS, VELOCITIES).twists)
    assert list(alone.weights) == [1.0]
    strokes = cell.ask("predict_stroke", stroke_request(mean_only=True))
    found = predict_strokes(model.mean, KNOWN.outline, STARTS, LINES, POSITIONS)
    assert list(strokes.ends) == numbers(found.means)
    assert strokes.covariances.tolist() == found.covariance.ravel().tolist()
    coarse = cell.ask("predict_stroke", stroke_request(mean_only=True, step=0.005)).ends
    assert list(coarse) == numbers(predict_strokes(model, KNOWN.outline, STARTS, LINES, POSITIONS, 0.005).means)
    assert coarse != strokes.ends
    assert not len(strokes.sample_ends)


def test_every_answer_says_what_it_rests_on(ros):
    cell = Cell(ros)
    requests = {
        "predict_push": push_request(),
        "predict_stroke": stroke_request(),
        "motion_cone": cone_request(),
        "stable_pushes": turn_request(),
        "limit_surface": GetLimitSurface.Request(),
    }
    for name, request in requests.items():
        answer = cell.ask(name, request)
        assert not answer.success
        assert answer.message == "no model has come yet on friction_model: is the estimator running?"
        assert (answer.basis.object, answer.basis.has_model) == ("", False)
    cell.estimate([])
    answer = cell.ask("predict_push", push_request())
    assert answer.message == "there is no estimate yet; push the object first"
    assert (answer.basis.object, answer.basis.has_model, answer.basis.data_points) == (NAME, False, 0)

    cell.observe(DATA)
    for name, request in requests.items():
        answer = cell.ask(name, request)
        assert answer.success
        basis = answer.basis
        assert (basis.object, basis.has_model, basis.data_points) == (NAME, True, len(DATA))
        assert (basis.header.frame_id, basis.header.stamp) == ("object", cell.models[-1].basis.header.stamp)
        assert basis.pushes == len({observation.push_id for observation in DATA})
        assert basis.reasons == cell.models[-1].basis.reasons
    assert cell.ask("estimator/reset", Trigger.Request(), Trigger).success
    cell.wait_for_model(0)
    assert cell.ask("limit_surface", GetLimitSurface.Request()).message == "there is no estimate yet; push the object first"


def test_a_late_planner_answers_from_the_topic_alone(ros, cell):
    second = ros.compose(PlannerNode(namespace="/cell", cli_args=["--ros-args", "-r", "__node:=elsewhere"]))
    ros.wait_for(lambda: second._known.model is not None, what="the latched model")
    first, other = (cell.ask(f"{name}/predict_push", push_request(), PredictPush) for name in ("planner", "elsewhere"))
    assert first == other
    assert first.success


def test_slices_make_no_difference(cell, model):
    pushes, request = many_pushes(1500, with_samples=True)
    found, expected = cell.ask("predict_push", request), predict(model, *pushes)
    assert list(found.twists) == numbers(expected.twists)
    assert list(found.sample_twists) == expected.samples.twists.ravel().tolist()
    assert list(found.spreads) == expected.spread.tolist()


def test_the_limit_surface_comes_in_the_forms_of_planners(cell, model):
    msg = cell.ask("limit_surface", GetLimitSurface.Request()).limit_surface
    assert (msg.object, msg.header.frame_id, msg.contact_friction) == (NAME, "object", model.median_mu_c)
    assert (msg.f_max, msg.m_max) == (1, named_ellipsoid(model.support).m_max)
    assert (msg.center.x, msg.center.y) == pytest.approx(tuple(model.support.center_of_friction))
    assert 0 < msg.ellipsoid_twist_error < 0.3
    exact = LimitSurface(model.support)
    loads = [exact.load(Wrench(w.force.x, w.force.y, w.torque.z)) for w in msg.wrenches]
    assert loads == pytest.approx(np.ones(len(loads)))
    work = [
        w.force.x * t.linear.x + w.force.y * t.linear.y + w.torque.z * t.angular.z
        for w, t in zip(msg.wrenches, msg.twists, strict=True)
    ]
    assert work == pytest.approx(np.ones(len(work)))  # unit dissipation


WRONG = [
    ("predict_push", {"contact_points": []}, "must have the same length, at least 1, got 0, 2, 2"),
    ("predict_push", {"contact_normals": [2.0, 0.0, 1.0, 0.0]}, "contact_normals must have length 1, got 2"),
    ("predict_push", {"tip_velocities": [float("nan"), 0.0, 0.0, 0.0]}, "must be finite"),
    ("predict_push", {"contact_points": [0.0, -0.032, 0.0, 0.01]}, "contact 1: the contact must be within"),
    ("predict_push", {"contact_normals": [0.0, -1.0, -1.0, 0.0]}, "contact 1: the normal must point outward"),
    ("predict_push", {"deadline": -1.0}, "no answer within -1 s"),
    ("predict_push", {"deadline": float("nan")}, "no answer within nan s"),
    ("predict_stroke", {"starts": []}, "must have the same length, at least 1, got 0, 2, 2, 2, 2"),
    ("predict_stroke", {"directions": [0.0, 1.0, 0.0, 2.0]}, "directions must have length 1, got 2"),
    ("predict_stroke", {"tip_radii": [0.003, -0.003]}, "a tip radius must be at least 0 and finite, got -0.003"),
    ("predict_stroke", {"positions": [0.1, float("inf")]}, "positions must be finite"),
    ("predict_stroke", {"starts": [float("nan"), *[0.0] * 5]}, "starts must be finite"),
    ("predict_push", {"tip_velocities": [0.0, 0.02, 0.01]}, "tip_velocities must have 2 numbers each, got 3 in all"),
    ("predict_stroke", {"step": 1e-9}, "step must be 0, or 0.0001 to 0.1 m, got 1e-09"),
    ("predict_stroke", {"step": 1e300}, "step must be 0, or 0.0001 to 0.1 m, got 1e+300"),
    ("stable_pushes", {"turns": [0, 1]}, "turns must be +1 or -1"),
    ("stable_pushes", {"half_widths": [1.0, 0.01]}, "half_width must be at most"),
]


def test_a_wrong_request_is_answered_with_the_reason(cell):
    for name, change, expected in WRONG:
        request = {"predict_push": push_request, "predict_stroke": stroke_request, "stable_pushes": turn_request}[name]()
        for field, value in change.items():
            setattr(request, field, value)
        answer = cell.ask(name, request)
        assert not answer.success
        assert expected in answer.message
        assert answer == type(answer)(message=answer.message, basis=answer.basis)  # nothing half done


def test_a_request_that_is_too_large_is_refused_and_says_so(ros):
    cell = Cell(ros, most_pushes=3, most_strokes=1)
    cell.estimate()
    answer = cell.ask("predict_push", many_pushes(4)[1])
    assert answer.message == "contact_points must be at most 3 in one request (the planner's most_pushes), got 4"
    assert "starts must be at most 1 in one request" in cell.ask("predict_stroke", stroke_request()).message
    assert cell.ask("predict_push", many_pushes(3)[1]).success


def test_a_deadline_ends_the_work(cell):
    answer = cell.ask("predict_push", many_pushes(10_000, deadline=1e-3)[1])
    assert (answer.success, answer.message, len(answer.twists)) == (False, "no answer within 0.001 s", 0)
    assert cell.figures()["waiting"] == 0


def test_a_short_request_does_not_wait_for_long_ones(ros, monkeypatch):
    cell = Cell(ros, longest=60.0)
    cell.estimate()
    client = cell.client("predict_push")
    with monkeypatch.context() as held:
        held.setattr(turns, "TURN", 0.0)  # no work is done before all have come
        long = [client.call_async(many_pushes(4000)[1]) for _ in range(6)]
        ros.wait_for(lambda: cell.planner._turns.waiting == len(long), what="the long requests")
        short = client.call_async(push_request())
        ros.wait_for(lambda: cell.planner._turns.waiting == len(long) + 1, what="the short request")
    ros.wait_for(lambda: short.done() or all(one.done() for one in long), what="the short answer")
    assert short.result().success
    assert not any(one.done() for one in long)
    ros.wait_for(lambda: all(one.done() for one in long), what="the long answers")
    assert all(len(one.result().modes) == 4000 for one in long)


def test_many_calls_at_once_of_twenty_clients_are_all_answered(ros, cell):
    """With rclpy's own quality of service, which keeps ten answers: each client has a name of its own."""
    nodes = [ros.node(f"asking_{number}", namespace="/cell") for number in range(4)]
    names = [f"planner/predict_push/client_{number}" for number in range(20)]
    clients = [cell.client(name, PredictPush, node=node) for name, node in zip(names, 5 * nodes, strict=True)]
    _, request = many_pushes(20)
    answers = [client.call_async(request) for _ in range(4) for client in clients]
    ros.wait_for(lambda: all(answer.done() for answer in answers), what="80 answers")
    first, *others = [answer.result() for answer in answers]
    assert first.success
    assert all(other == first for other in others)


def test_a_client_may_have_hundreds_of_open_calls(ros, cell):
    client = cell.client("predict_push")
    answers = [client.call_async(push_request()) for _ in range(300)]
    ros.wait_for(lambda: all(answer.done() for answer in answers), what="300 answers")
    assert all(answer.result().success for answer in answers)


def test_a_service_that_many_clients_share_says_how_not_to_lose_answers(ros, cell):
    name = "planner/predict_push"
    clients = [cell.client(name, PredictPush) for _ in range(turns.SHARE)]
    assert cell.ask(name, push_request(), PredictPush, clients[0]).success
    cell.client(name, PredictPush)
    ros.wait_for(lambda: cell.planner.count_clients(name) > turns.SHARE, what="the last client")
    refused = cell.ask(name, push_request(), PredictPush, clients[0])
    said = "more than 10 clients share /cell/planner/predict_push, and lose answers: each must ask"
    assert (refused.success, refused.message) == (False, f"{said} /cell/planner/predict_push/ITS_OWN_NAME")
    assert cell.ask("predict_push", push_request()).success


def test_only_services_of_a_planner_are_known():
    with pytest.raises(ValueError, match="expected one of PredictPush, PredictStroke, "):
        planner_client(None, Trigger)


def test_requests_of_clients_that_are_gone_are_dropped_and_their_services_end(ros, monkeypatch):
    cell = Cell(ros, longest=600.0)
    cell.estimate()
    gone = Node("gone", namespace="/cell")  # without an executor, which would still use it when it goes
    shared = cell.client("planner/predict_push", PredictPush, node=gone)
    clients = [shared, *(cell.client("predict_push", node=gone) for _ in range(2))]
    ros.wait_for(lambda: len(own_services(cell)) == 2, what="a service for each client")
    with monkeypatch.context() as held:
        held.setattr(turns, "TURN", 0.0)  # no work is done before the clients have gone
        for client in clients:
            client.call_async(push_request())
        ros.wait_for(lambda: cell.planner._turns.waiting == len(clients), what="the requests")
        monkeypatch.setattr(turns, "PATIENCE", 0.0)  # from now on: a client may be missed for a moment
        names = [client.service_name for client in clients]
        gone.destroy_node()
        ros.wait_for(lambda: not any(map(cell.planner.count_clients, names)), what="the clients' end")
    ros.wait_for(lambda: cell.figures()["dropped"] + cell.figures()["answered"] == len(clients), what="an end of the work")
    assert cell.figures()["answered"] == 0
    ros.wait_for(lambda: own_services(cell) == [], what="the end of their services")


def test_an_answer_to_a_client_that_cannot_be_reached_yet_is_kept(ros, cell, monkeypatch):
    """It is tried ever more seldom, because each try holds the others up: before, once for each of their answers."""
    respond, tried = turns.Turns._respond, []
    monkeypatch.setattr(turns.Turns, "_respond", lambda *args: tried.append(respond(*args)) or tried[-1])
    name, deaf = "planner/predict_push", ros.node("deaf", namespace="/cell")
    client = deaf.create_client(PredictPush, name, qos_profile=LATCHED)  # the answers do not match its reader
    ros.wait_for(lambda: cell.planner.count_clients(name), what="the client")
    client.call_async(push_request())
    ros.wait_for(lambda: cell.planner._turns.waiting, what="the request")
    asking = cell.client("predict_push")
    for _ in range(40):
        assert cell.ask("predict_push", push_request(), client=asking).success
    assert (tried.count(False), 1 <= tried.count(True) < 15) == (40, True)
    ros.wait_for(lambda: cell.planner._turns.waiting == 1, what="the answer that waits")
    assert cell.planner._turns.dropped == 0
    deaf.destroy_client(client)
    ros.wait_for(lambda: cell.planner._turns.waiting == 0, what="the end of the work")


def test_a_model_that_makes_no_sense_answers_nothing(ros):
    cell = Cell(ros)
    msg = FrictionModel(support_points=[Point()], w=[1.0, 2.0], mu_c=[0.3], weights=[1.0])
    msg.basis.object, msg.basis.has_model, msg.basis.data_points = NAME, True, 7
    cell.node.create_publisher(FrictionModel, "friction_model", LATCHED).publish(msg)
    cell.wait_for_model(7)
    answer = cell.ask("predict_push", push_request())
    assert answer.message == "the message on friction_model is wrong: w must have 1 x 1 numbers, got 2"
    assert not answer.basis.has_model
    assert cell.planner._health().level is Level.ERROR


def test_a_refusal_rests_on_what_was_known_when_the_work_began(ros):
    """A model that comes between the request and its first slice changes neither the reason nor the basis beside it."""
    planner = PlannerNode(namespace="/cell")
    answer, refuse = planner._begin("predict_push", PredictPush, push_request())
    planner._on_model(FrictionModel(basis=Basis(object=NAME)))
    with pytest.raises(ValueError, match="no model has come yet") as failed:
        next(answer)
    response = refuse(str(failed.value))
    planner.destroy_node()
    assert not response.success
    assert response.basis.object == ""
