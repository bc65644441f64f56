"""Which measured forces are those of a sliding tip, by their ratios alone: a sliding tip has the ratio mu_c, whatever the push.

The ratio of shear to normal force is a mixture. It is mu_c to either side while the tip slides, evenly spread between while the
tip sticks, and anything if something disturbed the sensor. All of it is off by as much as the sensor is turned against the
normals. Expectation and maximisation find the shares of the four, for a grid of the other parameters.
"""

import math
from typing import NamedTuple

import numpy as np

from pushfric_core.geometry.planar import LEAST_DIVISOR, Array

RANGE, TRIED = (0.1, 0.98), 40
"""Between these quantiles of the sizes of the ratios, so many values are tried as mu_c ..."""

WIDTHS = np.array((0.05, 0.1, 0.2))
"""... with these standard deviations, as shares of it: friction differs from place to place ..."""

TURNS = np.linspace(-0.1, 0.1, 11)
"""... and these angles between the axes of the sensor and those of the contacts [rad]."""

QUANTILES = 200
"""If there are more ratios, this many quantiles stand for them."""

ROUNDS = 15
"""Steps of expectation and maximisation."""

BEGIN = np.array((0.25, 0.25, 0.4, 0.1))
"""Shares of contacts that slide to the left and to the right, that stick, and that are disturbed, to begin with."""

GAIN = 10.0
"""The logarithm of the likelihood must grow by more than this, or the ratios do not show that the tip slides. Chance alone
brings up to 5 with 10 to 100 sticking contacts."""

LEAST_SHARE, LEAST_SIDE = 0.3, 0.1
"""So many of the contacts must slide, and so many to either side: a push that is repeated has one ratio, too, although it
sticks."""


class Sliding(NamedTuple):
    """The pile among the ratios of m contacts."""

    probability: Array  # (m,) that a contact slides
    sizes: Array  # (m,) of the ratios, about the middle of both sides: mu_c where the tip slides


def sliding(ratios: Array) -> Sliding | None:
    """The pile among ratios (m,) of measured forces, F . t / |F . n|; None if they do not show that the tip slides."""
    sample = np.quantile(ratios, np.linspace(0, 1, QUANTILES)) if len(ratios) > QUANTILES else ratios
    low, usual, high = np.quantile(np.abs(sample), (RANGE[0], 0.5, RANGE[1])).tolist()
    if low < LEAST_DIVISOR:
        return None
    coefficients = np.geomspace(low, high, TRIED)
    tried = np.stack(np.meshgrid(coefficients, WIDTHS, TURNS, indexing="ij")).reshape(3, -1)
    densities = _densities(sample, tried, usual)
    shares, fits = _mixed(densities, BEGIN)
    _, without = _mixed(densities[2:], BEGIN[2:])
    best = int(np.argmax(fits))
    gain = float(fits[best] - without.max()) * len(ratios) / len(sample)
    slide = shares[:2, best]
    if gain < GAIN or slide.sum() < LEAST_SHARE or slide.min() < LEAST_SIDE:
        return None
    parts = shares[:, best, None] * _densities(ratios, tried[:, best : best + 1], usual)[:, 0]
    return Sliding(parts[:2].sum(axis=0) / parts.sum(axis=0), np.abs(ratios - tried[2, best]))


def _densities(ratios: Array, tried: Array, usual: float) -> Array:
    """(4, t, m) of contacts that slide to either side, stick and are disturbed, for t values (3, t) of the parameters."""
    coefficient, share, turn = tried[:, :, None]
    deviation = coefficient * share
    apart = ratios - turn
    left, right = (
        np.exp(-0.5 * ((apart - side * coefficient) / deviation) ** 2) / (deviation * math.sqrt(2 * math.pi))
        for side in (1, -1)
    )
    stick = np.where(np.abs(apart) <= coefficient, 0.5 / coefficient, 0.0)
    wild = 0.5 * usual / (usual + np.abs(ratios)) ** 2
    return np.stack((left, right, stick, np.broadcast_to(wild, left.shape)))


def _mixed(densities: Array, begin: Array) -> tuple[Array, Array]:
    """The likeliest shares (c, t) of c components with these densities (c, t, m), and the logarithms of the likelihood (t,)."""
    shares = np.repeat(begin[:, None] / begin.sum(), densities.shape[1], axis=1)
    for _ in range(ROUNDS):
        total = np.einsum("ct,ctm->tm", shares, densities)
        shares = shares * np.mean(densities / total, axis=2)
    return shares, np.log(np.einsum("ct,ctm->tm", shares, densities)).sum(axis=1)
