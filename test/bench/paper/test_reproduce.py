"""The reproduction of the paper: a real seed on a Dask cluster, checked by other computations; the report."""

import json
import math
import pathlib
import re
import threading

import numpy as np
import pytest
from cluster import local_cluster
from scipy.optimize import linprog

from bench.paper import reproduce
from bench.paper.claims import claims
from bench.paper.experiments import rods
from bench.paper.pushes import SLIPPING, motions, plan, watch
from bench.paper.tables import PUBLISHED, leaves, spread, tables
from pushfric_core.errors import InvalidInput
from pushfric_core.geometry.table_1 import TABLE_1


@pytest.fixture(scope="module")
def reproduced(tmp_path_factory):
    """What `reproduce --seeds 1 --dask ADDRESS` leaves behind, and what the worker process found."""
    out = tmp_path_factory.mktemp("reproduce")
    threads = set(threading.enumerate())
    found = []
    with pytest.MonkeyPatch.context() as patch, local_cluster(tmp_path_factory.mktemp("dask")) as address:
        draw = reproduce.figures
        patch.setattr(reproduce, "figures", lambda tables, seeds, rods: found.extend(seeds) or draw(tables, seeds, rods))
        reproduce.reproduce(out, 1, 1, address)
    # the client's thread pool for large messages stays in the process, idle
    assert {thread.name for thread in set(threading.enumerate()) - threads} <= {"Dask-Offload_0"}
    return out, found


@pytest.fixture(scope="module")
def folder(reproduced):
    return reproduced[0]


@pytest.fixture(scope="module")
def seed(reproduced):
    (one,) = reproduced[1]
    return one


@pytest.fixture(scope="module")
def summary(folder):
    return json.loads((folder / "tables.json").read_text())


def rows_of(data, points):
    """Moments about the contacts and normal forces of unit weights, (m, n) each, from the recorded motions."""
    contact, normal = np.array([[one.contact_point] for one in data]), np.array([one.contact_normal for one in data])
    vx, vy, omega = np.array([one.twist for one in data]).T
    x, y = points.T
    velocity = np.stack((vx[:, None] - omega[:, None] * y, vy[:, None] + omega[:, None] * x), axis=2)
    force = -velocity / np.linalg.norm(velocity, axis=2, keepdims=True)
    arm = points - contact
    return arm[..., 0] * force[..., 1] - arm[..., 1] * force[..., 0], np.sum(force * normal[:, None], axis=2), force


def highs(data, points, center=None, half_width=0.0):
    """w and the fit error [cm] by HiGHS; infinite if infeasible."""
    moment, normal_force, _ = rows_of(data, points)
    m, n = moment.shape
    # m(c-+) = m_c -+ h t x f, and t x f = - f . n; a slack for each side: if h = 0, their sum is |m_c|
    sides = np.vstack((moment - half_width * normal_force, -moment - half_width * normal_force))
    slacks = 2 * m
    upper = np.block([[sides, -np.eye(slacks)], [-normal_force, np.zeros((m, slacks))]])
    equal, right = [np.append(np.ones(n), np.zeros(slacks))], [1.0]
    if center is not None:
        equal += [np.append(axis, np.zeros(slacks)) for axis in points.T]
        right += list(center)
    cost = np.append(np.zeros(n), np.ones(slacks))
    result = linprog(cost, A_ub=upper, b_ub=np.zeros(len(upper)), A_eq=np.array(equal), b_eq=right, method="highs")
    return (result.x[:n], 100 * result.fun) if result.status == 0 else (None, math.inf)


@pytest.mark.parametrize(
    ("table", "name", "published"), [("table4", "delrin_rect_center", 36), ("table5", "delrin_rect_right", 32)]
)
@pytest.mark.parametrize("grid", [(2, 2), (3, 3), (5, 3), (6, 4)])
def test_tables_4_and_5_agree_with_highs(seed, table, name, published, grid):
    data = seed.data[name]
    points = TABLE_1[name].outline.grid(*grid)
    row = seed.numbers[table][f"grid_{len(points)}"]
    for hypothesis, x in (("left", -0.007), ("center", 0.0), ("right", 0.007)):
        _, error = highs(data, points, (x, 0.0))
        assert row[f"error_{hypothesis}"] == pytest.approx(error * published / len(data), rel=1e-6)


@pytest.mark.parametrize("name", ["delrin_rect_center", "delrin_rect_right"])
def test_table_2_agrees_with_highs(seed, name):
    known = TABLE_1[name]
    w, _ = highs(seed.data[name], known.support_points)
    center = w @ known.support_points
    x, y = 100 * np.abs(center - known.support.center_of_friction) / np.ptp(known.outline.vertices, axis=0)
    expected = {"x": 100 * center[0], "y": 100 * center[1], "percent_x": x, "percent_y": y}
    assert seed.numbers["table2"][name]["grid_24"] == pytest.approx(expected, abs=1e-5)


def test_table_3_agrees_with_highs(seed):
    data, points = seed.data["rubber_rect4"], TABLE_1["rubber_rect4"].support.points
    w, _ = highs(data, points)
    _, normal_force, force = rows_of(data, points)
    total = np.einsum("mnk,n->mk", force, w)
    bounds = np.sort(np.abs(np.linalg.norm(total, axis=1) ** 2 - (normal_force @ w) ** 2) ** 0.5 / (normal_force @ w))
    expected = {"p90": bounds[math.ceil(0.9 * len(bounds)) - 1], "p100": bounds[-1]}
    assert seed.numbers["table3"]["rubber_rect4"] == pytest.approx(expected, rel=1e-5)
    assert np.sort(seed.bounds["rubber_rect4"]) == pytest.approx(bounds, abs=1e-5)


@pytest.mark.parametrize("half_width", [0, 4, 8])
@pytest.mark.parametrize("turn", [0, 180])
def test_figure_9_agrees_with_highs(seed, half_width, turn):
    feet = TABLE_1["wood_rect3"].support.points * (-1 if turn else 1)
    for case, center in (("supports", None), ("supports_and_center", (0.0, 0.0))):
        _, error = highs(seed.data["wood_rect3"], feet, center, half_width / 1e3)
        known = seed.numbers["figure9"][case][f"half_width_{half_width}_mm"][f"error_{turn}"]
        assert known == pytest.approx(error, rel=1e-6, abs=1e-9)


@pytest.mark.parametrize("name", ["wood_rect4", "rubber_rect4"])
def test_figure_5_agrees_with_highs(seed, name):
    w, _ = highs(seed.data[name], TABLE_1[name].support_points)
    (found,) = (one.w for one in seed.weights["figure5"] if one.name == name)
    assert found == pytest.approx(w, abs=1e-6)
    assert sorted(np.argsort(w)[-4:]) == [0, 4, 10, 14]  # the corners of five columns in three rows
    assert seed.numbers["figure5"][name]["corners_are_top_four"]


def test_the_same_seed_repeats_the_same_pushes(seed):
    again = watch("delrin_rect_center", motions("delrin_rect_center", plan("delrin_rect_center"), 0), 0)
    assert again == seed.data["delrin_rect_center"]
    assert len(again) == seed.numbers["table1"]["delrin_rect_center"]["data_points"]


def test_pushes_are_as_many_as_the_papers_and_stay_on_their_edges():
    for name, known in TABLE_1.items():
        pushes = plan(name)
        assert len(pushes) == {"delrin_square3": 20}.get(name, 14)
        assert all(abs(push.offset) < known.outline.lengths[push.edge] / 2 for push in pushes)
        assert sum(push.offset for push in pushes) == pytest.approx(0, abs=1e-12)


def test_the_bad_push_is_an_outlier_and_the_test_pushes_slip(seed):
    table = seed.numbers["table3"]
    assert table["wood_rect4_all_data"]["bad_data_points"] == 6
    assert table["wood_rect4_all_data"]["p100"] > 2 * table["wood_rect4"]["p100"]
    # each push slips, so each lower bound is mu_c itself, except for the noise
    assert table["rubber_rect4_slipping"]["low"] == pytest.approx(0.9, abs=0.3)
    assert table["rubber_rect4_slipping"]["high"] == pytest.approx(0.9, abs=0.4)
    assert all(math.tan(abs(push.angle)) > 0.9 for push in SLIPPING)


def test_the_two_rods_reach_the_same_wrenches():
    numbers, drawings = rods()
    assert numbers["largest_difference_of_reachable_wrenches"] == pytest.approx(0, abs=1e-9)
    # a turn about the middle: half the friction times the length for two supports, two thirds of it for three
    assert [section[:, 1].max() for section, _ in drawings] == pytest.approx([1.0, 2 / 3])


def test_the_summary_is_the_median_over_the_seeds_next_to_the_paper(seed, summary):
    """Of the seed and of another, which finds larger errors and not the feet."""
    other = json.loads(json.dumps(seed.numbers))
    other["table4"]["grid_24"]["error_center"] += 0.5
    other["figure5"]["wood_rect4"]["corners_are_top_four"] = False
    both = tables([seed.numbers, other])
    found = seed.numbers["table4"]["grid_24"]["error_center"]
    leaf = both["table4"]["grid_24"]["error_center"]
    assert leaf["median"] == pytest.approx(found + 0.25)
    assert (leaf["paper"], leaf["reference"], leaf["seeds"]) == (4.6, 4.5, 2)
    assert both["figure5"]["wood_rect4"]["corners_are_top_four"] == {"held": 1, "of": 2, "paper": True}
    assert summary["table4"]["grid_24"]["error_center"]["median"] == found
    assert summary["seeds"] == 1


def test_quartiles_are_order_statistics_and_may_be_infinite():
    assert spread([1.0, 2.0, 3.0, 4.0, 5.0]) == (3.0, 2.0, 4.0)
    assert spread([1.0, 2.0, 3.0, math.inf]) == (2.5, 1.75, math.inf)
    assert spread([math.inf, math.inf]) == (math.inf, math.inf, math.inf)
    values = np.random.default_rng(0).normal(size=20)
    assert spread(values) == pytest.approx(np.percentile(values, (50, 25, 75)))


def test_the_report_holds_everything(folder, summary):
    page = (folder / "report.md").read_text()
    for title in ("Table 1", "Table 2", "Table 3", "Table 4", "Table 5", "Section 6.2"):
        assert f"## {title}" in page
    drawn = {path.name for path in (folder / "figures").iterdir()}
    assert set(re.findall(r"\(figures/(.*?)\)", page)) == drawn
    assert drawn == {f"figure{number}.svg" for number in (3, *range(5, 14))} | {"table2.svg", "test_pushes.svg"}
    assert all(b"<svg " in (folder / "figures" / name).read_bytes() for name in drawn)
    assert not {"nan", "None", "inf"} & set(re.findall(r"\w+", page))
    found = summary["table4"]["grid_9"]["error_center"]
    heads, *_ = [line for line in page.splitlines() if line.startswith("|  | error, the paper")]
    line = next(line for line in page[page.index(heads) :].splitlines() if line.startswith("| grid_9, center |"))
    place = heads.split(" | ").index("error, here")
    assert line.split(" | ")[place].strip("*") == f"{found['median']:.2f}"
    assert line.split(" | ")[place - 2] == f"{found['paper']:.2f}"
    assert len(summary["claims"]) == 6
    for claim in summary["claims"]:
        low, high = claim["spread"]
        (line,) = [line for line in page.splitlines() if line.startswith(f"| {claim['text']} |")]
        assert (f"in {100 * low:.0f} to {100 * high:.0f} % of all seeds" if claim["about_seeds"] else f"| {low:.0f}") in line


def test_the_documentation_names_every_key(summary):
    text = (pathlib.Path(__file__).parents[3] / "docs/paper.md").read_text()
    for path, _ in leaves(summary):
        assert f"`{path[0]}`" in text
        assert re.sub(r"\d+", "N", path[-1]) in re.sub(r"\d+", "N", text)


def test_a_claim_says_how_much_of_it_is_chance():
    """Five seeds with the paper's numbers, except for three ratios that two seeds find twice as large."""
    seeds = [json.loads(json.dumps(PUBLISHED["paper"])) for _ in range(5)]
    for index, numbers in enumerate(seeds):
        for grid, ratio in (("grid_9", 2.0), ("grid_15", 2.5), ("grid_24", 2.9)):
            numbers["table4"][grid] |= {"ratio_left": ratio * (1.0 if index < 3 else 2.0), "ratio_right": ratio}
        numbers["table5"]["grid_24"] |= {"ratio_left": 4.5, "ratio_center": 2.3}
        numbers["figure5"]["wood_rect4"]["corners_are_top_four"] = index > 0
    found = {claim.text: claim for claim in claims(seeds)}
    near = next(claim for text, claim in found.items() if text.endswith("of the reference") and "ratios" in text)
    assert (near.held, near.of, near.reproduced) == (8, 8, True)
    # the three ratios stand or fall together: P(at most 2 of 5 drawn seeds are close) = .317
    assert near.spread == (5, 8)
    feet = next(claim for text, claim in found.items() if "four feet" in text)
    assert (feet.held, feet.of, feet.asked, feet.reproduced) == (4, 5, 5, False)
    low, high = feet.spread
    # Clopper-Pearson: 4 or more of 5 has a probability of 5 % at the lower end, 4 or fewer at the upper one
    assert low**5 + 5 * low**4 * (1 - low) == pytest.approx(0.05)
    assert high**5 == pytest.approx(0.95)
    paper = next(claim for text, claim in found.items() if text.endswith("of the paper"))
    assert (paper.asked, paper.of) == (None, 12)


def test_unusable_input_is_named(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(InvalidInput, match="file: the folder cannot be created"):
        reproduce.reproduce(tmp_path / "file", 1, 1, None)
