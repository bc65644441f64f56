"""The region of p_CF from files: its data points, its report, and its command."""

import json

import numpy as np
import pytest
from problems import observations_of

from pushfric_core import TABLE_1, HalfPlanes, Observation, Twist, next_pushes, slip_pushes
from pushfric_core.estimation.region import line_of_motion
from pushfric_core.report.region import narrowed, region_report

NAME = "wood_rect3"
KNOWN = TABLE_1[NAME]
DATA = observations_of(KNOWN.outline, KNOWN.support, KNOWN.mu_c, 8, np.random.default_rng(3))
ABOUT_ITS_CONTACT = Observation((0.02, -0.032), (0.0, -1.0), Twist(-0.032, -0.02, 1.0), push_id=3)


def test_every_data_point_except_a_turn_about_the_contact_narrows():
    warnings: list[str] = []
    half_planes = narrowed(KNOWN.outline, [*DATA[:4], ABOUT_ITS_CONTACT, *DATA[4:]], 0.002, warnings.append)
    expected = HalfPlanes(KNOWN.outline, 0.002)
    for observation in DATA:
        expected.add(line_of_motion(observation))
    assert half_planes.region().polygon.equals(expected.region().polygon)
    assert len(warnings) == 1
    assert "data point of push 3 refused: the object turned about its contact" in warnings[0]


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
