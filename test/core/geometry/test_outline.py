import numpy as np
import pytest

from pushfric_core.geometry.outline import Outline

L_SHAPE = np.array(((0, 0), (0.1, 0), (0.1, 0.04), (0.04, 0.04), (0.04, 0.1), (0, 0.1)))
TRIANGLE = np.array(((0, 0), (0.15, 0), (0, 0.15)))


def test_vertices_are_made_counter_clockwise_and_normals_point_outward():
    outline = Outline(TRIANGLE[::-1])
    area = 0.5 * np.sum(
        outline.vertices[:, 0] * np.roll(outline.vertices[:, 1], -1)
        - np.roll(outline.vertices[:, 0], -1) * outline.vertices[:, 1]
    )
    assert area == pytest.approx(0.15**2 / 2)
    middles = outline.vertices + outline.edges / 2
    assert not outline.contains(middles + 1e-4 * outline.normals).any()
    assert outline.contains(middles - 1e-4 * outline.normals).all()


def test_measures_of_an_l_shape():
    outline = Outline(L_SHAPE)
    assert outline.perimeter == pytest.approx(0.4)
    assert np.allclose(outline.size, (0.1, 0.1))
    assert list(outline.contains(((0.02, 0.08), (0.08, 0.08)))) == [True, False]


def test_distance_to_the_outline_is_positive_inside_too():
    assert Outline.rectangle(0.1, 0.1).distance_to((0.0, 0.03)) == pytest.approx(0.02)


@pytest.mark.parametrize(
    ("vertices", "text"),
    [
        (((0, 0), (1, 0)), "at least 3 vertices"),
        (((0, 0), (1, 0), (1, 0), (0, 0)), "at least 3 vertices"),
        (((0, 0), (1, 1), (1, 0), (0, 1)), "simple polygon with an area: Self-intersection"),
        (((0, 0), (1, 0), (np.nan, 1)), "must be finite"),
    ],
)
def test_bad_outlines_are_refused(vertices, text):
    with pytest.raises(ValueError, match=text):
        Outline(np.array(vertices))


@pytest.mark.parametrize("again", [[0, 1, 2, 0], [0, 1, 1, 2], [2, 0, 1, 1, 2]])
def test_neighbours_in_one_place_are_one_corner(again):
    """As the first and the last of a ring, closed as GeoJSON has it."""
    outline = Outline(np.array(TRIANGLE)[again])
    assert {*map(tuple, outline.vertices.tolist())} == {*map(tuple, Outline(TRIANGLE).vertices.tolist())}
    assert np.isfinite(outline.normals).all()


def test_a_grid_over_a_triangle_keeps_the_points_on_its_long_side():
    assert len(Outline(TRIANGLE).grid(10, 10, inset=0.0075)) == 55


def test_a_grid_spans_the_box_shrunk_by_the_inset():
    grid = Outline.rectangle(0.127, 0.064).grid(5, 3, inset=0.01)
    assert len(grid) == 15
    assert np.allclose(grid.min(axis=0), (-0.0535, -0.022))
    assert np.allclose(grid.max(axis=0), (0.0535, 0.022))


def test_a_tip_meets_the_nearer_edge():
    touch = Outline.rectangle(0.1, 0.06).first_touch((0.02, -1), (0, 1), radius=0.005)
    assert touch.distance == pytest.approx(1 - 0.03 - 0.005)
    assert np.allclose(touch.point, (0.02, -0.03))
    assert np.allclose(touch.normal, (0, -1))
    assert touch.edge == 0


def test_a_tip_that_grazes_a_corner_touches_it():
    touch = Outline.rectangle(0.1, 0.1).first_touch((0.053, -1), (0, 1), radius=0.005)
    assert touch.edge is None
    assert np.allclose(touch.point, (0.05, -0.05))
    assert np.hypot(*touch.normal) == pytest.approx(1)


def test_a_tip_passes_by():
    outline = Outline.rectangle(0.1, 0.1)
    assert outline.first_touch((0.056, -1), (0, 1), radius=0.005) is None
    assert outline.first_touch((0.056, -1), (0, 1)) is None


@pytest.mark.parametrize("radius", [0.0, 0.005])
def test_one_line_and_many_lines_give_the_same_touches_to_the_bit(radius):
    rng = np.random.default_rng(4)
    outline = Outline(np.array([(-0.05, -0.03), (0.04, -0.035), (0.02, 0.0), (0.05, 0.03), (-0.04, 0.04)]))
    angles = rng.uniform(-np.pi, np.pi, 500)
    directions = np.column_stack((np.cos(angles), np.sin(angles)))
    starts = rng.uniform(-0.05, 0.05, (500, 2)) - 0.3 * directions
    found = outline.first_touches(starts, directions, np.full(500, radius))
    edges = set()
    for start, direction, *expected in zip(starts, directions, *found, strict=True):
        touch = outline.first_touch(start, direction, radius)
        distance, point, normal, edge = expected
        if touch is None:
            assert distance == np.inf
            continue
        assert (touch.distance, touch.point.tolist(), touch.normal.tolist()) == (distance, point.tolist(), normal.tolist())
        assert touch.edge == (None if edge < 0 else edge)
        edges.add(touch.edge)
    assert edges == {0, 1, 2, 3, 4} | ({None} if radius else set())


@pytest.mark.parametrize(
    ("corners", "alike"),
    [
        ([(0.0, 0.0), (0.1, 0.0), (0.1, 0.06), (0.0, 0.06)], True),
        ([(0.0, 0.0), (0.15, 0.0), (0.0, 0.15)], True),  # about the diagonal
        ([(0.0, 0.0), (0.15, 0.0), (0.0, 0.12)], False),
        ([(0.0, 0.0), (0.1, 0.0), (0.13, 0.06), (0.03, 0.06)], False),  # it only looks the same after half a turn
    ],
)
def test_some_outlines_look_the_same_in_a_mirror(corners, alike):
    assert Outline(np.array(corners)).is_its_mirror_image is alike
