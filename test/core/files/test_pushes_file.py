import numpy as np
import pytest

from pushfric_core import InvalidInput, Outline
from pushfric_core.files.csv_files import MOVED, TURNED, read_edge_pushes, read_point_pushes

OUTLINE = Outline.rectangle(0.1, 0.06)


def written(path, columns, *rows):
    path.write_text("\n".join([",".join(columns), *(",".join(map(str, row)) for row in rows)]) + "\n")
    return path


def test_columns_may_stand_in_any_order_with_others(tmp_path):
    columns = ("note", *reversed(TURNED))
    path = written(tmp_path / "pushes.csv", columns, ("x", -1, 0.3, 0.2, 0.01, -1, 0, -0.03, 0.02))
    pushes = read_edge_pushes(path, OUTLINE)
    assert np.array_equal(pushes.contact_points, [[0.02, -0.03]])
    assert np.array_equal(pushes.contact_normals, [[0, -1]])
    assert (pushes.half_widths[0], pushes.turns[0]) == (0.01, -1)
    assert np.array_equal(pushes.centers, [[0.2, 0.3]])


@pytest.mark.parametrize(
    ("row", "expected"),
    [
        ((0, -0.03, 0, -1, 0, "fast"), "line 2: tip_vy must be a number, got 'fast'"),
        ((0, -0.03, 0, -1, 0), "line 2: tip_vy must be a number, got None"),
        ((0, -0.03, 0, -1, 0, "inf"), "line 2: tip_vy must be finite"),
        ((0, -0.03, 0, -1, 0, 1e200), "line 2: tip_vy must lie within 10 m/s, got 1e\\+200"),
        ((0, -0.03, 0, -2, 0, 1), "line 2: the normal must have length 1"),
        ((0, -0.3, 0, -1, 0, 1), "line 2: the contact must be within 5 mm of the outline"),
        ((0, -0.03, 0, 1, 0, 1), r"line 2: the normal must point outward, away from the object, got \(0, 1\)"),
    ],
)
def test_a_wrong_row_is_named(tmp_path, row, expected):
    path = written(tmp_path / "pushes.csv", MOVED, row)
    with pytest.raises(InvalidInput, match=expected):
        read_point_pushes(path, OUTLINE)


def test_a_wrong_file_is_named(tmp_path):
    with pytest.raises(InvalidInput, match="missing column tip_vy; expected contact_x"):
        read_point_pushes(written(tmp_path / "pushes.csv", MOVED[:-1]), OUTLINE)
    with pytest.raises(InvalidInput, match="no pushes; expected a row for each"):
        read_point_pushes(written(tmp_path / "pushes.csv", MOVED), OUTLINE)
    with pytest.raises(InvalidInput, match="cannot be read"):
        read_point_pushes(tmp_path / "none.csv", OUTLINE)
    contact = (0, -0.03, 0, -1)
    with pytest.raises(InvalidInput, match="line 2: half_width must be at least 0"):
        read_edge_pushes(written(tmp_path / "pushes.csv", TURNED, (*contact, -0.01, 0, 0, 1)), OUTLINE)
    with pytest.raises(InvalidInput, match=r"line 2: turn must be \+1 \(counter-clockwise\) or -1, got 0"):
        read_edge_pushes(written(tmp_path / "pushes.csv", TURNED, (*contact, 0.01, 0, 0, 0)), OUTLINE)
