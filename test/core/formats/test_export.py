"""What an exported file says, read by other programs' readers."""

import json
import os
import re
import stat
import xml.etree.ElementTree as ElementTree

import numpy as np
import pytest
import shapely
import yaml
from calls import printed
from exported import OBJECTS

from pushfric_core import Estimator, InvalidInput, Observation, Twist, export, load
from pushfric_core.commands import COMMANDS
from pushfric_core.files.estimator_settings import EstimatorSettings
from pushfric_core.files.model_file import SampleFile, load_model, make_model, save_model
from pushfric_core.files.object_file import load_object
from pushfric_core.formats.body import GRAVITY, MASS, TABLE_FRICTION, TOLERANCE, ExportedBody, few_feet, load_of
from pushfric_core.formats.export import FORMATS

LOAD = load_of(0.3, 0.25, GRAVITY, None)


def exported(name, to, **options):
    outline, model = OBJECTS[name]
    return export(model, outline, to, name=name, mass=0.3, table_friction=0.25, **options)


def written(folder, files):
    for name, text in files.items():
        (folder / name).write_text(text)
    return folder / next(iter(files))


@pytest.mark.parametrize("name", ["delrin_rect_center", "delrin_rect_right", "ell"])
def test_a_few_feet_slide_like_the_support(name):
    support = OBJECTS[name][1].support
    feet = few_feet(support)
    assert len(feet.support.weights) < 25 < np.count_nonzero(support.weights)
    assert feet.support.center_of_friction == pytest.approx(support.center_of_friction, abs=1e-5)
    assert feet.error.load <= TOLERANCE.load
    assert feet.error.twist <= TOLERANCE.twist


def test_sdf_names_are_unique_and_its_friction_is_that_of_the_model():
    (text,) = exported("wood_rect4", "sdf").values()
    model = ElementTree.fromstring(text).find("model")
    names = [child.get("name") for child in model]
    assert len(set(names)) == len(names) == 2 * (3 + 4)
    found = {link.get("name"): link.findtext("collision/surface/friction/ode/mu") for link in model.iter("link")}
    assert found == {"slide_x": None, "slide_y": None, "shell": "0.3"} | {f"foot_{k}": "0.25" for k in range(4)}


@pytest.mark.parametrize("name", ["triangle", "ell"])
def test_the_pieces_of_the_shell_are_convex_and_make_up_the_outline(name):
    outline, model = OBJECTS[name]
    prisms = ExportedBody(name, outline, model, LOAD).prisms
    pieces = [shapely.Polygon(prism[: len(prism) // 2, :2]) for prism in prisms]
    assert len(pieces) == {"triangle": 1, "ell": 2}[name]
    assert all(piece.exterior.is_ccw and piece.area == pytest.approx(piece.convex_hull.area) for piece in pieces)
    assert shapely.union_all(pieces).symmetric_difference(outline.polygon).area < 1e-12


@pytest.mark.parametrize(
    ("given", "expected"),
    [
        ((None, None, None), (MASS, TABLE_FRICTION, ("table friction", "mass"))),
        ((0.5, None, None), (0.5, TABLE_FRICTION, ("table friction",))),
        ((0.5, None, 0.981), (0.5, 0.2, ())),
        ((None, 0.2, 0.981), (0.5, 0.2, ())),
        ((None, None, 0.981), (0.1 / TABLE_FRICTION, TABLE_FRICTION, ("table friction",))),
    ],
)
def test_two_of_mass_coefficient_and_total_friction_give_the_third(given, expected):
    mass, coefficient, total = given
    load = load_of(mass, coefficient, GRAVITY, total)
    assert (load.mass, load.table_friction, load.assumed) == (
        pytest.approx(expected[0]),
        pytest.approx(expected[1]),
        expected[2],
    )


@pytest.mark.parametrize(
    ("options", "expected"),
    [
        ({"to": "usd"}, "expected one of the formats mjcf, sdf"),
        ({"mass": 0.0}, "mass must be positive and finite, got 0"),
        ({"height": 0.001}, "height must be more than 0.002 m, got 0.001"),
        ({"height": 100.0}, "height must lie within 3 m, got 100: are these millimetres?"),
        ({"pusher_radius": -1.0}, "pusher_radius must be positive and finite, got -1"),
        ({"mass": 1.0, "table_friction": 0.3, "total_friction": 2.0}, "expected mass or table_friction, not both"),
    ],
)
def test_what_makes_no_sense_is_refused(options, expected):
    outline, model = OBJECTS["wood_rect4"]
    with pytest.raises(ValueError, match=expected):
        export(model, outline, **{"to": "mjcf", **options})
    (text,) = export(model, outline, "mjcf", name="a\x01b\x1f").values()
    assert ElementTree.fromstring(text).get("model") == "ab"


@pytest.fixture
def model_file(tmp_path):
    known = load_object("wood_rect4")
    pushes = [((0.02, -0.032), (0.0, -1.0), 0.2), ((-0.03, -0.032), (0.0, -1.0), -0.25), ((0.03, 0.032), (0.0, 1.0), -0.2)]
    data = [
        Observation(contact, normal, Twist(0.0, -0.02 * normal[1], turn), k) for k, (contact, normal, turn) in enumerate(pushes)
    ]
    points = len(known.support_points)
    samples = [SampleFile(w=np.eye(points)[[k, -1 - k]].mean(axis=0).tolist(), mu_c=0.3, weight=0.5) for k in (0, 1)]
    model = make_model(known, Estimator(known.support_points).add(data), "a test", EstimatorSettings())
    path = tmp_path / "model.yaml"
    before = os.umask(0o027)
    try:
        belief = model.belief.model_copy(update={"samples": tuple(samples)})
        save_model(model.model_copy(update={"belief": belief}), path)
    finally:
        os.umask(before)
    return path


def test_the_command_promises_the_formats_that_there_are():
    *names, last = map(str.upper, FORMATS)
    assert COMMANDS["export"].endswith(f": {', '.join(names)} or {last}.")


def test_the_command_writes_the_mean_or_samples(model_file, tmp_path):
    out = tmp_path / "new" / "out"
    printed("export", model_file, "--to", "json", "--mass", 0.3, "--out", out)
    (written,) = out.iterdir()
    content = json.loads(written.read_text())
    assert written.name == "wood_rect4.json"
    assert content["comments"][0].startswith("wood_rect4: 3 observations of 3 pushes from a test; verdict: ")
    assert content["mass"] == 0.3
    printed("export", model_file, "--to", "mjcf", "--samples", 12, "--out", out)
    scenes = sorted(path for path in out.iterdir() if path.suffix == ".xml")
    assert [scene.name for scene in scenes] == [f"wood_rect4_{k:02d}.xml" for k in range(12)]
    assert len({scene.read_text().partition("<worldbody>")[2] for scene in scenes}) == 2
    with pytest.raises(InvalidInput, match=r"model.yaml: cannot be exported: expected one of the formats"):
        printed("export", model_file, "--to", "usd", "--out", out)
    with pytest.raises(InvalidInput, match=r"height must be .*, got 0"):
        printed("export", model_file, "--to", "mjcf", "--height", 0, "--out", out)
    with pytest.raises(InvalidInput, match="the folder cannot be created: "):
        printed("export", model_file, "--to", "mjcf", "--out", model_file)
    content = yaml.safe_load(model_file.read_text())
    content["belief"]["samples"] = [content["belief"]["samples"][0] | {"weight": 1.0}]
    model_file.write_text(yaml.safe_dump(content))
    with pytest.raises(InvalidInput, match="has a single sample, not some to draw 12 models from"):
        printed("export", model_file, "--to", "mjcf", "--samples", 12, "--out", out)


def test_a_model_that_is_read_back_says_what_it_is_in_a_line(model_file):
    assert re.fullmatch(
        r"model of \S+: p_CF \(-?[\d.]+, -?[\d.]+\) mm, from \d+ observations? of \d+ push(es)? in .*", str(load(model_file))
    )
    with pytest.raises(
        InvalidInput, match="nothing: no such file; expected a bag, a CSV of observations, a model or an object"
    ):
        load("nothing")


def test_a_model_keeps_its_verdict_and_has_the_mode_of_the_umask(model_file):
    assert stat.S_IMODE(model_file.stat().st_mode) == 0o640
    file, _ = load_model(model_file)
    assert any(reason in file.rests_on for reason in (*file.made.verdict, "may be used"))


def test_a_model_of_another_version_is_refused_and_one_without_is_of_this(model_file):
    content = yaml.safe_load(model_file.read_text())
    assert content.pop("format") == 3
    model_file.write_text(yaml.safe_dump(content))
    assert load_model(model_file)[0].format == 3
    model_file.write_text(yaml.safe_dump({**content, "format": 4, "news": 1}))
    with pytest.raises(InvalidInput, match=r"model.yaml: expected a model of format 3, got format 4"):
        load_model(model_file)
