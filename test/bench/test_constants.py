"""The study of the belief's constants, with few pushes."""

import contextlib
import json

import public_sets
import pytest

from bench import constants as study_of_constants
from bench.paper import pushes, study
from bench.public import mitpush
from pushfric_core.belief import constants, mode
from pushfric_core.errors import InvalidInput


@pytest.fixture
def small(tmp_path, monkeypatch):
    """Public sets of two objects, and one simulated object with few pushes; two constants are tried."""
    source = public_sets.clone(tmp_path / "clone", "abs_rect1_quadratic", "abs_rect3_quadratic")
    mitpush.import_pushes(source, tmp_path / "public")
    right = pushes.objects()["delrin_rect_right"]._replace(pushes=(2, 1, 2, 1))
    monkeypatch.setattr(study_of_constants, "objects", lambda: {"right": right})
    monkeypatch.setattr(study_of_constants, "CHOOSES", {"p_CF": ("WIDER",), "doubts": ("LATEST",)})
    return tmp_path


def test_each_constant_is_halved_and_doubled(small):
    study.study(small / "out", None, None, True, [small / "public"], 1, None)
    gains, halves = json.loads((small / "out/study.json").read_text()).values()
    assert [*gains] == ["WIDER = 1.5", "WIDER = 6.0", "LATEST = 3", "LATEST = 12"]
    assert {study_of_constants.SIMULATION, *study_of_constants.HALVES} < {*gains["WIDER = 6.0"]}
    assert gains["WIDER = 1.5"][study_of_constants.SIMULATION] != gains["WIDER = 6.0"][study_of_constants.SIMULATION] != 0
    judged = {f"{half}, {whose}": 7 for half in study_of_constants.HALVES for whose in ("used", "chosen")}
    assert {name: row["cases"] for name, row in halves.items() if 0 <= row["held"] <= 7} == judged
    assert "| WIDER = 1.5 | p_CF |" in (small / "out/study.md").read_text()


def test_a_half_is_judged_by_what_the_rest_chooses():
    trial = {value: study_of_constants.Trial("p_CF", (("WIDER", value),), 1, ()) for value in (1.5, 6.0)}

    def gain(simulated, one, other, error=0.1):
        values = dict(zip((study_of_constants.SIMULATION, *study_of_constants.HALVES), (simulated, one, other), strict=True))
        return values | {f"{part} error": error for part in values}

    gains = {trial[1.5]: gain(0.1, 5.0, 0.3), trial[6.0]: gain(0.2, -9.0, 0.0)}
    for half in study_of_constants.HALVES:
        assert study_of_constants._chosen(gains, half) == (("WIDER", 1.5),)  # by the other half
    assert study_of_constants._chosen({trial[6.0]: gain(0.1, 0.1, 9.0)}, half) == ()  # not clearly better


def test_constants_have_other_values_only_meanwhile():
    used = constants.WIDER
    with contextlib.suppress(ZeroDivisionError), study_of_constants.set_to((("WIDER", 9.0),)):
        assert (mode.WIDER, constants.WIDER) == (9.0, 9.0)
        raise ZeroDivisionError
    assert mode.WIDER == constants.WIDER == used != 9.0


def test_every_constant_has_a_topic():
    named = {name for name in vars(constants) if name.isupper()}
    assert sorted(name for names in study_of_constants.CHOOSES.values() for name in names) == sorted(named)


def test_public_sets_are_for_the_constants(tmp_path):
    with pytest.raises(InvalidInput, match="--public is for --constants"):
        study.study(tmp_path, 1, None, public=[tmp_path])
