"""Input files: objects, observations, support points, plans, cells."""

import dataclasses
import math
import os
import typing
from unittest.mock import Mock

import numpy as np
import pytest
import yaml
from problems import save_csv

from pushfric_core import TABLE_1, InvalidInput, Outline
from pushfric_core.cell.cell_file import SECTIONS, driver_kinds, load_cell
from pushfric_core.cell.node_settings import ImagesConfig
from pushfric_core.estimation.push_plan import PlannedPush
from pushfric_core.files.csv_files import MOVED, TURNED, read_edge_pushes, read_observations, read_point_pushes
from pushfric_core.files.disk import write_whole
from pushfric_core.files.object_file import load_object, read_points, save_object
from pushfric_core.files.plan_file import load_plan, save_plan
from pushfric_core.settings import key_of
from pushfric_core.vision.board import Board
from pushfric_core.vision.printed_pdf import save_board
from pushfric_ros.graph import graph

TRIANGLE = "name: triangle\noutline: [[0, 0], [0.15, 0], [0, 0.15]]\n"
HEADER = "contact_x,contact_y,normal_x,normal_y,vx,vy,omega,push_id\n"
ROW = "0.05,0,0,-1,0.001,0.02,0.1,3\n"
OUTLINE = Outline(np.array(((0, 0), (0.15, 0), (0, 0.15))))
CELL = """
object: rubber_rect4
camera: {calibration: camera.yaml}
pusher: {port: /dev/ttyUSB0, line_origin: [0, 0], line_direction: [0, 1], tip_radius: 0.003, stroke: 0.06, max_speed: 0.1}
"""


@pytest.fixture
def write(tmp_path):
    def write(text, name="file.yaml"):
        path = tmp_path / name
        path.write_text(text)
        return path

    return write


@pytest.mark.parametrize("name", TABLE_1)
def test_objects_of_table_1_are_known_by_name(name):
    model = load_object(name)
    assert np.array_equal(model.support_points, TABLE_1[name].support_points)
    assert model.outline == TABLE_1[name].outline


@pytest.mark.parametrize(
    ("support", "points"),
    [
        ("support: {grid: [10, 10], inset: 0.0075}", 55),
        ("support: {points: [[0.03, 0.03], [0.09, 0.03], [0.03, 0.09]]}", 3),
        ("support: {spacing: 0.05}", 10),
        ("", 21),
    ],
)
def test_supports_are_given_in_three_ways_or_not_at_all(write, support, points):
    assert len(load_object(str(write(TRIANGLE + support))).support_points) == points


def test_an_object_survives_its_file(write, tmp_path):
    model = load_object(str(write(TRIANGLE + "support: {grid: [4, 4], inset: 0.01}\nheight: 0.02")))
    save_object(model, tmp_path / "copy.yaml")
    again = load_object(str(tmp_path / "copy.yaml"))
    assert again.file == model.file
    assert again.height == 0.02


@pytest.mark.parametrize(
    ("text", "error"),
    [
        ("name: x\n", "file.yaml: outline: expected a value, got only name$"),
        ("name: x\noutline: [[0, 0], [1, 1], [1, 0], [0, 1]]", "simple polygon"),
        (TRIANGLE + "support: {grid: [4, 4], spacing: 0.1}", "exactly one of grid, points and spacing"),
        (TRIANGLE + "support: {spacing: 1e-320}", "spacing must give at most 300 points a row, got 9.99989e-321 m$"),
        (TRIANGLE + "support: {grid: [0, 4]}", "at least 1 column"),
        ("name: x\noutline: [[9, 9], [10, 9], [9, 10]]\nsupport: {points: [[9, 9], [0, 0]]}", r"outline, got \(0, 0\) m$"),
        (
            TRIANGLE + "support: {points: [[0.02, 0.01], [0.02, 0.01]]}",
            r"the support points must differ, got only \(0.02, 0.01\)$",
        ),
        (
            TRIANGLE + "supports: 3",
            "yaml: expected any of the keys name, outline, support, height, hypotheses, got supports$",
        ),
        (TRIANGLE + f"support: {list(range(99))}", r"support: expected keys with values, got \[0, 1, .*, 2\.\.\.$"),
        (TRIANGLE + "support: {spacing: 0.1}\nsupport: {spacing: 0.2}", "not YAML: line 4: the key 'support' is given twice"),
        ("name: 2020-13-45", "not YAML: month must be in 1..12"),
        ("", "yaml: expected keys with values, got nothing$"),
        ("root:x:0", "yaml: expected keys with values, got other content$"),
    ],
)
def test_bad_objects_are_refused_in_one_line(write, text, error):
    path = write(text)
    with pytest.raises(InvalidInput, match=error) as refusal:
        load_object(str(path))
    assert str(path) in str(refusal.value)
    assert "\n" not in str(refusal.value)


def test_observations_are_read_in_order(write):
    text = (
        HEADER.strip()
        + ",half_width,note,force_x,force_y\n0.05,0,0,-1,0.001,0.02,0.1,3,0.002,hello,1,2\n0.05,0,0,-1,0,0.02,0,4,,,,\n"
    )
    first, second = read_observations(write(text, "data.csv"), OUTLINE)
    assert first.twist == (0.001, 0.02, 0.1)
    assert (first.push_id, first.half_width, first.force) == (3, 0.002, (1.0, 2.0))
    assert (second.push_id, second.half_width, second.force) == (4, 0.0, None)


@pytest.mark.parametrize(
    ("text", "error"),
    [
        ("contact_x,contact_y\n1,2\n", "missing column normal_x, normal_y, vx, vy, omega, push_id; expected contact_x"),
        (HEADER + ROW + ROW.replace("0.02", "fast"), "line 3: vy must be a number, got 'fast'"),
        (HEADER + ROW.replace("-1", "-0.5"), "line 2: normal_x, normal_y must have length 1"),
        (
            HEADER + ROW.replace("0.05", "0.5"),
            r"line 2: contact_x, contact_y must be within 5 mm of the outline, got \(0.5, 0\) m",
        ),
        (
            HEADER.strip() + ",tip_vx,tip_vy,force_x,force_y\n" + ROW.strip() + ",1,1,1e10,0\n",
            "line 2: force_x, force_y must lie within",
        ),
        (HEADER + ROW.replace("0.05", "0.0_5"), "line 2: contact_x must be a number, got '0.0_5'"),
        (HEADER + "0.05,0,0,-1,0,1\n", "line 2: expected 8 values, as the first line has names, got 6"),
        (HEADER + ROW + ROW.strip() + ",5\n", "line 3: expected 8 values, as the first line has names, got 9"),
        (
            HEADER.strip() + ",note,vy,note\n" + ROW.strip() + ",a,0.3,b\n",
            "data.csv: expected each column once, got more of note, vy",
        ),
        (HEADER.strip() + ",force_x\n" + ROW.strip() + ",1\n", "both of force_x and force_y"),
        (HEADER.strip() + ",stamp\n" + ROW.strip() + ",1.5\n", "stamp must be a whole number of nanoseconds, got '1.5'"),
    ],
)
def test_bad_observations_are_refused_in_one_line(write, text, error):
    path = write(text, "data.csv")
    with pytest.raises(InvalidInput, match=error) as refusal:
        read_observations(path, OUTLINE)
    assert str(path) in str(refusal.value)


def test_a_file_that_is_not_text_is_refused(tmp_path):
    (tmp_path / "data.csv").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(InvalidInput, match="cannot be read"):
        read_observations(tmp_path / "data.csv", OUTLINE)


@pytest.mark.parametrize(
    "read",
    [
        load_cell,
        lambda path: load_plan(str(path), load_object("wood_rect4")),
        read_points,
        lambda p: read_observations(p, OUTLINE),
    ],
)
def test_a_file_that_is_missing_is_named_once(tmp_path, read):
    with pytest.raises(InvalidInput) as refusal:
        read(tmp_path / "none.yaml")
    assert str(refusal.value) == f"{tmp_path}/none.yaml: cannot be read: No such file or directory"


def test_a_link_and_a_pipe_stay_where_a_file_is_written(tmp_path, monkeypatch):
    (tmp_path / "link.json").symlink_to(tmp_path / "there.json")
    (tmp_path / "there.json").touch(0o600)
    write_whole(tmp_path / "link.json", "1")
    assert ((tmp_path / "link.json").is_symlink(), (tmp_path / "there.json").read_text()) == (True, "1")
    assert (tmp_path / "there.json").stat().st_mode & 0o777 == 0o600
    with monkeypatch.context() as patch:
        patch.setattr(os, "fsync", Mock(side_effect=KeyboardInterrupt))
        with pytest.raises(KeyboardInterrupt):
            write_whole(tmp_path / "there.json", "2")
    assert [one.name for one in tmp_path.glob("*there*")] == ["there.json"]
    os.mkfifo(tmp_path / "pipe")
    with open(os.open(tmp_path / "pipe", os.O_RDONLY | os.O_NONBLOCK)) as reader:
        write_whole(tmp_path / "pipe", "2")
        assert reader.read() == "2"
    assert (tmp_path / "pipe").is_fifo()
    (tmp_path / f".board.pdf.{os.getpid()}").symlink_to("/dev/full")  # the draft of a figure
    with pytest.raises(InvalidInput, match=r"board\.pdf: cannot be written: No space left on device$"):
        save_board(Board(), tmp_path / "board.pdf")
    assert not (tmp_path / "board.pdf").exists()


def test_a_plan_is_read(write):
    plan = load_plan(str(write("pushes: [{edge: 0, offset: 0.02}, {edge: 2, angle_deg: -30}]")), load_object("wood_rect4"))
    assert plan == [(0, 0.02, 0.0), (2, 0.0, pytest.approx(math.radians(-30)))]


def test_a_plan_survives_its_file(tmp_path):
    pushes = [PlannedPush(0, -0.03175), PlannedPush(3, 0.012, math.radians(-20.5)), PlannedPush(2, 0.0)]
    save_plan(pushes, tmp_path / "plan.yaml")
    again = load_plan(str(tmp_path / "plan.yaml"), load_object("wood_rect4"))
    assert [tuple(push) for push in again] == [pytest.approx(tuple(push), abs=1e-15) for push in pushes]


def test_without_a_file_the_plan_is_that_of_the_paper(write):
    assert len(load_plan("", load_object("rubber_rect4"))) == 14
    assert len(load_plan("", load_object("delrin_square3"))) == 20
    assert len(load_plan("", load_object(str(write(TRIANGLE))))) == 15


@pytest.mark.parametrize(
    ("text", "error"),
    [
        ("pushes: [{edge: 4}]", r"pushes.0: edge must lie in \[0, 3\], got 4"),
        ("pushes: [{edge: 0}, {edge: 1, offset: 0.04}]", "pushes.1: offset must lie within 0.032 m of the middle of edge 1"),
        ("pushes: [{edge: 0, angle_deg: 95}]", "pushes.0: angle must lie within 90 degrees of the inward normal"),
    ],
)
def test_bad_plans_are_refused(write, text, error):
    with pytest.raises(InvalidInput, match=error):
        load_plan(str(write(text)), load_object("wood_rect4"))


def test_a_cell_finds_its_files_in_its_own_folder(write, tmp_path):
    write("", "camera.yaml")
    cell = load_cell(write(CELL, "cell.yaml"))
    assert cell.camera.calibration == str(tmp_path / "camera.yaml")
    assert cell.object == "rubber_rect4"
    assert cell.plan.distance == 0.05


@pytest.mark.parametrize(
    ("text", "error"),
    [
        (
            CELL.replace("port: /dev/ttyUSB0, ", ""),
            "cell.yaml: pusher: port must be given: serial port of the controller",
        ),
        (CELL.replace("[0, 1]", "[0, 0]"), r"pusher: line_direction must have a length, got \(0, 0\)"),
        (CELL.replace("[0, 1]", "[0, .nan]"), "pusher: line_direction "),
        (CELL.replace("line_origin: [0, 0]", "line_origin: [0]"), "pusher: line_origin "),
        (CELL + "namespace: my cell", "yaml: namespace must be like /cell or /hall/cell_2, got 'my cell'$"),
        (CELL + "recorder: {topics: [tf]}", r"recorder: topics must be 'name .*', got 'tf'$"),
        ("object: rubber_rect4", "camera: calibration must be given: path of the camera's calibration YAML"),
        (
            CELL + "table: 3",
            "yaml: expected any of namespace, discovery, frame_prefix, object, camera, .*, simulation, got table$",
        ),
        (CELL.replace("pusher:", "pushr:"), "yaml: expected any of .*, simulation, got pushr$"),
        (
            CELL + "plan: {distance: 0.08}",
            "yaml: plan: distance must be at most 0.06, as stroke and max_distance allow, got 0.08$",
        ),
        (
            CELL.replace("stroke: 0.06", "stroke: 0.06, max_distance: 0.04"),
            "plan: distance must be at most 0.04, as stroke and max_distance allow, got 0.05$",
        ),
        (CELL + "plan: {speed: 0.2}", "plan: speed must be at most 0.1, as max_speed allows, got 0.2$"),
        (CELL + "plan: {file: plan.yaml, choose: 5}", "plan: give a plan's file or choose, not both, got '.*plan.yaml' and 5$"),
    ],
)
def test_bad_cells_are_refused(write, text, error):
    with pytest.raises(InvalidInput, match=error):
        load_cell(write(text, "cell.yaml"))


@pytest.mark.parametrize("section", SECTIONS)
def test_every_range_holds_in_a_cell_as_in_the_node(write, section):
    path = write(CELL, "cell.yaml")
    content = yaml.safe_load(CELL) | ({"tip": {"tip_radius": 0.003}} if section == "tip" else {})
    configs = *SECTIONS[section], *driver_kinds(section, {})
    fields = [field for config in configs for field in dataclasses.fields(config)]
    hints = {name: hint for config in configs for name, hint in typing.get_type_hints(config).items()}
    limited = [field for field in fields if field.metadata["high"] not in (None, math.inf)]
    assert limited or section == "recorder"
    for field in limited:
        beyond, name = 2 * field.metadata["high"], key_of(field)
        if typing.get_origin(hints[field.name]) is tuple:
            items = typing.get_args(hints[field.name])
            beyond = [beyond] * (3 if items[-1] is Ellipsis else len(items))
        path.write_text(yaml.safe_dump(content | {section: content.get(section, {}) | {name: beyond}}))
        with pytest.raises(InvalidInput) as refusal:
            load_cell(path)
        assert str(refusal.value).startswith(f"{path}: {section}: {name} must lie in [")
        got = tuple(beyond) if isinstance(beyond, list) else beyond
        assert str(refusal.value).partition(": are these")[0].endswith(f", got {got}")


def test_every_setting_of_a_cell_reaches_its_node(write):
    text = CELL + "plan: {still: 2}\nrecorder: {topics: [tf tf2_msgs/msg/TFMessage reliable]}\nestimator: {stride: 3}\n"
    cell = load_cell(write(text.replace("{port", "{poll_rate: 40, port"), "cell.yaml"))
    nodes = {spec.name: spec.parameters for spec in graph.cell(cell, "bag", 4)}
    assert nodes["actuator"]["poll_rate"] == 40.0
    assert (nodes["experiment"]["still"], nodes["experiment"]["start"]) == (2.0, 4)
    assert nodes["estimator"]["stride"] == 3
    assert nodes["recorder"]["topics"][-1] == "tf tf2_msgs/msg/TFMessage reliable"
    for name, section in {"tracker": "camera", "actuator": "pusher", "experiment": "plan", "recorder": "recorder"}.items():
        kinds = [*SECTIONS[section], *driver_kinds(section, {"tracker": "contour"})]
        if name == "recorder":  # the tracker chooses the images
            kinds.remove(ImagesConfig)
            assert nodes["tracker"]["images"] == "keyframes"
        assert {field.name for kind in kinds for field in dataclasses.fields(kind)} <= set(nodes[name])


def test_a_topic_of_the_cell_cannot_be_recorded_twice(write):
    cell = load_cell(write(CELL + "recorder: {topics: [observation std_msgs/msg/String reliable]}\n", "cell.yaml"))
    with pytest.raises(InvalidInput, match=r"recorder: topics must name each topic once, got object_pose, .*, observation$"):
        graph.cell(cell, "bag")


def test_a_cells_estimator_section_becomes_parameters(write):
    text = CELL + "estimator: {cor_radius: auto, half_width: 0, window: 7, terms: [moment, cone], mu_bound: 1}\n"
    parameters = load_cell(write(text)).estimator.parameters()
    expected = {"cor_radius": "auto", "half_width": 0.0, "window": 7, "terms": ["moment", "cone"], "mu_bound": 1.0}
    assert parameters | expected == parameters
    assert isinstance(parameters["half_width"], float)  # the type that a node needs


PLATE = Outline.rectangle(0.1, 0.06)


def test_columns_may_stand_in_any_order_with_others(tmp_path):
    columns = ("note", *reversed(TURNED))
    path = save_csv(tmp_path / "pushes.csv", columns, ("x", -1, 0.3, 0.2, 0.01, -1, 0, -0.03, 0.02))
    pushes = read_edge_pushes(path, PLATE)
    assert np.array_equal(pushes.contact_points, [[0.02, -0.03]])
    assert np.array_equal(pushes.contact_normals, [[0, -1]])
    assert (pushes.half_widths[0], pushes.turns[0]) == (0.01, -1)
    assert np.array_equal(pushes.centers, [[0.2, 0.3]])


@pytest.mark.parametrize(
    ("row", "expected"),
    [
        ((0, -0.03, 0, -1, 0, "inf"), "line 2: tip_vy must be finite"),
        ((0, -0.03, 0, -1, 0, 1e200), "line 2: tip_vy must lie within 10 m/s, got 1e\\+200"),
        ((0, -0.03, 0, -2, 0, 1), "line 2: the normal must have length 1"),
        ((0, -0.3, 0, -1, 0, 1), "line 2: the contact must be within 5 mm of the outline"),
        ((1e308, -0.03, 0, -1, 0, 1), "line 2: contact_x must lie within 100 m, got 1e\\+308"),
        ((0, -0.03, 0, 1, 0, 1), r"line 2: the normal must point outward, away from the object, got \(0, 1\)"),
    ],
)
def test_a_wrong_row_is_named(tmp_path, row, expected):
    path = save_csv(tmp_path / "pushes.csv", MOVED, row)
    with pytest.raises(InvalidInput, match=expected):
        read_point_pushes(path, PLATE)


def test_a_wrong_file_is_named(tmp_path):
    with pytest.raises(InvalidInput, match="missing column tip_vy; expected contact_x"):
        read_point_pushes(save_csv(tmp_path / "pushes.csv", MOVED[:-1]), PLATE)
    with pytest.raises(InvalidInput, match="no pushes; expected a row for each"):
        read_point_pushes(save_csv(tmp_path / "pushes.csv", MOVED), PLATE)
    contact = (0, -0.03, 0, -1)
    with pytest.raises(InvalidInput, match="line 2: half_width must be at least 0"):
        read_edge_pushes(save_csv(tmp_path / "pushes.csv", TURNED, (*contact, -0.01, 0, 0, 1)), PLATE)
    with pytest.raises(InvalidInput, match=r"line 2: turn must be \+1 \(counter-clockwise\) or -1, got 0"):
        read_edge_pushes(save_csv(tmp_path / "pushes.csv", TURNED, (*contact, 0.01, 0, 0, 0)), PLATE)
