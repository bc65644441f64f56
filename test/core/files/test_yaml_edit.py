"""Values replaced in YAML texts, with everything else as it was."""

import pytest

from pushfric_core.files.yaml_text import with_values

CELL = """\
object: box.yaml   # what is pushed
pusher:
  port: /dev/ttyUSB0
  line_origin: [0.1, -0.02]   # measured by hand
  line_direction:
    - 0.0
    - 1.0
  # half of a caliper's 6 mm
  tip_radius: 3e-3
plan: {file: plan.yaml}
"""


def test_only_the_values_change():
    made = with_values(CELL, "pusher", {"line_origin": [0.2, 0.0], "line_direction": [1.0, 0.0], "tip_radius": 0.004})
    assert made == CELL.replace("[0.1, -0.02]", "[0.2, 0.0]").replace("- 0.0\n    - 1.0", "[1.0, 0.0]").replace("3e-3", "0.004")


def test_a_flow_mapping_and_the_whole():
    assert with_values("a: {b: 1, c: [2]}  # x\n", "a", {"c": [3.0, 4.0]}) == "a: {b: 1, c: [3.0, 4.0]}  # x\n"
    assert with_values("a:\n- 1\n- 2\nb:\nc: 3\n", None, {"a": [1.0], "b": 2.0}) == "a:\n [1.0]\nb: 2.0\nc: 3\n"
    assert with_values("a:\n  b:\n  - 1\n", "a", {"b": [2.0]}) == "a:\n  b:\n   [2.0]\n"
    assert with_values("a: 1\nb: [[0, 1]]\n", None, {"b": [[2.5, 3.0]], "c": 1e-5}) == "a: 1\nb: [[2.5, 3.0]]\nc: 0.00001\n"


@pytest.mark.parametrize(
    ("text", "section", "said"),
    [
        (CELL, "camera", "expected keys with values in camera"),
        ("- 1\n", None, "expected keys with values"),
        ("pusher: {stroke: 1}\n", "pusher", "expected tip_radius in pusher"),
        ("r: &r 1.0\npusher: {tip_radius: *r}\n", "pusher", "alias"),
        ("a: [", None, "expected"),
        ("pusher:\n  tip_radius: 0.003\n  a\t: 1\n", "pusher", "cannot start any token"),
        ("a: &a {pusher: {tip_radius: 1.0}}\n<<: *a\n", "pusher", "expected tip_radius in pusher"),
    ],
)
def test_what_cannot_be_replaced_is_refused(text, section, said):
    with pytest.raises(ValueError, match=said):
        with_values(text, section, {"tip_radius": 0.004})
