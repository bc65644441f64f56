import math
import pathlib
import shutil

import numpy as np
import public_sets
import pytest

from bench.public import mitpush
from bench.public.strokes import read_strokes
from pushfric_core.errors import InvalidInput
from pushfric_core.files.csv_files import read_observations
from pushfric_core.files.object_file import load_object
from pushfric_core.geometry.outline import Outline


def test_strokes_and_pairs_become_data_points(tmp_path):
    source = public_sets.clone(tmp_path / "clone", "abs_rect1_quadratic", "abs_rect1_poly4", "plywood_rect1_quadratic")
    written = mitpush.import_pushes(source, tmp_path / "out")
    out = tmp_path / "out"
    assert [(one.path.name, one.object, one.observations) for one in written] == [
        ("abs_rect1.strokes.csv", "rect1", 1),
        ("plywood_rect1.strokes.csv", "rect1", 1),
    ]
    assert sorted(path.name for path in out.glob("abs*")) == [
        *("abs_rect1.csv", "abs_rect1.strokes.csv", "abs_rect1.strokes_poly4.csv", "abs_rect1.tip.csv")
    ]
    model = load_object(str(out / "rect1.yaml"))
    assert model.outline.size.tolist() == [0.09, 0.09]
    assert 45 <= len(model.support_points) <= 64
    ahead, past = read_strokes(out / "abs_rect1.strokes.csv")
    assert (ahead.before, ahead.after, ahead.predicted) == ((0.3, 0, 0), (0.3, 0.04, 0), (0.301, 0.039, 0.02))
    assert past.tip_after == (0.4, 0.04)
    (point,) = read_observations(out / "abs_rect1.tip.csv", model.outline)
    assert point.contact_point == pytest.approx((0.01, -0.045))
    assert point.contact_normal == (0, -1)
    assert point.twist == pytest.approx((0, 0.04, 0))
    assert point.tip_velocity == pytest.approx((0, 0.04))
    assert point.push_id == 0
    (pair,) = read_observations(out / "abs_rect1.csv", model.outline)
    assert pair.force == (0, 2)
    assert pair.contact_point == pytest.approx((0.01, -0.045))
    assert pair.twist.omega == pytest.approx(0.1)
    # the difference of two poses 0.571 s apart, in the frame of the first, is turned by half the angle between them
    half = 0.1 * mitpush.STEP / 2
    assert pair.twist[:2] == pytest.approx((0.01 * math.sin(half), 0.01 * math.cos(half)), rel=1e-3)


def test_an_import_of_the_original_file_equals_the_published_tables(mit_pushes, tmp_path):
    (tmp_path / mitpush.FOLDER).mkdir(parents=True)
    for path in (mit_pushes / "raw").glob("*.mat"):
        shutil.copy(path, tmp_path / mitpush.FOLDER)
    mitpush.import_pushes(tmp_path, tmp_path / "out")
    for name in ("abs_rect1.csv", "abs_rect1.tip.csv", "abs_rect1.strokes.csv", "abs_rect1.strokes_poly4.csv"):
        mine, theirs = (np.genfromtxt(folder / name, delimiter=",", names=True) for folder in (tmp_path / "out", mit_pushes))
        assert mine.dtype.names == theirs.dtype.names
        for column in theirs.dtype.names:
            assert mine[column] == pytest.approx(theirs[column], abs=6e-7)  # they have seven digits
    mine, theirs = (load_object(str(folder / "rect1.yaml")) for folder in (tmp_path / "out", mit_pushes))
    assert mine.outline == theirs.outline
    assert mine.support_points.tolist() == theirs.support_points.tolist()


@pytest.mark.parametrize("shape", ["rect1", "rect3", "tri2", "hex", "ellip2"])
def test_the_outlines_are_those_of_the_published_tables(mit_pushes, tmp_path, shape):
    theirs = load_object(str(mit_pushes / f"{shape}.yaml")).outline
    assert mitpush.outline_of(shape, tmp_path).vertices == pytest.approx(theirs.vertices, abs=1e-6)


@pytest.mark.parametrize(
    "matrix",
    [
        "[-0.04, 0.04; ... % begins here\n 0.04, 0.04; 0.03, -0.04; -0.03 -0.04]",
        "[[-0.04, 0.04]; [0.04, 4e-2]; ...\n [0.03, -0.04]; [-0.03, -0.04]]",
        "[ -0.04 0.04\n 0.04 0.04\n 0.03 -0.04\n -0.03 -0.04 ]",
    ],
)
@pytest.mark.parametrize(
    "branch",
    [
        "if strcmp(id, 'butter')\n  shape.size = [1, 2];\n  shape.shape_vertices = {};\nend\n",
        "elseif strcmp(shape_id, 'butter') == 1\nshape.shape_type = 'poly';\nv = {};\nelseif strcmp(id,'rect1')\na = 0.09/2.0;",
        'case "butter"\n shape.vertices={}; % [1, 2; 3, 4; 5, 7]\ncase "rect1"\n b = [0, 1; 2, 3; 4, 4]',
    ],
)
def test_a_listed_outline_is_read_from_the_clone(tmp_path, branch, matrix):
    (tmp_path / "pnpush_matlab").mkdir()
    (tmp_path / mitpush.OUTLINES).write_text(branch.format(matrix))
    expected = Outline(np.array(((-0.04, 0.04), (0.04, 0.04), (0.03, -0.04), (-0.03, -0.04))))
    assert mitpush.outline_of("butter", tmp_path) == expected
    with pytest.raises(InvalidInput, match=r"the outline of margarine: expected a matrix of at least 3 rows of two numbers"):
        mitpush.outline_of("margarine", tmp_path)


def test_the_normal_of_an_ellipse_is_that_of_the_curve(tmp_path):
    source = public_sets.clone(tmp_path / "clone", "abs_ellip3_quadratic")
    mitpush.import_pushes(source, tmp_path / "out")
    outline = load_object(str(tmp_path / "out" / "ellip3.yaml")).outline
    a, b = np.array(mitpush.SIZES["ellip3"]) / 2
    pairs = read_observations(tmp_path / "out" / "abs_ellip3.csv", outline)
    assert pairs
    for (x, y), (nx, ny) in ((pair.contact_point, pair.contact_normal) for pair in pairs):
        assert abs((x / a) ** 2 + (y / b) ** 2 - 1) < 4e-3
        # along the gradient of the curve's equation; no edge has this normal
        assert nx * y / b**2 - ny * x / a**2 == pytest.approx(0, abs=1e-5 * math.hypot(x / a**2, y / b**2))
        assert (outline.normals @ (nx, ny)).max() < 1 - 1e-7


def test_what_cannot_be_read_stops_nothing_else(tmp_path):
    source = public_sets.clone(tmp_path / "clone", "abs_rect1_quadratic", "abs_butter_quadratic", "plywood_rect1_quadratic")
    broken = source / mitpush.FOLDER / "wrench1twist1_20percenttrainingplywood_rect1_quadratic_v10.mat"
    broken.write_bytes(broken.read_bytes()[:300])
    found = mitpush.import_pushes(source, tmp_path / "out")
    assert [one.path.name for one in found if not isinstance(one, InvalidInput)] == ["abs_rect1.strokes.csv"]
    left_out = sorted(pathlib.Path(str(one).partition(":")[0]).name for one in found if isinstance(one, InvalidInput))
    assert left_out == [
        "get_shape.m",
        "wrench1twist1_20percenttrainingabs_butter_quadratic_v10.mat",
        "wrench1twist1_20percenttrainingplywood_rect1_quadratic_v10.mat",
    ]


@pytest.mark.parametrize("files", [[], ["abs_rect1_poly4"]])
def test_another_folder_is_refused(tmp_path, files):
    with pytest.raises(InvalidInput, match="expected a clone of PlanarManipulationToolBox"):
        mitpush.import_pushes(public_sets.clone(tmp_path / "clone", *files), tmp_path / "out")


def test_a_file_of_another_kind_is_refused(tmp_path):
    (tmp_path / "some.mat").write_bytes(b"MATLAB")
    with pytest.raises(InvalidInput, match=r"some\.mat: not a file of mitpush"):
        mitpush.read_file(tmp_path / "some.mat", public_sets.OUTLINE)
