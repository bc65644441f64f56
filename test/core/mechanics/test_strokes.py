import numpy as np
import pytest

from pushfric_core import TABLE_1, FrictionModel, Pose, PushedObject, PushingLine, predict_strokes
from pushfric_core.mechanics import quasi_static
from pushfric_core.mechanics.quasi_static import ContactMode

POSES = [Pose(-0.03, 0.06, 0.1), Pose(0.01, 0.07, 2.0), Pose(0.02, 0.06, -1.2), Pose(0.5, 0.06, 0.0)]
LINES = [PushingLine((0.0, 0.0), (0.0, 1.0), radius) for radius in (0.0, 0.002, 0.005, 0.002)]


@pytest.mark.parametrize("name", ["wood_rect4", "delrin_square3", "delrin_rect_right"])
def test_strokes_end_where_the_simulation_does(name):
    known = TABLE_1[name]
    found = predict_strokes(FrictionModel.of(known.support, known.mu_c), known.outline, POSES, LINES, np.full(4, 0.06))
    for pose, line, end, mode in zip(POSES, LINES, found.poses[:, 0], found.modes[:, 0], strict=True):
        pushed = PushedObject(known.outline, known.support, known.mu_c, pose)
        assert quasi_static.MODES[mode] is pushed.push(line, 0.06)
        assert end[:2] == pytest.approx(pushed.pose[:2], abs=1e-4)
        assert end[2] == pytest.approx(pushed.pose.theta, abs=2e-3)
    assert found.poses[3, 0] == pytest.approx(POSES[3])  # the tip passes by


@pytest.mark.parametrize("origin", [0.2, 5.0])
def test_an_object_behind_the_tip_stays_where_it_is(origin):
    known = TABLE_1["wood_rect4"]
    line, pose = PushingLine((0.0, origin), (0.0, 1.0), 0.003), Pose(0.01, 0.0, 0.3)
    found = predict_strokes(FrictionModel.of(known.support, known.mu_c), known.outline, [pose], [line], [0.05])
    assert found.means.tolist() == [[*pose]]
    pushed = PushedObject(known.outline, known.support, known.mu_c, pose)
    assert pushed.push(line, 0.05) is ContactMode.FREE
    assert pushed.pose == pose


def test_a_tip_that_starts_inside_the_object_is_refused_and_one_that_overlaps_it_pushes():
    known = TABLE_1["wood_rect4"]
    model, edge = FrictionModel.of(known.support, known.mu_c), float(known.outline.lower[1])
    lines = [PushingLine((0.0, edge - depth), (0.0, 1.0), 0.003) for depth in (0.0031, 0.001, -0.001)]
    poses = [Pose(0.0, 0.0, 0.0)] * 3
    found = predict_strokes(model, known.outline, poses[:2], lines[:2], [0.01, 0.01])
    assert found.means[:, 1] == pytest.approx((0.0099, 0.012), abs=1e-6)
    with pytest.raises(ValueError, match=r"at \[0\.0, -0\.0\d+\] m, 4\.0 mm inside the object at \[0\.0, 0\.0\] m"):
        predict_strokes(model, known.outline, poses, lines, np.full(3, 0.01))


def test_wrong_arguments_are_named():
    known = TABLE_1["wood_rect3"]
    model = FrictionModel.of(known.support, 0.3)
    with pytest.raises(ValueError, match="must have the same length, got 4, 4 and 1"):
        predict_strokes(model, known.outline, POSES, LINES, (0.05,))
    with pytest.raises(ValueError, match="step must be positive"):
        predict_strokes(model, known.outline, POSES, LINES, np.full(4, 0.05), step=0.0)
