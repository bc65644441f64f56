"""The drawings and the printable parts of docs/hardware.md."""

import math
import pathlib
import sys

import pytest
import yaml

DOCS = pathlib.Path(__file__).parents[2] / "docs"
sys.path.append(str(DOCS))

import cell_parts  # noqa: E402


def test_the_drawings_show_the_sizes_of_the_parts():
    p, (wide, deep) = cell_parts, cell_parts.PLATE
    plan, side = ((DOCS / f"cell_{name}.svg").read_text(encoding="utf-8") for name in ("plan", "side"))
    assert f" {wide:g} x {deep:g} mm<" in plan
    assert plan.count(f'r="{p.HOLE / 2:g}"') == len(p.HOLES)
    assert f'class="tip" cx="330" cy="330" r="{p.TIP_RADIUS:g}"' in plan
    assert f"plate {p.PLATE_HEIGHT:g} mm on feet of {p.FOOT_HEIGHT:g} mm<" in side


def test_the_parts_can_be_printed(tmp_path):
    trimesh = pytest.importorskip("trimesh")
    pytest.importorskip("mapbox_earcut")
    cell_parts.main([str(tmp_path)])
    parts = {name: trimesh.load(tmp_path / f"{name}.stl") for name in ("tip", "plate", "foot")}
    for name, mesh in parts.items():
        assert mesh.is_watertight, name
        assert mesh.is_winding_consistent, name
        assert mesh.body_count == 1, name
    wide, deep = cell_parts.PLATE
    holes = len(cell_parts.HOLES) * math.pi * (cell_parts.HOLE / 2) ** 2
    assert parts["plate"].volume == pytest.approx((wide * deep - holes) * cell_parts.PLATE_HEIGHT, rel=1e-3)
    assert parts["plate"].extents.tolist() == pytest.approx([wide, deep, cell_parts.PLATE_HEIGHT])
    tube = math.pi * (cell_parts.TIP_RADIUS**2 - (cell_parts.TIP_BORE / 2) ** 2) * cell_parts.TIP_LENGTH
    assert parts["tip"].volume == pytest.approx(tube, rel=0.01)
    assert parts["foot"].extents[2] == pytest.approx(cell_parts.FOOT_HEIGHT + cell_parts.PLATE_HEIGHT - 1)


def test_a_peg_is_pressed_into_its_hole_which_a_screw_passes():
    assert 0.0 < cell_parts.PEG - cell_parts.HOLE <= 0.2
    assert cell_parts.HOLE > 6.0
    assert cell_parts.TIP_RADIUS > cell_parts.TIP_BORE / 2 + 1.0
    wide, deep = cell_parts.PLATE
    assert all(
        abs(x) + cell_parts.FOOT_RADIUS < wide / 2 and abs(y) + cell_parts.FOOT_RADIUS < deep / 2 for x, y in cell_parts.HOLES
    )


def test_the_example_cell_has_the_sizes_of_the_parts():
    p = cell_parts
    cell, model = (yaml.safe_load((DOCS / "example_cell" / name).read_text()) for name in ("cell.yaml", "object.yaml"))
    assert cell["pusher"]["tip_radius"] == pytest.approx(1e-3 * p.TIP_RADIUS)
    assert f">stroke {1e3 * cell['pusher']['stroke']:g} mm<" in (DOCS / "cell_plan.svg").read_text(encoding="utf-8")
    assert model["height"] == pytest.approx(1e-3 * (p.PLATE_HEIGHT + p.FOOT_HEIGHT))
    sides = [max(side) - min(side) for side in zip(*model["outline"], strict=True)]
    assert sides == pytest.approx([1e-3 * side for side in p.PLATE])
