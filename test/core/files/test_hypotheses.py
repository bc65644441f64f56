"""Recognition around the core: hypotheses from object files, rankings as messages and JSON, rankings of files."""

import numpy as np
import pytest
from problems import three_feet

from pushfric_core import TABLE_1, EstimatorConfig, Hypothesis, InvalidInput, Observation, Recognizer, Twist
from pushfric_core.estimation.estimator import last, taken
from pushfric_core.files.object_file import load_object

# a square whose frame has its origin in a corner: its centroid is at (0.05, 0.05)
SQUARE = """
name: square
outline: [[0, 0], [0.1, 0], [0.1, 0.1], [0, 0.1]]
support: {points: [[0.02, 0.02], [0.08, 0.02], [0.05, 0.08]]}
hypotheses:
"""


@pytest.fixture
def load(tmp_path):
    def load(hypotheses):
        path = tmp_path / "square.yaml"
        path.write_text(SQUARE + "".join(f"  - {hypothesis}\n" for hypothesis in hypotheses))
        return load_object(str(path))

    return load


def test_a_rotation_turns_supports_and_center_about_the_centroid(load):
    (turned,) = load(["{name: turned, center_of_friction: [0.05, 0.04], rotation_deg: 90}"]).hypotheses
    assert turned.support_points == pytest.approx(np.array(((0.08, 0.02), (0.08, 0.08), (0.02, 0.05))))
    assert turned.center_of_friction == pytest.approx((0.06, 0.05))


@pytest.mark.parametrize(
    ("hypotheses", "error"),
    [
        (["{name: a}", "{name: a, rotation_deg: 90}"], "hypotheses: .*expected names that differ, got a, a"),
        (["{name: ''}"], "hypotheses.0.name: expected a text that is not empty, got ''"),
        (["{rotation_deg: 90}"], "hypotheses.0.name: expected a value, got only rotation_deg"),
        (["{name: a, rotation_deg: .nan}"], "hypotheses.0.rotation_deg: .*finite"),
        (["{name: a, support: {grid: [0, 1]}}"], "hypothesis 'a': a grid needs at least 1 column"),
    ],
)
def test_bad_hypotheses_are_refused_in_one_line(load, hypotheses, error):
    with pytest.raises(InvalidInput, match=f"square.yaml: {error}") as refusal:
        load(hypotheses)
    assert "\n" not in str(refusal.value)


def test_objects_of_table_1_bring_the_hypotheses_of_the_paper():
    left, center, right = load_object("delrin_rect_right").hypotheses
    assert [hypothesis.name for hypothesis in (left, center, right)] == [
        "delrin_rect_left",
        "delrin_rect_center",
        "delrin_rect_right",
    ]
    assert right.center_of_friction == pytest.approx(TABLE_1["delrin_rect_right"].support.center_of_friction, abs=1e-9)
    upright, upside_down = load_object("wood_rect3").hypotheses
    assert upright.support_points == pytest.approx(TABLE_1["wood_rect3"].support.points)
    assert upside_down.support_points == pytest.approx(-TABLE_1["wood_rect3"].support.points)
    assert len(load_object("delrin_square3").hypotheses) == 4
    assert load_object("rubber_rect4").hypotheses == ()


def test_files_are_ranked_with_a_line_for_each_data_point_left_out():
    problem = three_feet()
    feet, elsewhere = problem.truth.points, problem.truth.points + 0.011
    hypotheses = [Hypothesis("elsewhere", elsewhere), Hypothesis("feet", feet)]
    x, y = feet[1]
    about_a_foot = Observation((0.05, 0.0), (0.0, -1.0), Twist(y, -x, 1.0), push_id=99)
    lines, exact = [], EstimatorConfig(cor_radius=0.0)
    ranking = last(taken(Recognizer(hypotheses, exact).add, [about_a_foot, *problem.observations], lines.append))
    assert ranking.best == "feet"
    assert ranking.data_points == len(problem.observations)
    assert lines == ["observation of push 99 refused: the object rotated exactly about its support point (0.09, 0.03)"]
    with pytest.raises(InvalidInput, match="no observation could be used"):
        last(taken(Recognizer(hypotheses, exact).add, [about_a_foot], lines.append))
