import dataclasses
import math

import numpy as np
import pytest

from pushfric_core import Observation, Outline, Pose, PoseSample, PusherSample, PushingLine, Twist
from pushfric_core.trajectories.observation_maker import ForceMatcher, ForceSample, ObservationMaker

BAR = Outline.rectangle(0.12, 0.06)
LINE = PushingLine((0.0, -0.05), (0.0, 1.0), 0.003)
FRAME, SPEED = 10**9 // 20, 0.02
FRAMES = range(1, 60)


def position(frame):
    return SPEED * frame * FRAME / 1e9


def pose(frame):
    """The bar rests until the tip, which begins at y = -0.05, meets its edge at y = -0.03, and then goes with it."""
    return PoseSample(frame * FRAME, Pose(0.0, max(0.0, position(frame) - 0.017), 0.0))


def pusher(frame):
    return PusherSample(frame * FRAME, position(frame), SPEED, LINE, 0)


def made(maker, what):
    return [observation for sample in what for observation in maker.add(sample)]


def merged(rng, streams):
    """All streams in a random common order."""
    order = rng.permutation([number for number, samples in enumerate(streams) for _ in samples])
    heads = [iter(samples) for samples in streams]
    return [next(heads[number]) for number in order]


def test_with_forces_a_data_point_waits_and_time_is_not_settled():
    maker = ObservationMaker(BAR, with_forces=True)
    assert (maker.settled, maker.waiting) == (0, 0)
    assert made(maker, [sample for frame in FRAMES for sample in (pusher(frame), pose(frame))]) == []
    waiting, settled = maker.waiting, maker.settled
    assert waiting > 3
    assert settled < pusher(FRAMES[-1]).stamp
    found = made(maker, [ForceSample(frame * FRAME + 1, (0.0, float(frame))) for frame in FRAMES])
    assert 0 < len(found) <= waiting
    assert maker.settled > settled
    assert all(np.hypot(*observation.force) > 0 for observation in found)
    assert found[0].stamp == settled + 1  # it was the oldest that waited


def test_a_maker_without_forces_refuses_them():
    maker = ObservationMaker(BAR)
    assert maker.waiting is None
    with pytest.raises(ValueError, match="without forces"):
        maker.add(ForceSample(1, (0.0, 1.0)))


SECOND = 10**9


def moved(seconds, theta=0.0):
    pose = Pose(0.1, 0.2, theta)
    return Observation((0.0, -0.03), (0.0, -1.0), Twist(0.0, 0.02, 0.1), duration=0.2, stamp=round(seconds * SECOND), pose=pose)


def samples(force=lambda seconds: (0.0, seconds), end=5.0):
    return [ForceSample(round(t * SECOND), force(t)) for t in np.arange(0, end, 0.05)]


def feed(sensed, things):
    found = []
    for thing in things:
        found += sensed.add_force(thing) if isinstance(thing, ForceSample) else sensed.add_observation(thing)
    return found


def test_the_force_is_the_mean_over_the_motion_in_the_object_frame():
    found = feed(ForceMatcher(), [moved(1.0), moved(2.0, theta=math.pi / 2), *samples()])
    assert [o.stamp for o in found] == [SECOND, 2 * SECOND]
    assert found[0].force == pytest.approx((0.0, 1.0))  # samples at 0.9, 0.95, 1.0, 1.05, 1.1
    assert found[1].force == pytest.approx((2.0, 0.0))


def test_forces_do_not_depend_on_how_the_topics_interleave(rng):
    points = [moved(t) for t in (0.5, 1.0, 1.7)]
    expected = feed(ForceMatcher(), [*points, *samples()])
    assert len(expected) == 3
    for _ in range(20):
        assert feed(ForceMatcher(), merged(rng, [points, samples()])) == expected


def test_a_data_point_waits_for_the_end_of_its_motion():
    sensed = ForceMatcher()
    assert feed(sensed, [moved(1.0), *samples(end=1.1)]) == []
    assert sensed.waiting_since == SECOND
    assert len(sensed.add_force(ForceSample(round(1.15 * SECOND), (0.0, 0.0)))) == 1
    assert sensed.waiting_since is None


def test_a_data_point_without_samples_during_its_motion_has_no_force():
    late = [ForceSample(3 * SECOND + number, (1.0, 1.0)) for number in range(3)]
    assert feed(ForceMatcher(), [moved(1.0), *late]) == [moved(1.0)]


def test_late_samples_are_ignored():
    sensed = ForceMatcher()
    feed(sensed, samples(end=1.0))
    assert sensed.add_force(ForceSample(0, (9.0, 9.0))) == []
    assert feed(sensed, [moved(0.5), *samples()])[0].force == pytest.approx((0.0, 0.5))


def test_impossible_input_is_refused():
    with pytest.raises(ValueError, match="a force must be finite"):
        ForceMatcher().add_force(ForceSample(0, (math.nan, 0.0)))
    with pytest.raises(ValueError, match="needs its pose"):
        ForceMatcher().add_observation(dataclasses.replace(moved(1.0), pose=None))
