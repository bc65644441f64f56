"""The estimator's answers to planners: what the core predicts from the same data points, over the real middleware."""

from importlib.resources import files

import numpy as np
import pytest
from geometry_msgs.msg import Point, Vector3
from problems import observations_of
from rclpy.parameter import Parameter
from std_srvs.srv import Trigger

from pushfric_core.estimation.estimator import Estimator
from pushfric_core.geometry.planar import Wrench
from pushfric_core.geometry.table_1 import TABLE_1
from pushfric_core.mechanics.prediction import friction_model, predict, stability
from pushfric_core.mechanics.simulation import ContactMode
from pushfric_core.mechanics.surface_models import EXPONENTS, Quartic, named_ellipsoid
from pushfric_msgs.msg import LimitSurface, Observation
from pushfric_msgs.srv import PredictPush, StablePushes
from pushfric_ros.messages.conversions import MODE_TO_MSG, observation_to_msg
from pushfric_ros.node_kit.qos import LATCHED, RELIABLE
from pushfric_ros.nodes.estimator import EstimatorNode

NAME = "wood_rect3"
KNOWN = TABLE_1[NAME]
DATA = observations_of(KNOWN.outline, KNOWN.support, KNOWN.mu_c, 6, np.random.default_rng(5))
CONTACTS, NORMALS = np.array(((0.0, -0.032), (0.0635, 0.01))), np.array(((0.0, -1.0), (1.0, 0.0)))
VELOCITIES = np.array(((0.01, 0.02), (0.02, 0.0)))
CENTERS, TURNS = np.array(((-0.4, 0.0), (0.0, -0.01))), np.array((1, -1))


def point(xy):
    return Point(x=xy[0], y=xy[1])


def vector(xy):
    return Vector3(x=xy[0], y=xy[1])


@pytest.fixture
def asked(ros):
    """A function that sends data points, and one that asks a service of the estimator."""
    node = ros.node("planner", namespace="/cell")
    parameters = {"object": NAME, "source": "observations"}
    ros.compose(EstimatorNode(namespace="/cell", parameter_overrides=[Parameter(k, value=v) for k, v in parameters.items()]))
    out = node.create_publisher(Observation, "observation", RELIABLE)
    surfaces = []
    node.create_subscription(LimitSurface, "limit_surface", surfaces.append, LATCHED)
    ros.wait_for(out.get_subscription_count, what="the estimator")

    def send(observations):
        for observation in observations:
            out.publish(observation_to_msg(observation, NAME))

    def ask(kind, name, request):
        client = node.create_client(kind, f"estimator/{name}")
        ros.wait_for(client.service_is_ready, what=name)
        answer = client.call_async(request)
        ros.wait_for(answer.done, what=f"the answer of {name}")
        return answer.result()

    return send, ask, surfaces, ros


def push_request():
    points, normals = [point(p) for p in CONTACTS.tolist()], [vector(n) for n in NORMALS.tolist()]
    velocities = [vector(v) for v in VELOCITIES.tolist()]
    return PredictPush.Request(contact_points=points, contact_normals=normals, tip_velocities=velocities)


def turn_request():
    return StablePushes.Request(
        contact_points=[point(p) for p in CONTACTS.tolist()],
        contact_normals=[vector(n) for n in NORMALS.tolist()],
        half_widths=[0.02, 0.01],
        centers_of_rotation=[point(c) for c in CENTERS.tolist()],
        turns=TURNS.tolist(),
    )


def expected_model():
    estimator = Estimator(KNOWN.support_points)
    for observation in DATA:
        estimate = estimator.add(observation)
    return estimate, friction_model(estimate)


def test_services_answer_what_the_core_predicts(asked):
    send, ask, surfaces, ros = asked
    assert ask(PredictPush, "predict_push", push_request()).message == "there is no estimate yet; push the object first"
    send(DATA)
    ros.wait_for(lambda: surfaces and surfaces[-1].wrenches, what="a limit surface")
    _, model = expected_model()
    found, expected = ask(PredictPush, "predict_push", push_request()), predict(model, CONTACTS, NORMALS, VELOCITIES)
    assert (found.success, found.message) == (True, "")
    assert [(t.linear.x, t.linear.y, t.angular.z) for t in found.twists] == [tuple(row) for row in expected.twists]
    assert list(found.modes) == [MODE_TO_MSG[mode] for mode in expected.modes]
    assert expected.modes[1] is ContactMode.FREE
    assert list(found.spreads) == expected.spread.tolist()
    assert [(f.x, f.y) for f in found.forces] == [tuple(row) for row in expected.forces]

    held = ask(StablePushes, "stable_pushes", turn_request())
    same = stability(model, CONTACTS, NORMALS, (0.02, 0.01), CENTERS, TURNS)
    assert held.success
    assert (list(held.stable), list(held.margins)) == (same.stable.tolist(), same.margins.tolist())
    assert list(held.probabilities) == same.probabilities.tolist()


def test_the_limit_surface_is_latched_once_the_estimate_stands(asked):
    send, ask, surfaces, ros = asked
    send(DATA)
    ros.wait_for(lambda: surfaces and surfaces[-1].wrenches, what="a limit surface")
    _, model = expected_model()
    msg = surfaces[-1]
    ellipsoid = named_ellipsoid(model.support)
    assert (msg.object, msg.header.frame_id, msg.contact_friction) == (NAME, "object", model.mean_mu_c)
    assert (msg.f_max, msg.m_max) == (1, ellipsoid.m_max)
    assert (msg.center.x, msg.center.y) == pytest.approx(tuple(model.support.center_of_friction))
    assert msg.quartic_twist_error < msg.ellipsoid_twist_error < 0.3
    quartic = Quartic(np.array(msg.quartic))
    loads = [quartic.load(Wrench(w.force.x, w.force.y, w.torque.z)) for w in msg.wrenches]
    assert np.sqrt(np.mean((np.array(loads) - 1) ** 2)) == pytest.approx(msg.quartic_load_error)
    work = [
        w.force.x * t.linear.x + w.force.y * t.linear.y + w.torque.z * t.angular.z
        for w, t in zip(msg.wrenches, msg.twists, strict=True)
    ]
    assert work == pytest.approx(np.ones(len(work)))  # unit dissipation
    ask(Trigger, "reset", Trigger.Request())
    ros.wait_for(lambda: not surfaces[-1].wrenches, what="the surface taken back")


def test_the_message_lists_the_coefficients_in_order():
    names = ["fx", "fy", "m"]
    terms = [
        " ".join(name if power == 1 else f"{name}^{power}" for name, power in zip(names, powers, strict=True) if power)
        for powers in EXPONENTS
    ]
    text = (files("pushfric_msgs") / "../../../../share/pushfric_msgs/msg/LimitSurface.msg").read_text()
    comment = " ".join(line.partition("#")[2].strip() for line in text.split("float64[15] quartic")[1].splitlines()[:2])
    assert comment.removeprefix("coefficients of ").split(" [")[0] == ", ".join(terms)


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        ({"contact_points": []}, "must have the same length, at least 1, got 0, 2, 2"),
        ({"contact_normals": [Vector3(x=2.0), Vector3(x=1.0)]}, "contact_normals must have length 1, got 2"),
        ({"tip_velocities": [Vector3(x=float("nan")), Vector3()]}, "must be finite"),
    ],
)
def test_a_wrong_request_is_answered_with_the_reason(asked, change, expected):
    send, ask, surfaces, ros = asked
    send(DATA)
    ros.wait_for(lambda: surfaces and surfaces[-1].wrenches)
    request = push_request()
    for name, value in change.items():
        setattr(request, name, value)
    answer = ask(PredictPush, "predict_push", request)
    assert not answer.success
    assert expected in answer.message
    assert not answer.twists
    wrong = turn_request()
    wrong.turns = [0, 1]
    assert "turns must be +1 or -1" in ask(StablePushes, "stable_pushes", wrong).message
