"""The study: one seed of it, and what its report says."""

import itertools
import json

import numpy as np
import pytest

from bench.paper import pushes, study
from pushfric_core.mechanics import simulation


def test_a_seed_finds_what_the_report_says(tmp_path, monkeypatch):
    """Two objects, one with few pushes, and coarser steps of the simulation, which find the same."""
    every = pushes.objects()
    few = every["delrin_rect_right"]._replace(pushes=(3, 1, 3, 1))
    monkeypatch.setattr(study, "objects", lambda: {"delrin_rect_right": few, "ring": every["ring"]})
    monkeypatch.setattr(study, "TABLE_1", {})
    monkeypatch.setattr(simulation, "STEP", 1.2e-3)
    study.study(tmp_path / "out", 1, jobs=1)
    summary = json.loads((tmp_path / "out/study.json").read_text())
    cells = summary["simulated"]
    cases = itertools.product(("delrin_rect_right", "ring"), ("all", "places"), pushes.NOISES)
    assert set(cells) == {"/".join(case) for case in cases}
    for name, cell in cells.items():
        assert (cell["given"], cell["held"]) == (1, 1), name
    assert cells["delrin_rect_right/all/FEET"]["error_median"] < 1.0  # mm
    screened = summary["screened"]
    cases = {*pushes.SPOILT, "none", "shift of 8 mm", "shift of 4 mm"}
    assert set(screened) == {f"{case}/{noise}" for case in cases for noise in pushes.NOISES}
    assert screened["none/FEET"] == {"runs": 1, "found": None, "good": 8, "lost": 0, "changed": 0}
    assert screened["lost contact/FEET"]["found"] == 1
    report = (tmp_path / "out/study.md").read_text()
    for name in (*cells, *screened):
        assert f"| {name} | 1 |" in report


def test_a_moved_load_shifts_the_center_of_friction_as_asked(rng):
    """In every direction that is drawn."""
    studied = pushes.objects()["unequal_feet"]
    before = studied.support.center_of_friction
    for shift in pushes.SHIFTS:
        after = pushes.with_moved_load(studied.support, shift, rng).center_of_friction
        assert np.hypot(*(after - before)) == pytest.approx(shift)


def test_a_summary_counts_only_what_was_told():
    given = {"error": 0.001, "given": True, "held": True, "radius": 0.0015, "middle": 0.0008}
    cell = study._summary([given, {"error": 0.003, "given": False}])
    assert (cell["runs"], cell["given"], cell["held"]) == (2, 1, 1.0)
    assert cell["error_median"] == pytest.approx(2.0)
    assert (cell["middle_to_optimum"], cell["radius_to_errors"]) == (pytest.approx(0.8), pytest.approx(1.875))
    assert np.isfinite(cell["error_p90"])
