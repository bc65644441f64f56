"""One estimate from a file, with supports anywhere on the object."""

import pathlib
import re

import pytest

from pushfric_core.errors import InvalidInput
from pushfric_core.offline.estimation import Choices, estimate_from

BAG = pathlib.Path(__file__).resolve().parents[3] / "bags/rubber_rect4"


def test_supports_anywhere_fit_better_and_that_is_certified():
    warnings = []
    plain = estimate_from(BAG, Choices(), warnings.append).figures()
    refined = estimate_from(BAG, Choices(refine=0.004), warnings.append)
    figures = refined.figures()
    assert "refined" not in plain
    assert figures["refined"]["status"] == "optimal"
    assert figures["refined"]["candidates"] == 33 * 17
    assert figures["refined"]["objective"] <= plain["objective"]
    assert figures["refined"]["lower_bound"] == pytest.approx(figures["refined"]["objective"], rel=1e-6)
    assert figures["objective"] == pytest.approx(figures["refined"]["objective"], rel=1e-6)
    assert len(figures["w"]) == len(figures["support_points"]) == len(figures["w_intervals"])
    assert refined.to_model().w == figures["w"]
    assert warnings == []


@pytest.mark.parametrize("spacing", [0.0, -0.001, 1e-5, float("nan")])
def test_a_spacing_that_makes_no_sense_is_refused(spacing):
    with pytest.raises(InvalidInput, match="--refine"):
        estimate_from(BAG, Choices(refine=spacing), lambda _: None)


@pytest.mark.parametrize(
    ("error", "sentence"),
    [
        (0.003, r"the tip seems to be 3\.\d mm inside the outline while it pushes"),
        (-0.003, r"the object moves in 14 of 14 pushes though the tip is 2\.\d mm away from its outline"),
    ],
)
def test_an_outline_that_is_off_is_told(tmp_path, error, sentence):
    wrong = tmp_path / "wrong.yaml"
    x, y = 0.0635 + error, 0.032 + error
    wrong.write_text(f"name: rubber_rect4\noutline: [[-{x}, -{y}], [{x}, -{y}], [{x}, {y}], [-{x}, {y}]]\n")
    warnings = []
    if error < 0:
        with pytest.raises(InvalidInput, match="its poses give no data point"):
            estimate_from(BAG, Choices(object_name=str(wrong)), warnings.append)
    else:
        verdict = estimate_from(BAG, Choices(object_name=str(wrong)), warnings.append).figures()["verdict"]
        assert verdict["use"]
        assert [note["text"] for note in verdict["notes"]] == warnings
    (warning,) = warnings
    assert re.search(sentence, warning), warning
