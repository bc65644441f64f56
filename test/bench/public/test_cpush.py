import json

import numpy as np
import public_sets
import pytest

from bench.public import cpush
from bench.public.strokes import read_strokes
from pushfric_core.errors import InvalidInput
from pushfric_core.files.csv_files import read_observations
from pushfric_core.files.object_file import load_object


def runs(folder, *names, content=None):
    for name in names:
        (folder / name).write_bytes(public_sets.run_file() if content is None else content)
    return [folder / name for name in names]


def test_runs_are_cut_into_strokes(tmp_path):
    out = tmp_path / "out"
    (written,) = cpush.import_pushes(runs(tmp_path, "StraightLine1.json", "StraightLine2.json"), out)
    assert (written.path.name, written.object, written.observations) == ("cpush_block.strokes.csv", "block", 2)
    model = load_object(str(out / "block.yaml"))
    strokes = read_strokes(written.path)
    for stroke in strokes:
        assert stroke.tip_radius == pytest.approx(0.005, abs=1e-4)
        assert np.hypot(*np.subtract(stroke.tip_after, stroke.tip_before)) == pytest.approx(cpush.LENGTH, abs=1e-4)
    for number, point in enumerate(read_observations(out / "cpush_block.tip.csv", model.outline)):
        assert point.push_id == number
        assert point.contact_normal == (-1, 0)
        assert point.contact_point == pytest.approx((-0.045, 0.01), abs=6e-4)  # the tip goes straight, not along an arc
        # 20 mm take 0.4 s, in which the block turns by 0.2 rad
        assert point.twist.omega == pytest.approx(-0.2, abs=2e-3)
        assert np.hypot(*point.tip_velocity) == pytest.approx(0.02, abs=1e-4)


def test_one_list_of_times_may_be_nested(tmp_path):
    content = json.loads(public_sets.run_file())
    content["timeJSON"] = [content["timeJSON"]]
    (path,) = runs(tmp_path, "run.json", content=json.dumps(content).encode())
    assert len(cpush.read_run(path)) == 1


def test_one_bad_run_stops_none_of_the_others(tmp_path):
    """Some values are null; some runs were poked by hand, in either spelling; each surface is a set of its own."""
    content = json.loads(public_sets.run_file())
    for table, row, column in (("q_sliderJSON", 2, 9), ("q_pusher_sensedJSON", 0, 250), ("timeJSON", None, 77)):
        (content[table] if row is None else content[table][row])[column] = None
    sources = [
        *runs(tmp_path, "StraightLine1.json", content=json.dumps(content).encode()),
        *runs(tmp_path, "StraightLine2.json", "StraightLine_Black.json", "StraightLinePlywood3.json"),
        *runs(tmp_path, "StraightLinePertubations.json", "StraightLine_Perturbation.json"),
        *runs(tmp_path, "StraightLine9.json", content=b'{"timeJSON": [nul'),
    ]
    found = cpush.import_pushes(sources, tmp_path / "out")
    assert [(one.path.name, one.observations) for one in found if not isinstance(one, InvalidInput)] == [
        ("cpush_block.strokes.csv", 2),
        ("black_block.strokes.csv", 1),
        ("plywood_block.strokes.csv", 1),
    ]
    assert [stroke.run for stroke in read_strokes(tmp_path / "out" / "plywood_block.strokes.csv")] == [3]
    left_out = [str(one) for one in found if isinstance(one, InvalidInput)]
    assert len(left_out) == 3
    for path, line, reason in zip(sources[4:], left_out, ("poked by hand", "poked by hand", "not a run of cpush"), strict=True):
        assert line.startswith(f"{path}: ")
        assert reason in line


@pytest.mark.parametrize(
    ("name", "content", "error"),
    [
        ("StraightLinePertubation.json", None, "was poked by hand in this run"),
        ("run.json", b"[", "run.json: not a run of cpush"),
        ("run.json", b"{}", "not a run of cpush: KeyError: .*timeJSON"),
        ("run.json", public_sets.run_file(300), "the tip goes less than 20 mm"),
        (
            "run.json",
            b'{"timeJSON": [0], "q_sliderJSON": [[1], [2]], "q_pusher_sensedJSON": [[1], [2]]}',
            r"q_sliderJSON must be 3 lists of numbers, got an array of shape \(2, 1\)",
        ),
    ],
)
def test_other_files_are_refused(tmp_path, name, content, error):
    (path,) = runs(tmp_path, name, content=content)
    with pytest.raises(InvalidInput, match=error):
        cpush.read_run(path)
