"""By how much the clocks of poses and pusher states differ, from pushes that begin, go on evenly, and end at rest."""

import dataclasses

import numpy as np
import pytest
from scipy.special import stdtrit
from test_trajectory import feed

from pushfric_core import Outline, Pose, PoseSample, PusherSample, PushingLine, Trajectory, TrajectoryConfig
from pushfric_core.trajectories.clocks import Clocks, student
from pushfric_core.trajectories.ledger import DoubtCode

OUTLINE = Outline.rectangle(0.1, 0.06)
LINE = PushingLine((0.0, 0.0), (0.0, 1.0), 0.003)
SPEED, CONTACT, END = 0.02, 0.01, 0.05  # [m/s], stroke positions at which the tip meets the object, and stops [m]
DEPTH = 0.002  # the tip is said to be this much too far ahead, in all pushes [m]
PERIOD = 6.0  # from push to push [s]


def watched(offset, noise, rng, config=None, stops=True, turn=0.0, count=8, taken=9.0):
    """Pushes through the middle of an object, whose poses are stamped later by an offset [s] and have an error [m].

    So long [s] after the end of each, a hand lays the object where the next one begins.
    """
    trajectory, samples = Trajectory(OUTLINE, config), []
    for push in range(count + 1):
        start, rest = push * PERIOD, END / SPEED
        for time in np.arange(0.0, PERIOD - 0.5, 0.05):
            tip = min(time * SPEED, END) if time < rest + 0.1 else 0.0
            moving = time < rest - 1e-9
            line = dataclasses.replace(LINE, origin=(turn * time, 0.0))
            push_id = push if moving or (stops and time < rest + 0.1) else None
            stamp = round((start + time) * 1e9)
            samples.append((stamp, PusherSample(stamp, tip + DEPTH, SPEED if moving else 0.0, line, push_id)))
        for time in np.arange(rng.uniform(0, 0.07), PERIOD - 0.5, 1 / 14):
            y = max(CONTACT, min(time * SPEED, END) if time < END / SPEED + taken else 0.0) + LINE.tip_radius + 0.03
            x, dy = rng.normal(0.0, noise, 2)
            samples.append((start * 1e9 + time * 1e9, PoseSample(round((start + time + offset) * 1e9), Pose(x, y + dy, 0.0))))
    feed(trajectory, [sample for _, sample in sorted(samples, key=lambda one: one[0])])
    return trajectory


@pytest.mark.parametrize("taken", [9.0, 0.7])
@pytest.mark.parametrize("offset", [-0.1, -0.03, 0.0, 0.06, 0.1])
def test_the_lag_is_that_of_the_stamps(offset, taken):
    """Although the tip's place has an error."""
    lag = watched(offset, 1e-6, np.random.default_rng(1), taken=taken).lag
    assert lag.mean == pytest.approx(offset, abs=1e-3)
    assert lag.radius < 1e-3


def test_nine_of_ten_intervals_hold_the_lag():
    offsets = np.linspace(-0.1, 0.1, 30)
    lags = [watched(offset, 3e-4, np.random.default_rng(number)).lag for number, offset in enumerate(offsets)]
    assert np.mean([abs(lag.mean - offset) <= lag.radius for lag, offset in zip(lags, offsets, strict=True)]) >= 0.8
    assert max(abs(lag.mean - offset) for lag, offset in zip(lags, offsets, strict=True)) < 0.015


def codes(trajectory):
    return {doubt.code for doubt in trajectory.ledger().doubts}


def test_a_large_lag_is_doubted_until_it_is_corrected():
    late = watched(0.08, 1e-4, np.random.default_rng(2))
    (doubt,) = [one for one in late.ledger().doubts if one.code is DoubtCode.CLOCKS_DIFFER]
    assert doubt.text.startswith("the motion shows that poses are stamped 0.0")
    assert "pose_lag: 0.0" in doubt.text
    assert DoubtCode.CLOCKS_DIFFER not in codes(watched(0.02, 1e-4, np.random.default_rng(2)))
    corrected = watched(0.08, 1e-4, np.random.default_rng(2), TrajectoryConfig(pose_lag=round(late.lag.mean, 3)))
    assert DoubtCode.CLOCKS_DIFFER not in codes(corrected)
    assert abs(corrected.lag.mean) < 1e-3
    worse = watched(0.08, 1e-4, np.random.default_rng(2), TrajectoryConfig(pose_lag=-0.1))
    assert f"pose_lag: {late.lag.mean:.3f} corrects it" in " ".join(worse.ledger().lines)


@pytest.mark.parametrize("how", [{"stops": False}, {"turn": 1e-3}, {"count": 4}])
def test_pushes_that_cannot_show_a_lag_show_none(how):
    """The tip was not seen to stop, does not keep to its line, or has pushed too seldom."""
    assert watched(0.05, 1e-4, np.random.default_rng(3), **how).lag is None


@pytest.mark.parametrize("freedom", [2, 3, 4, 7, 30])
def test_the_quantile_agrees_with_that_of_a_library(freedom):
    assert student(freedom) == pytest.approx(stdtrit(freedom, 0.95), rel=3e-3)


@pytest.mark.parametrize("goes", [(0, 0), (0, 1), (1, 0)])
def test_stamps_that_stand_still_show_no_step_of_a_clock(goes):
    clocks = Clocks()
    for received, stream in sorted((count * period, stream) for stream, period in enumerate((33, 50)) for count in range(900)):
        clocks.add(stream, goes[stream] * received * 10**6, received * 10**6)
    assert clocks.step is None
