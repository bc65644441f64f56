import numpy as np
import pytest

from pushfric_core import Outline, Pose, PoseSample, PusherSample, PushingLine
from pushfric_core.trajectories.observation_maker import ObservationMaker
from pushfric_core.trajectories.sensed_force import ForceSample

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
    add = {PoseSample: maker.add_pose, PusherSample: maker.add_pusher, ForceSample: maker.add_force}
    return [observation for sample in what for observation in add[type(sample)](sample)]


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
        maker.add_force(ForceSample(1, (0.0, 1.0)))
