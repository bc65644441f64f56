"""One estimate from a file."""

import pathlib
import re

import pytest

from pushfric_core.errors import InvalidInput
from pushfric_core.offline.estimation import Choices, estimate_from

BAG = pathlib.Path(__file__).resolve().parents[3] / "bags/rubber_rect4"


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
