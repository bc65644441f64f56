"""What the launch files start, up to ROS 2's own launch."""

import pathlib
import shutil

import pytest

from pushfric_core.errors import InvalidInput
from pushfric_ros.commands.launch_files import CELL, DEMO, REPLAY

ROOT = pathlib.Path(__file__).parents[3]


def started(launchable, folder, **given):
    """The namespace and the nodes, by name, of what a launch file starts with some of its arguments given."""
    defaults = {name: default for name, (default, _) in launchable.arguments.items() if default is not None}
    assert set(launchable.arguments) <= set(defaults) | set(given)
    namespace, specs = launchable.graph({**defaults, **given}, folder)
    return namespace, {spec.name: spec for spec in specs}


@pytest.mark.parametrize(("address", "port"), [("auto", 0), ("9001", 9001)])
def test_each_launch_file_has_a_view_if_it_is_asked_for(tmp_path, address, port):
    for launchable, given in (
        (DEMO, {"bag": str(tmp_path / "bag")}),
        (CELL, {"cell": str(ROOT / "docs/example_cell/cell.yaml"), "bag": "bag"}),
        (REPLAY, {"bag": str(ROOT / "bags/rubber_rect4")}),
    ):
        assert "view" not in started(launchable, tmp_path, **given)[1]
        assert started(launchable, tmp_path, view=address, **given)[1]["view"].parameters["port"] == port


def test_each_launch_file_has_a_planner_if_it_is_asked_for(tmp_path):
    given = {"bag": str(ROOT / "bags/rubber_rect4")}
    assert "planner" not in started(REPLAY, tmp_path, **given)[1]
    assert started(REPLAY, tmp_path, planner="true", **given)[1]["planner"].respawn
    with pytest.raises(InvalidInput, match="planner must be true or false, got 'maybe'"):
        started(REPLAY, tmp_path, planner="maybe", **given)


def test_a_launched_run_leaves_its_result(tmp_path):
    shutil.copytree(ROOT / "bags/rubber_rect4", tmp_path / "bag")
    assert DEMO.found({"bag": str(tmp_path / "bag")}, "/cell") == []
    assert {"report.html", "figure.png", "model.yaml"} <= {path.name for path in (tmp_path / "bag").iterdir()}
    (none,) = DEMO.found({"bag": str(tmp_path / "none")}, "/cell")
    assert none.startswith(f"the bag {tmp_path}/none does not say how the run went: ")


def test_a_cell_starts_where_its_plan_was_left(tmp_path):
    _, nodes = started(CELL, tmp_path, cell=str(ROOT / "docs/example_cell/cell.yaml"), bag="bag", start="3")
    assert nodes["experiment"].parameters["start"] == 3


def test_a_bag_is_replayed_with_its_own_object(tmp_path):
    _, nodes = started(REPLAY, tmp_path, bag=str(ROOT / "bags/rubber_rect4"))
    assert nodes["estimator"].parameters["object"] == str(ROOT / "bags/rubber_rect4/object.yaml")
    assert nodes["player"].parameters["rate"] == 1.0
    assert not nodes["estimator"].parameters["model"]


def test_a_run_that_went_on_from_a_model_is_replayed_from_it(tmp_path):
    bag = shutil.copytree(ROOT / "bags/rubber_rect4", tmp_path / "bag")
    (bag / "prior.yaml").touch()
    assert started(REPLAY, tmp_path, bag=str(bag))[1]["estimator"].parameters["model"] == str(bag / "prior.yaml")
    (bag / "object.yaml").unlink()
    with pytest.raises(InvalidInput, match="does not name the pushed object"):
        started(REPLAY, tmp_path, bag=str(bag))
