"""The commands that plan and narrow down: region, and what estimate says and draws of mu_c."""

import json

import numpy as np
import pytest
from calls import printed
from problems import narrowed, observations_of, save_observations

from pushfric_core import TABLE_1, Estimator, HalfPlanes, InvalidInput, Observation, Twist, next_pushes, slip_pushes
from pushfric_core.commands.region import region_report
from pushfric_core.estimation.push_choice import planned_pushes
from pushfric_core.estimation.region import RegionConfig
from pushfric_core.files.object_file import load_object
from pushfric_core.files.plan_file import load_plan

NAME = "wood_rect3"
KNOWN = TABLE_1[NAME]
DATA = observations_of(KNOWN.outline, KNOWN.support, KNOWN.mu_c, 8, np.random.default_rng(3))


@pytest.fixture
def data(tmp_path):
    return save_observations(tmp_path / "data.csv", DATA)


def said(*arguments):
    return printed(*arguments, "--object", NAME)


def test_the_region_is_that_of_the_data_points(data):
    figures = json.loads(said("region", data, "--json"))
    half_planes = narrowed(KNOWN.outline, RegionConfig.region_margin, DATA)
    region = half_planes.region()
    assert figures["area"] == region.area < 0.6 * KNOWN.outline.polygon.area
    assert figures["polygon"] == region.corners.tolist()
    assert figures["center_of_friction"] == region.center.tolist()
    assert (figures["object"], figures["data_points"], figures["pushes"], figures["collapsed"]) == (NAME, 8, 8, False)
    assert [push["expected_area"] for push in figures["next_pushes"]] == [one.expected_area for one in next_pushes(half_planes)]
    assert f"region {region.area * 1e4:.3g} cm^2" in said("region", data)


def test_a_plan_is_written_over_another_file_only_by_force(tmp_path):
    plan = tmp_path / "README.md"
    plan.write_text("read me")
    with pytest.raises(InvalidInput, match=f"{plan} exists: give --force, or another FILE"):
        said("region", "--plan", plan)
    assert plan.read_text() == "read me"
    said("region", "--plan", plan, "--force", "--pushes", 1)
    assert len(load_plan(str(plan), load_object(NAME))) == 1


def test_margin_and_excluded_pushes_count(data):
    figures = json.loads(said("region", data, "--region-margin", 0, "--exclude-push", 2, "--exclude-push", 5, "--json"))
    kept = [observation for observation in DATA if observation.push_id not in (2, 5)]
    assert figures["area"] == narrowed(KNOWN.outline, 0.0, kept).region().area
    assert figures["pushes"] == 6


def test_without_data_a_plan_is_made_for_the_whole_outline(tmp_path):
    said("region", "--plan", tmp_path / "plan.yaml", "--pushes", 5)
    expected = [one.push for one in planned_pushes(HalfPlanes(KNOWN.outline, RegionConfig.region_margin), 5)]
    assert load_plan(str(tmp_path / "plan.yaml"), load_object(NAME)) == expected


def test_after_data_it_is_made_for_the_region_that_is_left(data, tmp_path):
    said("region", data, "--plan", tmp_path / "plan.yaml")
    half_planes = narrowed(KNOWN.outline, RegionConfig.region_margin, DATA)
    expected = [one.push for one in planned_pushes(half_planes, 10)]
    assert load_plan(str(tmp_path / "plan.yaml"), load_object(NAME)) == expected


def test_a_collapsed_region_says_so(tmp_path):
    """One push says that p_CF lies to its right, another, 4 cm further left, that it lies to its left."""
    pushes = [
        Observation((x, -0.032), (0.0, -1.0), Twist(0.0, 0.02, omega), push_id)
        for push_id, (x, omega) in enumerate(((-0.01, -0.1), (-0.05, 0.1)))
    ]
    path = save_observations(tmp_path / "data.csv", pushes)
    figures = json.loads(said("region", path, "--json"))
    assert (figures["collapsed"], figures["area"], figures["polygon"], figures["next_pushes"]) == (True, 0.0, [], [])
    assert figures["violation"] > 0.01
    assert "collapsed: the observations contradict each other" in said("region", path)
    with pytest.raises(InvalidInput, match="no push is worth planning; try a larger --region-margin"):
        said("region", path, "--plan", tmp_path / "plan.yaml")


def test_slipping_pushes_give_mu_c_itself(data, tmp_path):
    figures = json.loads(said("estimate", data, "--slipping-push", 1, "--slipping-push", 4, "--json"))
    estimate = Estimator(load_object(NAME).support_points).add(DATA)
    slipping = estimate.contact_friction[[1, 4]]
    assert figures["mu_c"]["slipping"] == [slipping.min(), slipping.max()]
    assert figures["w"] == estimate.w.tolist()  # of all observations
    assert "in the pushes that slipped" in said("estimate", data, "--slipping-push", 1, "--figure", tmp_path / "figure.png")
    assert (tmp_path / "figure.png").read_bytes().startswith(b"\x89PNG")
    assert "slipping" not in json.loads(said("estimate", data, "--json"))["mu_c"]


def test_the_report_is_plain_and_complete():
    half_planes = HalfPlanes(KNOWN.outline)
    region, slips = half_planes.region(), slip_pushes(KNOWN.outline, (0.0, 0.0))
    figures = json.loads(json.dumps(region_report(region, next_pushes(half_planes), slips)))
    assert [list(push.values()) for push in figures["slip_pushes"]] == [list(push) for push in slips]
    assert figures["area"] == pytest.approx(0.127 * 0.064)
    assert np.ptp(figures["polygon"], axis=0).tolist() == pytest.approx([0.127, 0.064])
    assert figures["center_of_friction"] == pytest.approx([0.0, 0.0])
    assert (figures["collapsed"], figures["violation"]) == (False, 0.0)
    first = figures["next_pushes"][0]
    assert first == {"edge": 0, "offset": 0.0, "angle": 0.0, "expected_area": pytest.approx(0.127 * 0.064 / 2)}
    assert [push["edge"] for push in figures["next_pushes"]] == [0, 2, 1, 3]
