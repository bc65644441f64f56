import numpy as np
import pytest
from problems import save_csv

from bench.public import stablepush
from pushfric_core.bags.recorded import Recorded
from pushfric_core.errors import InvalidInput
from pushfric_core.estimation.estimator import Estimator
from pushfric_core.files.csv_files import read_edge_pushes
from pushfric_core.files.estimator_settings import EstimatorSettings
from pushfric_core.files.object_file import OBJECT_FILE, load_object

ROW = ("triangle", 75, 0, 0, -1, 25, -400, 100, 0.35, -35, 140, 0.35, 1)


def test_the_real_pushes_become_bags_and_pushes(real_pushes, tmp_path):
    imported = stablepush.import_pushes(real_pushes / "stable_pushes.csv", tmp_path)
    assert {one.object: one.observations for one in imported} == {"patch": 51, "30_90_30_30_30_90": 141}
    for bag, name, count in imported:
        model = load_object(str(bag / OBJECT_FILE))
        data = Recorded(bag).read(model, EstimatorSettings(), pytest.fail).observations
        assert (model.name, len(data), data[0].half_width) == (name, count, 0.025)
        center = Estimator(model.support_points).add(data).center_of_friction
        assert np.hypot(*(center - 0.05)) < 0.02  # intervals of 50 mm bound it from both sides
        assert len(read_edge_pushes(bag / stablepush.PUSHES, model.outline).turns) in (228, 413)


def test_units_and_signs(tmp_path):
    slipped = (*ROW[:8], -0.35, *ROW[9:12], 0)
    (found,) = stablepush.read_stable_pushes(save_csv(tmp_path / "in.csv", stablepush.COLUMNS, ROW, slipped)).values()
    assert found.pushes.contact_points[0] == pytest.approx((0.075, 0))
    assert found.pushes.centers[0] == pytest.approx((-0.4, 0.1))
    assert found.pushes.turns.tolist() == [1, -1]
    assert found.twists[0] == pytest.approx((-0.035, 0.14, 0.35))
    assert found.stable.tolist() == [True, False]
    ((bag, _, count),) = stablepush.import_pushes(tmp_path / "in.csv", tmp_path / "bag")
    assert count == 1
    assert (bag / stablepush.PUSHES).read_text().splitlines()[1] == "0.075,0,0,-1,0.025,-0.4,0.1,1,1"


@pytest.mark.parametrize(
    ("rows", "expected"),
    [
        ([], "no pushes"),
        ([("triangle", "x", *ROW[2:])], "line 2: cx_mm must be a number, got 'x'"),
        ([("triangle", "nan", *ROW[2:])], "line 2: cx_mm must be finite, got nan"),
        ([(*ROW[:-1], 0)], "no push of triangle was stable"),
        ([(*ROW[:3], 0, -2, *ROW[5:])], "triangle: contact_normal must have length 1"),
    ],
)
def test_wrong_files_are_refused(tmp_path, rows, expected):
    with pytest.raises(InvalidInput, match=expected):
        stablepush.import_pushes(save_csv(tmp_path / "in.csv", stablepush.COLUMNS, *rows), tmp_path / "bag")
    assert not (tmp_path / "bag").exists()


def test_another_csv_is_named(tmp_path):
    (tmp_path / "in.csv").write_text("a,b\n1,2\n")
    with pytest.raises(InvalidInput, match=r"missing column object.*expected stable_pushes\.csv of stablepush"):
        stablepush.read_stable_pushes(tmp_path / "in.csv")
