"""A model is read as it was written, to the last bit; an impossible one is refused in one line."""

import dataclasses
import math

import numpy as np
import pytest
import yaml
from problems import FULL, three_feet

from pushfric_core import Estimator, EstimatorConfig, InvalidInput, friction_model, load
from pushfric_core.files.estimator_settings import EstimatorSettings
from pushfric_core.files.model_file import ObservationEntry, load_model, make_model, save_model
from pushfric_core.files.object_file import ObjectFile, SupportFile, make_object

PROBLEM = three_feet()
FILE = ObjectFile(
    name="three feet",
    outline=[tuple(corner) for corner in PROBLEM.outline.vertices.tolist()],
    support=SupportFile(grid=(6, 6), inset=0.01),
)


def estimated(data):
    model = make_object(FILE, "here")
    estimator = Estimator(model.support_points, EstimatorConfig(screening=False))
    return model, estimator.add(data), estimator.observations


@pytest.fixture
def path(tmp_path):
    model, estimate, _ = estimated(PROBLEM.observations)
    path = tmp_path / "model.yaml"
    save_model(make_model(model, estimate, "a test", EstimatorSettings()), path)
    return path


def test_what_is_saved_is_read_to_the_last_bit(path):
    model, estimate, observations = estimated(PROBLEM.observations)
    file, read = load_model(path)
    assert tuple(file.observations()) == observations
    assert read.outline == model.outline
    assert np.array_equal(read.support_points, model.support_points)
    assert file.friction() == friction_model(estimate)
    assert EstimatorSettings.from_parameters(file.made.settings) == EstimatorSettings()
    again = estimated(file.observations())[1]
    assert np.array_equal(again.w, estimate.w)
    assert (file.made.data_points, file.made.source) == (len(observations), "a test")
    assert file.versions.keys() >= {"python", "pushfric_core", "numpy"}


def test_all_that_a_data_point_brings_is_kept(tmp_path):
    assert all(getattr(FULL, field.name) != field.default for field in dataclasses.fields(FULL)), "a field is not tried"
    model, estimate, _ = estimated([FULL])
    path = tmp_path / "model.yaml"
    save_model(make_model(model, estimate, "a test", EstimatorSettings()), path)
    assert load_model(path)[0].observations() == [FULL]
    assert len(ObservationEntry.model_fields) == len(dataclasses.fields(FULL))


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        ({"w": [1.0]}, "expected w of 21 weights with sum 1, got 1"),
        ({"format": 1}, "expected a model of format 3, got format 1"),
        (
            {"object": ObjectFile(name="x", outline=FILE.outline).model_dump(mode="json")},
            "expected the support of the object as",
        ),
        (
            {"data_points": [{"contact": [1, 1], "normal": [1, 0], "twist": [1, 0, 0], "push_id": 0}]},
            "within 5 mm of the outline",
        ),
        ({"data_points": [{"contact": [0, 0], "normal": [1, 1], "twist": [1, 0, 0], "push_id": 0}]}, "must have length 1"),
    ],
)
def test_a_file_that_makes_no_sense_is_refused_with_one_line(path, change, expected):
    path.write_text(yaml.safe_dump(yaml.safe_load(path.read_text()) | change))
    with pytest.raises(InvalidInput, match=expected) as refused:
        load_model(path)
    assert str(refused.value).startswith(str(path))
    assert "\n" not in str(refused.value)


def test_samples_that_fit_no_support_are_refused(path):
    content = yaml.safe_load(path.read_text())
    content["belief"]["samples"] = [{"w": [1.0], "mu_c": 0.3, "weight": 1.0}]
    path.write_text(yaml.safe_dump(content))
    with pytest.raises(InvalidInput, match=r"expected belief\.samples\.0\.w of 21 weights with sum 1, got 1"):
        load_model(path)


def test_a_model_is_loaded_with_the_names_of_the_json_of_an_estimate(path):
    _, estimate, _ = estimated(PROBLEM.observations)
    told, found = estimate.to_dict(), load(path)
    for names, of in ((told, found), (told["belief"], found.belief)):
        for name in ("w", "center_of_friction"):
            assert list(getattr(of, name)) == names[name]
    belief = told["belief"]
    assert (np.array(found.belief.covariance).tolist(), found.belief.radius) == (belief["covariance"], belief["radius"])
    mu_c = found.belief.mu_c
    assert {"value": mu_c.value, "interval": list(mu_c.interval), "kind": mu_c.kind} == belief["mu_c"]
    assert mu_c.interval[1] == math.inf


def test_an_object_is_loaded_by_its_name_or_its_file(tmp_path):
    (tmp_path / "plate.yaml").write_text(
        "name: plate\noutline: [[0, 0], [0.1, 0], [0.1, 0.06], [0, 0.06]]\nsupport: {grid: [4, 3]}\n"
    )
    for source, name, count in (("wood_rect4", "wood_rect4", 15), (tmp_path / "plate.yaml", "plate", 12)):
        found = load(source)
        assert (found.name, found.support_points.shape) == (name, (count, 2))


def test_nothing_is_left_where_nothing_can_be_written(path, tmp_path):
    file, _ = load_model(path)
    with pytest.raises(InvalidInput, match=r"expected the name of a file that ends with \.yaml"):
        save_model(file, tmp_path / "model.txt")
    with pytest.raises(InvalidInput, match="the folder cannot be created: "):
        save_model(file, tmp_path / "model.yaml/model.yaml")
    assert [entry.name for entry in tmp_path.iterdir()] == ["model.yaml"]
    save_model(file, tmp_path / "new/folder/model.yaml")
    assert load_model(tmp_path / "new/folder/model.yaml")[0].w == file.w
