"""What an estimate and its observations look like: as text, as a table, as a dictionary, as a picture."""

import dataclasses
import importlib.util
import pathlib

import numpy as np
import pandas
import pytest
from matplotlib.figure import Figure
from missing import python_without
from problems import FULL, observations_of

from pushfric_core import TABLE_1, Estimator, MissingPackage, Observations, load
from pushfric_core.bags.bag import DamagedBag
from pushfric_core.errors import installing

ROOT = pathlib.Path(__file__).resolve().parents[2]
BAG = ROOT / "bags/rubber_rect4"
KNOWN = TABLE_1["rubber_rect4"]
DATA = observations_of(KNOWN.outline, KNOWN.support, KNOWN.mu_c, 12, np.random.default_rng(5))

EXTRAS = {"mcap", "rosbags", "lz4", "zstandard", "cv2", "serial", "matplotlib", "PIL", "osqp", "pandas"}


@pytest.fixture(scope="module")
def estimate():
    return Estimator(KNOWN.support_points, outline=KNOWN.outline).add(DATA)


def test_print_gives_three_lines_for_a_person(estimate):
    center, friction, rests_on = str(estimate).splitlines()
    x, y = 1e3 * estimate.center_of_friction
    u, v = 1e3 * estimate.believed_center
    believed = f"({u:z.2f}, {v:z.2f}) mm, within {1e3 * estimate.confidence:.2f} mm with 90 % probability"
    assert center == f"p_CF   {believed}; ({x:z.2f}, {y:z.2f}) mm by the program"
    assert friction.startswith("mu_c   ")
    assert f"lower bounds up to {estimate.mu_c_max:.3f}" in friction
    assert rests_on == "from   12 observations of 12 pushes; may be used"
    assert repr(estimate) == f"<Estimate: p_CF ({x:z.2f}, {y:z.2f}) mm from 12 observations of 12 pushes, optimal>"


def test_an_estimate_keeps_its_observations_while_the_estimator_goes_on():
    estimator = Estimator(KNOWN.support_points)
    course = [estimator.add(observation) for observation in DATA]
    estimator.exclude(DATA[0].push_id)
    for count, estimate in enumerate(course, 1):
        assert estimate.observations == tuple(DATA[:count])
    assert estimator.observations == tuple(DATA[1:]) == estimator.estimate().observations


def test_observations_as_a_table_are_read_again(tmp_path):
    full = dataclasses.replace(FULL, contact_point=(0.01, -0.032))
    frame = Observations([*DATA, full]).to_frame()
    assert len(frame) == 13
    assert frame["force_x"].isna().sum() == 12
    last = frame.iloc[-1]
    assert (last["push_id"], last["stamp"], last["duration"], last["depth"]) == (7, 123456789, 0.3, 2 / 7000)
    assert tuple(last[["pose_x", "pose_y", "pose_theta"]]) == (0.1, 0.2, -0.3)
    frame.to_csv(tmp_path / "pushes.CSV", index=False)
    read = load(tmp_path / "pushes.CSV", object="rubber_rect4")
    names = ["contact_point", "contact_normal", "twist", "push_id", "half_width", "force", "tip_velocity", "duration", "stamp"]
    for one, another in zip(read, [*DATA, full], strict=True):
        assert all(getattr(one, name) == getattr(another, name) for name in names)
    assert read[-1].depth == full.depth
    pandas.testing.assert_frame_equal(read.to_frame().iloc[:, :13], frame.iloc[:, :13], check_exact=True)


def test_load_warns_of_what_is_missing_in_a_damaged_bag(tmp_path):
    (mcap,) = BAG.glob("*.mcap")
    content = bytearray(mcap.read_bytes())
    for file in (BAG / "object.yaml", BAG / "metadata.yaml"):
        (tmp_path / file.name).write_bytes(file.read_bytes())
    (tmp_path / mcap.name).write_bytes(content[: len(content) // 2])
    with pytest.raises(DamagedBag):
        load(tmp_path)
    with pytest.warns(UserWarning, match=mcap.name) as warned:
        recording = load(tmp_path, partial=True)
    assert 0 < len(recording) < len(load(BAG))
    assert {warning.filename for warning in warned if warning.category is UserWarning} == {__file__}


def test_the_picture_shows_the_object_w_the_ellipse_and_the_pushes(estimate):
    axes = Figure().subplots()
    assert estimate.plot(axes) is axes
    outline, *_ = axes.lines
    assert np.allclose(outline.get_xydata()[:-1], 1e3 * KNOWN.outline.vertices)
    assert {text.get_text() for text in axes.get_legend().get_texts()} == {
        "estimated $w$",
        "$w < 0.001$",
        "estimated $p_{CF}$",
        "90 % ellipse",
        "contacts",
    }
    (contacts,) = [line for line in axes.lines if line.get_label() == "contacts"]
    assert np.allclose(contacts.get_xydata(), [1e3 * np.array(o.contact_point) for o in DATA])
    (arrows,) = [drawn for drawn in axes.collections if type(drawn).__name__ == "Quiver"]
    assert arrows.N == 12  # one for each push
    (ellipse,) = axes.patches
    assert np.allclose(ellipse.center, 1e3 * estimate.believed_center)


def test_a_notebook_shows_picture_and_text(estimate, monkeypatch):
    page = estimate._repr_html_()
    assert 'src="data:image/png;base64,' in page
    assert f"<pre>{estimate}</pre>" in page
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    assert estimate._repr_html_() == f"<pre>{estimate}</pre>"


@pytest.mark.parametrize(
    ("code", "said"),
    [
        ("estimate.to_frame()", "to_frame needs the package pandas: " + installing("pandas")),
        ("estimate.plot()", "plot needs the package matplotlib: " + installing("plot")),
        (f"p.load({str(BAG)!r})", f"the bag {BAG} needs the package zstandard: " + installing("bags")),
    ],
)
def test_a_missing_extra_is_named_with_the_command_that_installs_it(code, said, tmp_path):
    before = """
import pushfric_core as p
data = p.Observations([p.Observation((0.01, -0.03), (0.0, -1.0), p.Twist(0.0, 0.02, 0.1))])
estimate = p.Estimator([[-0.05, 0.0], [0.05, 0.0]]).add(data)
"""
    program = f"{before}\ntry:\n    {code}\nexcept p.MissingPackage as error:\n    print(error)"
    found = python_without(EXTRAS, program, tmp_path)
    assert found.stdout == f"{said}\n", found.stderr
    assert issubclass(MissingPackage, ImportError)
    assert installing("plot") == f"pip install '{pathlib.Path(__file__).parents[2]}/src/pushfric_core[plot]'"
