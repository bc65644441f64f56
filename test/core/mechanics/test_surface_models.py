import numpy as np
import pytest
from scipy.optimize import check_grad

from pushfric_core import TABLE_1, LimitSurface, Support, Wrench, convex_quartic, named_ellipsoid

SHIFTED = Support(np.array(((1.0, 2.0), (1.05, 2.0), (1.0, 2.1))), np.array((0.5, 0.3, 0.2)))


def test_the_ellipsoid_by_name_is_the_one_of_the_limit_surface():
    ellipsoid = named_ellipsoid(SHIFTED)
    assert ellipsoid.f_max == 1
    assert ellipsoid.center == pytest.approx(SHIFTED.center_of_friction)
    assert ellipsoid.form().form == pytest.approx(LimitSurface(SHIFTED).ellipsoid().form, rel=1e-9)


def test_the_quartic_is_convex(rng):
    quartic = convex_quartic(SHIFTED)
    center = named_ellipsoid(SHIFTED).center
    for _ in range(200):
        ends = rng.normal(size=(2, 3))
        ends[:, 2] += ends[:, 1] * center[0] - ends[:, 0] * center[1]
        one, other = (Wrench(*end / quartic.load(Wrench(*end))) for end in ends)
        assert quartic.load(Wrench(*(np.add(one, other) / 2))) <= 1 + 1e-12


def test_motions_follow_the_gradient():
    quartic = convex_quartic(TABLE_1["wood_rect3"].support)
    wrench = np.array((0.3, -0.5, 0.01))

    def value(at):
        return quartic.load(Wrench(*at)) ** 4

    def gradient(at):
        return 4 * np.array(quartic.twist(Wrench(*at))) * quartic.load(Wrench(*at)) ** 3

    assert check_grad(value, gradient, wrench) == pytest.approx(0, abs=1e-4)
    twist = quartic.twist(Wrench(*wrench))
    assert np.dot(twist, wrench) == pytest.approx(quartic.load(Wrench(*wrench)))  # unit dissipation
