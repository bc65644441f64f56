"""The region of p_CF from files: its observations, its report, and its command."""

import json

import numpy as np
import pytest

from pushfric_core import TABLE_1, HalfPlanes, next_pushes, slip_pushes
from pushfric_core.commands.region import region_report

NAME = "wood_rect3"
KNOWN = TABLE_1[NAME]


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
