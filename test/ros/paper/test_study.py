"""The study: one seed of it, and what its report says."""

import json

import numpy as np
import pytest
from rich.console import Console

from pushfric_core.errors import InvalidInput
from pushfric_ros.paper import study


def test_a_seed_finds_what_the_report_says(tmp_path, monkeypatch):
    objects = {"delrin_rect_right": study._objects()["delrin_rect_right"]}
    monkeypatch.setattr(study, "_objects", lambda: objects)
    monkeypatch.setattr(study, "TABLE_1", {})
    summary = study.study(tmp_path / "out", 1, None, 1, None, Console(quiet=True))
    assert json.loads((tmp_path / "out/study.json").read_text()) == summary
    cells = summary["simulated"]
    assert set(cells) == {
        f"delrin_rect_right/{plan}/{noise}" for plan in ("all", "eight", "one_place") for noise in study.NOISES
    }
    for name, cell in cells.items():
        assert cell["told"] == (0 if "one_place" in name else 1), name
    assert cells["delrin_rect_right/all/FEET"]["error_median"] < 1.0  # mm
    report = (tmp_path / "out/study.md").read_text()
    for name in cells:
        assert f"| {name} | 1 |" in report
    assert summary["cost"]["plain_from_50"] > 0


def test_a_summary_counts_only_what_was_told():
    told = {"error": 0.001, "told": True, "held": True, "radius": 0.0015, "middle": 0.0008}
    cell = study._summary([told, {"error": 0.003, "told": False}])
    assert (cell["runs"], cell["told"], cell["held"]) == (2, 1, 1.0)
    assert cell["error_median"] == pytest.approx(2.0)
    assert (cell["middle_to_optimum"], cell["radius_to_errors"]) == (pytest.approx(0.8), pytest.approx(1.5))
    assert np.isfinite(cell["error_p90"])


def test_a_folder_that_cannot_be_made_is_refused(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(InvalidInput, match="the folder cannot be created"):
        study.study(tmp_path / "file", 1, None, 1, None, Console(quiet=True))
