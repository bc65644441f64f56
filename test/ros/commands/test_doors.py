"""One answer by every door: Python, the command with a CSV, a bag or a model, and the live node, to the last bit."""

import csv
import json
import pathlib
import re
import signal
import subprocess
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import pytest
from calls import PROGRAM, figures, invoked, killed_at_the_end, pushfric
from composition import made
from problems import contacts_of, observations_of
from semantic_damage import Recording

from bench.public import stablepush, zhou2015
from pushfric_core import Estimator, HalfPlanes, Recognizer, load, named_ellipsoid, next_pushes, predict, stability
from pushfric_core.bags.bag_writer import BagWriter, offered
from pushfric_core.bags.message_types import encoder
from pushfric_core.estimation.estimate import friction_model
from pushfric_core.estimation.region import RegionConfig, line_of_motion
from pushfric_core.files.csv_files import MOVED, OPTIONAL, REQUIRED, TURNED, EdgePushes, PointPushes, read_observations
from pushfric_core.files.model_file import load_model
from pushfric_core.files.object_file import OBJECT_FILE, load_object, save_object
from pushfric_core.geometry.table_1 import TABLE_1
from pushfric_core.mechanics.limit_surface import surface_samples
from pushfric_core.records import to_json
from pushfric_msgs.msg import CenterOfFrictionRegion, FrictionEstimate, FrictionModel, Observation, Recognition
from pushfric_msgs.srv import GetLimitSurface, PredictPush, StablePushes
from pushfric_ros.messages.conversions import MODE_TO_MSG, observation_to_msg, report_from_msg
from pushfric_ros.node_kit.planner_client import planner_client
from pushfric_ros.node_kit.qos import LATCHED, RELIABLE
from pushfric_ros.nodes.estimator import EstimatorNode
from pushfric_ros.nodes.planner import PlannerNode

TWO_FINGERS = "30_90_30_30_30_90"


class Case(NamedTuple):
    """What was seen of an object, and what is asked about it."""

    observations: list
    folder: object  # of the object's file
    moved: PointPushes
    turned: EdgePushes
    held: np.ndarray | None = None  # (k,) whether the pushes of `turned` held the real object


def simulated(name, count, seed):
    def case(folder, _):
        known, rng = TABLE_1[name], np.random.default_rng(seed)
        save_object(load_object(name), folder / OBJECT_FILE)
        data = observations_of(known.outline, known.support, known.mu_c, count, rng)
        edges, k = rng.integers(4, size=40), 40
        points = known.outline.vertices[edges] + rng.uniform(0.1, 0.9, (k, 1)) * known.outline.edges[edges]
        normals, centers = known.outline.normals[edges], rng.uniform(-0.5, 0.5, (k, 2))
        moved = PointPushes(points, normals, -0.02 * normals + rng.uniform(-0.03, 0.03, (k, 2)))
        turned = EdgePushes(points, normals, rng.uniform(0, 0.02, k), centers, rng.choice((-1.0, 1.0), k))
        return Case(data, folder, moved, turned)

    return case


def with_two_fingers(folder, real_pushes):
    """Fitted to the stable pushes, which are intervals; asked about all of them."""
    two = stablepush.read_stable_pushes(real_pushes / "stable_pushes.csv")[TWO_FINGERS]
    imported = {one.object: one.path for one in stablepush.import_pushes(real_pushes / "stable_pushes.csv", folder / "in")}
    data = [stablepush._observation(two, index) for index in np.flatnonzero(two.stable).tolist()[::8]]
    seen = zhou2015.read_push_points(real_pushes / "push_points.csv")["30_90_30_30_30_90__exp_08_11_30.txt"]
    return Case(data, imported[TWO_FINGERS], PointPushes(*map(np.array, contacts_of(seen))), two.pushes)


CASES = {
    "simulated": simulated("wood_rect3", 14, 12),
    "few": simulated("delrin_square3", 6, 4),  # one sample is left, which is not the optimum
    "real fingers": with_two_fingers,
}


@pytest.fixture(params=CASES)
def case(request, tmp_path):
    found = CASES[request.param](tmp_path, request.getfixturevalue("real_pushes") if "real" in request.param else None)
    write_csv(tmp_path / "data.csv", (*REQUIRED, *OPTIONAL), [
        (*one.contact_point, *one.contact_normal, *one.twist, one.push_id, one.half_width,
         *(one.force or ("", "")), *(one.tip_velocity or ("", "")),
         *("" if known is None else known for known in (one.duration, one.depth, None)))
        for one in found.observations
    ])  # fmt: skip
    write_csv(tmp_path / "moved.csv", MOVED, np.column_stack(found.moved).tolist())
    write_csv(tmp_path / "turned.csv", TURNED, np.column_stack(found.turned).tolist())
    model = load_object(str(found.folder / OBJECT_FILE))
    data = read_observations(tmp_path / "data.csv", model.outline)
    write_bag(tmp_path / "bag", data, model)
    return found._replace(observations=data), model, tmp_path


def write_csv(path, columns, rows):
    with path.open("w", newline="") as stream:
        csv.writer(stream).writerows((columns, *rows))


def write_bag(path, observations, model):
    with BagWriter(path) as writer:
        writer.add_topic("/cell/observation", "pushfric_msgs/msg/Observation", [offered(RELIABLE)])
        encode = encoder("pushfric_msgs/msg/Observation")
        for number, one in enumerate(observations):
            writer.write("/cell/observation", number, encode(observation_to_msg(one, model.name)))
    save_object(model, path / OBJECT_FILE)


def plain(figures):
    """The same figures as JSON has them."""
    return json.loads(to_json(figures))


def surface_of(support):
    """The named ellipsoid of a support, and samples of its limit surface."""
    ellipsoid, (wrenches, _) = named_ellipsoid(support), surface_samples(support)
    return [ellipsoid.m_max, *ellipsoid.center, *wrenches.ravel()]


def by_python(case, model):
    """The answers of pushfric_core, question by question."""
    estimator = Estimator(model.support_points)
    recognizer, half_planes = Recognizer(model.hypotheses) if model.hypotheses else None, HalfPlanes(model.outline, MARGIN)
    estimate = estimator.add(case.observations)
    for one in estimator.observations:
        half_planes.add(line_of_motion(one))
        ranking = recognizer.add(one) if recognizer else None
    friction = friction_model(estimate)
    moved, held, region = predict(friction, *case.moved), stability(friction, *case.turned), half_planes.region()
    answers = {
        "estimate": {
            "objective": estimate.solution.objective,
            "w": estimate.w.tolist(),
            "center_of_friction": estimate.center_of_friction.tolist(),
            "confidence": estimate.confidence,
            "mu_c": [estimate.mu_c_p90, estimate.mu_c.value, estimate.mu_c.low],
            "data_points": estimate.data_points,
            "use": estimate.verdict.use,
            "rejected": [one.push_id for one in estimator.rejected],
        },
        "predict": [
            *(moved.twists.tolist(), [mode.value for mode in moved.modes], moved.spread.tolist()),
            *(moved.forces.tolist(), moved.covariance.tolist()),
        ],
        "stable": [held.stable.tolist(), held.margins.tolist(), held.probabilities.tolist()],
        "region": {"area": region.area, "center_of_friction": region.center.tolist(), "polygon": region.corners.tolist()},
        "next push": [[*one.push, one.expected_area] for one in next_pushes(half_planes)],
        "limit surface": surface_of(friction.support),
    }
    if recognizer:
        answers["recognize"] = [[one.name, one.fit_error, one.ratio] for one in ranking.hypotheses]
    return plain(answers)


def planned(source, folder, *options):
    """What the commands for planners answer."""
    moved = figures("predict", source, "--pushes", folder / "moved.csv", *options)
    held = figures("stable", source, "--pushes", folder / "turned.csv", *options)
    return {
        "predict": [[row[key] for row in moved] for key in ("twist", "mode", "spread", "force", "covariance")],
        "stable": [[row[key] for row in held] for key in ("stable", "margin", "probability")],
    }


def estimated(*arguments):
    """The JSON of an estimate, be it usable or not."""
    run = invoked("estimate", *arguments, "--json")
    assert run.exit_code in (0, 1), run.output
    return json.loads(run.stdout)


def by_command(source, model, folder, *options):
    """The answers of the commands to a CSV or a bag."""
    estimate, region = estimated(source, *options), figures("region", source, *options)
    belief = estimate["belief"]
    answers = planned(source, folder, *options) | {
        "estimate": {key: estimate[key] for key in ("objective", "w", "center_of_friction", "data_points")}
        | {"mu_c": [estimate["mu_c"]["p90"], belief["mu_c"]["value"], belief["mu_c"]["interval"][0]]}
        | {"confidence": belief.get("radius"), "use": belief["verdict"]["use"]}
        | {"rejected": [one["push"] for one in belief["rejected"]]},
        "region": {key: region[key] for key in ("area", "center_of_friction", "polygon")},
        "next push": [[one[key] for key in ("edge", "offset", "angle", "expected_area")] for one in region["next_pushes"]],
    }
    if model.hypotheses:
        ranking = figures("recognize", source, *options)["hypotheses"]
        answers["recognize"] = [[one[key] for key in ("name", "fit_error", "ratio")] for one in ranking]
    return answers


def by_model(path, folder):
    """The answers of the commands to a model, and of the model in Python."""
    return plain(planned(path, folder) | {"limit surface": surface_of(load_model(path)[0].friction().support)})


def header(msg):
    return getattr(msg, "basis", msg).header


def by_node(ros, case, model):
    """The answers of the live nodes; the corners of a region come as float32."""
    node = ros.node("asking", namespace="/cell")
    ros.compose(PlannerNode(namespace="/cell"))
    ros.compose(made(EstimatorNode, object=str(case.folder / OBJECT_FILE), source="observations"))
    last, count = {}, len(case.observations)
    for kind, topic in TOPICS.items():
        node.create_subscription(kind, topic, lambda msg, kind=kind: last.update({kind: msg}), LATCHED)
    out = ros.publisher(node, Observation, "observation", RELIABLE)
    for number, one in enumerate(case.observations, 1):  # without durations, stamps only say which observation is the last
        out.publish(observation_to_msg(replace(one, stamp=number), model.name))
    wanted = set(TOPICS) - (set() if model.hypotheses else {Recognition})

    def complete():
        return all(kind in last and header(last[kind]).stamp.nanosec == count for kind in wanted)

    ros.wait_for(complete, what="answers from all observations")

    def ask(kind, **parts):
        client = planner_client(node, kind)
        ros.wait_for(client.service_is_ready, what=client.service_name)
        answer = ros.result(client.call_async(kind.Request(**parts)), f"the answer of {client.service_name}")
        assert answer.success, answer.message
        assert answer.basis.data_points == count
        return answer

    def contacts(pushes):
        return {"contact_points": pushes.contact_points.ravel(), "contact_normals": pushes.contact_normals.ravel()}

    moved = ask(PredictPush, **contacts(case.moved), tip_velocities=case.moved.tip_velocities.ravel())
    held = ask(
        StablePushes,
        **contacts(case.turned),
        half_widths=case.turned.half_widths.tolist(),
        centers_of_rotation=case.turned.centers.ravel(),
        turns=[int(turn) for turn in case.turned.turns],
    )
    surface = ask(GetLimitSurface).limit_surface
    estimate, region = last[FrictionEstimate], last[CenterOfFrictionRegion]
    modes = {number: mode.value for mode, number in MODE_TO_MSG.items()}
    friction = estimate.contact_friction
    answers = {
        "estimate": {
            "objective": estimate.objective,
            "w": list(estimate.support_friction.weights),
            "center_of_friction": [estimate.center_of_friction.x, estimate.center_of_friction.y],
            "confidence": none_if_nan(estimate.confidence),
            "mu_c": [friction.p90, none_if_nan(friction.value), friction.low],
            "data_points": estimate.data_points,
            "use": not estimate.reasons,
            "rejected": [one.push_id for one in estimate.rejected],
        },
        "predict": [
            np.reshape(moved.twists, (-1, 3)).tolist(),
            [modes[mode] for mode in moved.modes],
            list(moved.spreads),
            np.reshape(moved.forces, (-1, 2)).tolist(),
            np.array(moved.covariances).reshape(-1, 3, 3).tolist(),
        ],
        "stable": [list(held.stable), list(held.margins), list(held.probabilities)],
        "region": {
            "area": region.area,
            "center_of_friction": [region.center_of_friction.x, region.center_of_friction.y],
            "polygon": [[corner.x, corner.y] for corner in region.polygon.polygon.points],
        },
        "next push": [[one.edge, one.offset, one.angle, one.expected_area] for one in region.next_pushes],
        "limit surface": [
            *(surface.m_max, surface.center.x, surface.center.y),
            *(number for one in surface.wrenches for number in (one.force.x, one.force.y, one.torque.z)),
        ],
    }
    if model.hypotheses:
        answers["recognize"] = [[one.name, one.fit_error, one.ratio] for one in last[Recognition].hypotheses]
    return plain(answers)


MARGIN = RegionConfig().region_margin
TOPICS = {
    FrictionEstimate: "friction_estimate",
    CenterOfFrictionRegion: "center_of_friction_region",
    FrictionModel: "friction_model",
    Recognition: "recognition",
}


def none_if_nan(value):
    return None if np.isnan(value) else value


def test_every_door_gives_the_same_answers(case, ros):
    asked, model, folder = case
    expected = by_python(asked, model)
    of_object = "--object", asked.folder / OBJECT_FILE
    assert by_command(folder / "data.csv", model, folder, *of_object) == without(expected, "limit surface")
    assert by_command(folder / "bag", model, folder) == without(expected, "limit surface")
    estimated(folder / "bag", "--save", folder / "model.yaml")
    answers = by_model(folder / "model.yaml", folder)
    assert answers == {question: expected[question] for question in answers}
    if asked.held is not None:
        found = np.array(answers["stable"][0])
        assert (found[asked.held].mean() + (~found[~asked.held]).mean()) / 2 > 0.8
    expected["region"]["polygon"] = np.float32(expected["region"]["polygon"]).astype(float).tolist()
    assert by_node(ros, asked, model) == expected


def without(answers, question):
    return {name: answer for name, answer in answers.items() if name != question}


# --- what is learned from a bag: the program's p_CF, w and mu_c, and the belief's ---

DEMO = pathlib.Path(__file__).resolve().parents[3] / "bags/rubber_rect4"


def of_a_run(_):
    """Poses and pusher states, numbered, with the run's own plan and estimates."""
    return DEMO


def of_observations(folder):
    """Observations alone, of pushes that do not show mu_c."""
    known = TABLE_1["wood_rect3"]
    data = observations_of(known.outline, known.support, known.mu_c, 14, np.random.default_rng(5))
    write_bag(folder / "bag", [replace(one, stamp=number) for number, one in enumerate(data, 1)], load_object("wood_rect3"))
    return folder / "bag"


def of_another_recorder(folder):
    """Poses and pusher states alone, without numbers."""
    recording = Recording(DEMO)
    return recording.write_elsewhere(folder / "bag", recording.messages)


def of_a_model(path):
    """Both products in a saved model, under the names of the JSON of `estimate`; it has neither bounds nor intervals of w."""
    model = load(path)
    belief = model.belief.model_dump(include={"center_of_friction", "covariance", "radius", "w", "mu_c"})
    made = {"objective": model.made.fit_error, **{key: getattr(model.made, key) for key in ("data_points", "pushes", "status")}}
    return plain(model.model_dump(include={"w", "center_of_friction"}) | made | {"belief": belief})


def in_common(figures, others):
    """The figures that others have, too, in the belief as well."""
    return {
        key: in_common(figures[key], value) if isinstance(value, dict) and key == "belief" else figures[key]
        for key, value in others.items()
    }


def replayed(ros, bag, friction, folder):
    """Both products as they come on the topics of a replay and as it prints them, and what its planner answers."""
    command = [*PROGRAM, "replay", bag, "--rate", 10, "--stay", "--planner", "--headless", "--json"]
    with (
        (folder / "stderr").open("w") as stderr,
        killed_at_the_end(list(map(str, command)), stdout=subprocess.PIPE, stderr=stderr, text=True) as process,
    ):
        line = process.stdout.readline()  # printed when all has been played
        assert line, (folder / "stderr").read_text()
        node, last = ros.node("late", namespace="/cell"), {}
        for kind in (FrictionEstimate, FrictionModel):
            node.create_subscription(kind, TOPICS[kind], lambda msg, kind=kind: last.update({kind: msg}), LATCHED)
        client = planner_client(node, PredictPush)
        ros.wait_for(lambda: len(last) == 2 and client.service_is_ready(), what="the estimate and the model that stay")
        pushed = {"contact_points": [0.0, -0.03], "contact_normals": [0.0, -1.0], "tip_velocities": [0.0, 0.02]}
        answer = ros.result(client.call_async(PredictPush.Request(**pushed)), "the answer of the planner")
        process.send_signal(signal.SIGINT)
        assert process.wait(60) == 0
    expected = predict(friction, [[0.0, -0.03]], [[0.0, -1.0]], [[0.0, 0.02]])
    assert [list(answer.twists)] == expected.twists.tolist()
    assert list(answer.covariances) == expected.covariance.ravel().tolist()
    samples, model = np.array(last[FrictionModel].w).reshape(-1, len(friction.support.weights)), last[FrictionModel]
    assert [samples.tolist(), list(model.mu_c), list(model.weights), model.misfit, model.sliding_misfit] == [
        *(friction.w.tolist(), friction.mu_c.tolist(), friction.share.tolist(), friction.misfit, friction.sliding_misfit)
    ]
    return [plain(report_from_msg(last[FrictionEstimate]).to_dict()), json.loads(line)]


@pytest.mark.parametrize("made", [of_a_run, of_observations, of_another_recorder])
def test_every_door_gives_both_products_of_a_bag(ros, tmp_path, made):
    bag = made(tmp_path)
    recording = load(bag)
    estimate = recording.new_estimator().add(recording)
    expected = plain(estimate.to_dict(recording.object.name))
    assert expected["belief"]["center_of_friction"] != expected["center_of_friction"]
    assert estimated(bag, "--save", tmp_path / "model.yaml") == expected
    saved = of_a_model(tmp_path / "model.yaml")
    assert saved == in_common(expected, saved)
    invoked("report", bag, "--html", tmp_path / "report.html")
    (story,) = re.findall(r'<script type="application/json" id="story">(.*?)</script>', (tmp_path / "report.html").read_text())
    told = json.loads(story.replace("\\u003c", "<"))["estimate"]
    assert {key: told[key] for key in expected} == expected
    assert replayed(ros, bag, friction_model(estimate), tmp_path) == [expected, expected]


def test_a_replay_ends_with_what_the_streams_lack(tmp_path):
    recording = Recording(DEMO)
    bag = recording.write_elsewhere(tmp_path / "bag", recording.without_push(5))
    run = pushfric("replay", bag, "--rate", 10, "--headless")
    said = "push 5 is missing: the ids of the pushes jump"
    assert (run.returncode, said in " ".join(run.stderr.split())) == (1, True), run.stderr
