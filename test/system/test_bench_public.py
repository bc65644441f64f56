"""The benchmark on public pushes, with strokes made by the model of one object."""

import shutil

import numpy as np
import pytest
import strokes_in_mujoco

from bench import public_pushes
from bench.public import zhou2015
from bench.public.mitpush import POLY4
from bench.public.strokes import STROKES, USUAL_RADIUS, Stroke, read_strokes, save_strokes
from bench.public_pushes import _center, ellipsoid_motion, measure, sets_in
from pushfric_core import TABLE_1, FrictionModel, NamedEllipsoid, Pose, believe, predict_strokes
from pushfric_core.errors import InvalidInput
from pushfric_core.files.object_file import load_object, save_object
from pushfric_core.geometry.planar import transform


@pytest.fixture
def folder(tmp_path):
    """A set whose stored quartic is right, and whose stored ellipsoid says that nothing moves."""
    name = "wood_rect3"
    known = TABLE_1[name]
    save_object(load_object(name), tmp_path / "block.yaml")
    chosen = strokes_in_mujoco.strokes(known.outline, USUAL_RADIUS, np.random.default_rng(0), 30, 0.02)
    poses, lines, begins, ends = zip(*chosen, strict=True)
    final = predict_strokes(FrictionModel.of(known.support, known.mu_c), known.outline, poses, lines, ends).means
    for suffix, right in ((STROKES, False), (POLY4, True)):
        strokes = []
        for pose, line, begin, end, after in zip(poses, lines, begins, ends, final.tolist(), strict=True):
            tips = [tuple(np.add(line.origin, np.multiply(line.direction, s)).tolist()) for s in (begin, end)]
            strokes.append(Stroke(pose, Pose(*after), *tips, Pose(*after) if right else pose))
        save_strokes(strokes, tmp_path / f"steel_block{suffix}")
    return tmp_path


def test_every_contender_is_compared_on_the_same_strokes(folder, tmp_path):
    told = []
    figures = public_pushes.measure(public_pushes.sets_in(folder), tmp_path / "figure.png", told.append)
    (row,) = figures["sets"]
    assert told == ["public pushes: steel_block"]
    assert (row["set"], row["strokes"]) == ("steel_block", 30)
    assert 5 <= row["rolled"] <= 15
    assert len(row["few"]) == 6
    errors = {name: found["combined"] for name, found in row["errors"].items()}
    assert errors["zhou_quartic"] < 1e-6  # nine digits
    assert errors["half"] < errors["few"] < errors["uniform"] < errors["zhou_ellipsoid"]
    assert errors["ellipsoid"] < errors["zhou_ellipsoid"]
    assert 0.8 <= row["within"]["half"] <= 1
    assert [table.row_count for table in public_pushes.tables(figures)] == [2, 2]
    lines = (tmp_path / "figure.md").read_text().splitlines()
    assert [line.split(" | ")[0] for line in lines[2:]] == ["| steel_block", f"| all 1 of {tmp_path.name}"]
    for name in ("figure.png", "figure_gallery.png"):
        assert (tmp_path / name).read_bytes().startswith(b"\x89PNG")


def test_two_sets_of_an_object_must_agree(folder, tmp_path):
    """Without a label: p_CF of one object on two surfaces is the same; of another one that is pushed alike, it is not."""
    shutil.copy(folder / f"steel_block{STROKES}", folder / f"wood_block{STROKES}")
    moved = [
        stroke._replace(
            **{
                end: getattr(stroke, end)._replace(**dict(zip("xy", transform(getattr(stroke, end), (0.01, 0.0)), strict=True)))
                for end in ("before", "after")
            }
        )
        for stroke in read_strokes(folder / f"steel_block{STROKES}")
    ]
    save_strokes(moved, folder / f"ice_block{STROKES}")
    figures = measure(sets_in(folder), tmp_path / "figure.png", lambda _: None)
    found = {tuple(pair["sets"]): pair for pair in figures["surfaces"]}
    assert found["steel_block", "wood_block"]["apart"] == 0
    assert [found[pair]["agree"] for pair in sorted(found)] == [False, False, True]


def test_the_real_triangles_are_rolled_out_from_a_table_and_from_bags(real_pushes, tmp_path):
    zhou2015.import_pushes(real_pushes / "push_points.csv", tmp_path)
    by_name = {one.name: one for one in sets_in(tmp_path)}
    for one in sets_in(real_pushes):
        other = by_name[one.name]
        assert one.label.tolist() == pytest.approx([0.05, 0.05])
        for stroke, same in zip(one.strokes, other.strokes, strict=True):
            assert np.allclose((*stroke.before, *stroke.after), (*same.before, *same.after))
            assert np.allclose((*stroke.tip_before, *stroke.tip_after), (*same.tip_before, *same.tip_after))


def test_folders_without_sets_are_refused(tmp_path):
    with pytest.raises(InvalidInput, match="expected what `import` writes"):
        sets_in(tmp_path)


def test_the_ellipse_holds_the_label_of_real_sets(mit_pushes, real_pushes):
    """With all pushes, where what friction does otherwise than Coulomb's is most of the error."""
    sets = [one for folder in (mit_pushes, real_pushes) for one in sets_in(folder)]
    held = [_center(believe(one.model.support_points, one.data), one.label)["held"] for one in sets]
    assert len(held) == 16
    assert sum(held) >= 13


@pytest.mark.parametrize(("mu_c", "slides"), [(9.0, False), (0.2, True)])
def test_the_closed_form_balances_forces(mu_c, slides):
    """The force passes through the contact, within the cone, at whose edge the contact slides; the tip drives the contact."""
    ellipsoid = NamedEllipsoid(1.0, 0.03, np.array((0.01, -0.005)))
    point, normal, velocity = (np.array(one) for one in ((-0.04, 0.01), (-1.0, 0.0), (0.02, 0.05)))
    vx, vy, omega = ellipsoid_motion(ellipsoid, mu_c, point, normal, velocity)
    fx, fy, m = np.linalg.solve(ellipsoid.form, (vx, vy, omega))
    assert m == pytest.approx(point[0] * fy - point[1] * fx)
    assert fx > 0
    assert abs(fy) == pytest.approx(mu_c * fx) if slides else abs(fy) < mu_c * fx
    moved = np.array((vx - omega * point[1], vy + omega * point[0])) - velocity
    assert moved[0] == pytest.approx(0)
    assert (abs(moved[1]) > 1e-4) == slides
    assert fy * moved[1] < 0 or not slides  # the tip drags the object along
