"""Arguments that make no sense are refused by name: they would give wrong figures, or a computation that never ends."""

import math

import pytest

from pushfric_core import (
    TABLE_1,
    FrictionModel,
    LimitSurface,
    Pose,
    PushedObject,
    PushingLine,
    Touch,
    motion_cone,
    predict,
    predict_strokes,
    pushed_motion,
    stability,
)

KNOWN = TABLE_1["wood_rect4"]
OUTLINE, SUPPORT = KNOWN.outline, KNOWN.support
MODEL, LINE = FrictionModel.of(SUPPORT, 0.3), PushingLine((0.0, -0.1), (0.0, 1.0), 0.003)
CONTACT, FORWARD = (0.01, -0.03), (0.0, 0.02)
OF_VECTORS = {
    "predict": lambda normal: predict(MODEL, [CONTACT], [normal], [FORWARD]),
    "motion_cone": lambda normal: motion_cone(MODEL, [CONTACT], [normal]),
    "stability": lambda normal: stability(MODEL, [CONTACT], [normal], [0.01], [(0.1, 0.0)], [1]),
    "reachable": lambda normal: LimitSurface(SUPPORT).reachable([CONTACT], [normal], 0.3),
    "pushed_motion": lambda normal: pushed_motion(SUPPORT, Touch(0.0, CONTACT, normal, 0), FORWARD, 0.3),
    "first_touch": lambda direction: OUTLINE.first_touch((0.0, 0.1), direction),
    "first_touches": lambda direction: OUTLINE.first_touches([(0.0, 0.1)], [direction], [0.003]),
    "PushingLine": lambda direction: PushingLine((0.0, 0.1), direction, 0.003),
}


@pytest.mark.parametrize("vector", [(0.0, -2.0), (0.0, 0.0), (0.0, math.nan)])
@pytest.mark.parametrize("name", OF_VECTORS)
def test_normals_and_directions_are_unit_vectors(name, vector):
    with pytest.raises(ValueError, match="must have length 1, got "):
        OF_VECTORS[name](vector)
    OF_VECTORS[name]((0.0, -1.0))


def strokes(pose=(0.0, 0.0, 0.0), position=0.08):
    return predict_strokes(MODEL, OUTLINE, [Pose(*pose)], [LINE], [position])


@pytest.mark.parametrize(
    ("call", "text"),
    [
        (lambda: strokes(position=math.nan), "positions must be finite, got nan"),
        (lambda: strokes(position=80.0), "positions must lie within 3 m, got 80: are these millimetres?"),
        (lambda: strokes(pose=(0.0, math.inf, 0.0)), "poses must be finite"),
        (lambda: PushingLine((0.0, math.nan), (0.0, 1.0), 0.003), "the origin of the pushing line must be finite"),
        (lambda: PushingLine((0.0, 0.0), (0.0, 1.0), -0.003), "a tip radius must be at least 0 and finite, got -0.003"),
        (lambda: PushingLine((0.0, 0.0), (0.0, 1.0), math.nan), "a tip radius must be at least 0 and finite, got nan"),
        (lambda: PushedObject(OUTLINE, SUPPORT, -0.3, Pose(0.0, 0.0, 0.0)).push(LINE, 0.08), "mu_c must be at least 0"),
    ],
)
def test_numbers_that_make_no_sense_are_named(call, text):
    with pytest.raises(ValueError, match=text):
        call()
