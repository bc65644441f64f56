import dataclasses
import functools
import re

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from test_observation_maker import merged

from pushfric_core import TABLE_1, Outline, PoseSample, PushedObject, PusherSample, PushingLine, Trajectory, TrajectoryConfig
from pushfric_core.geometry.planar import Pose, Twist, compose, exp, inverse, transform
from pushfric_core.program.contact_friction import tip_at

OUTLINE = Outline.rectangle(0.127, 0.064)
LINE = PushingLine((0.0, 0.0), (0.0, 1.0), 0.003)
FRAME = round(1e9 / 14)


@functools.cache
def samples_of_a_push(push_id=0, frames=40, start=0, speed=0.02, offset=-0.02):
    """What camera and pusher would report of a push of 5 cm."""
    pushed = PushedObject(OUTLINE, TABLE_1["wood_rect4"].support, 0.3, Pose(offset, 0.04, 0.02))
    poses, pushers = [], []
    for frame in range(frames):
        position = min(0.05, frame * speed / 14)
        pushed.push(LINE, position)
        stamp = start + frame * FRAME
        poses.append(PoseSample(stamp, pushed.pose))
        pushers.append(PusherSample(stamp + 3_000_000, position, speed if position < 0.05 else 0.0, LINE, push_id))
    return poses, pushers


def feed(trajectory, samples):
    found = []
    for sample in samples:
        found += trajectory.add_pose(sample) if isinstance(sample, PoseSample) else trajectory.add_pusher(sample)
    return found


def in_time(poses, pushers):
    return sorted([*poses, *pushers], key=lambda sample: sample.stamp)


@settings(derandomize=True, max_examples=30, deadline=None)
@given(
    seed=st.integers(0, 2**31),
    noise=st.sampled_from((0.0, 3e-5, 3e-4)),
    period=st.sampled_from((20_000_000, 50_000_000, 100_000_000)),
    window=st.sampled_from((1, 3, 5, 7)),
    stride=st.integers(1, 6),
)
def test_the_same_samples_give_the_same_observations_in_any_order(seed, noise, period, window, stride):
    """Two pushes, one of them cut short, noisy frames of which some are lost, and a pusher polled at any rate and phase."""
    rng = np.random.default_rng(seed)
    poses, pushers = [], []
    for push_id, (offset, last) in enumerate(((-0.02, 44), (0.03, int(rng.integers(5, 40))))):
        true, _ = samples_of_a_push(frames=45, offset=offset)
        start, phase = push_id * 4_000_000_000, int(rng.integers(period))
        for frame in range(45):
            seen = np.array(true[min(frame, last)].pose) + rng.normal(size=3) * (noise, noise, 10 * noise)
            if rng.random() > 0.02:
                poses.append(PoseSample(start + frame * FRAME, Pose(*seen.tolist())))
        for stamp in range(phase, 45 * FRAME, period):
            position = 0.02 * min(stamp, last * FRAME) * 1e-9
            pushers.append(
                PusherSample(start + stamp, position, 0.02, LINE, push_id if stamp < last * FRAME + period else None)
            )
    config = TrajectoryConfig(window=window, stride=stride)
    expected = feed(Trajectory(OUTLINE, config), [*pushers, *poses])
    assert expected
    mixed = [merged(rng, (poses, pushers)) for _ in range(2)]
    for samples in (in_time(poses, pushers), [*poses, *pushers], *mixed):
        trajectory = Trajectory(OUTLINE, config)
        assert feed(trajectory, samples) == expected
        assert trajectory.settled == min(poses[-1].stamp, pushers[-1].stamp)


def test_an_observation_comes_with_its_last_frame_if_the_object_moves_on_as_before():
    poses, pushers = samples_of_a_push()  # states 3 ms after the frames
    trajectory = Trajectory(OUTLINE)
    completing = [sample for sample in in_time(poses, pushers) if feed(trajectory, [sample])]
    assert len(completing) >= 3
    assert all(sample in poses for sample in completing)


def test_an_observation_waits_for_the_pusher_if_the_object_slows_down():
    poses, pushers = samples_of_a_push()
    trajectory = Trajectory(OUTLINE)
    last = next(frame for frame in range(len(poses)) if feed(trajectory, [poses[frame], pushers[frame]]))
    trajectory = Trajectory(OUTLINE)
    assert feed(trajectory, in_time(poses[:last], pushers[:last])) == []
    assert feed(trajectory, [poses[last]._replace(pose=poses[last - 1].pose)]) == []
    assert len(feed(trajectory, [pushers[last]])) == 1


def test_no_frame_from_after_a_push_completes_an_observation():
    """The push ends between two frames: the object moves less before the last of them, then it rests."""
    poses, pushers = samples_of_a_push(frames=30)
    last = 20
    for done in (0.0, 0.3, 0.7):  # fraction of the way to the next frame
        a, b = np.array(poses[last].pose), np.array(poses[last + 1].pose)
        rest = Pose(*(a + done * (b - a)).tolist())
        stopped = [*poses[: last + 1], *(pose._replace(pose=rest) for pose in poses[last + 1 :])]
        states = [*pushers[: last + 1], *(state._replace(push_id=None) for state in pushers[last + 1 :])]
        for stride in (1, 2, 3, 5):
            config = TrajectoryConfig(stride=stride)
            found = feed(Trajectory(OUTLINE, config), in_time(stopped, states))
            assert found
            assert max(o.stamp for o in found) <= poses[last - 3].stamp


def test_the_motion_is_the_central_difference_of_smoothed_poses():
    # a constant twist along the line: smoothing leaves a uniform translation as it is
    velocity, start = 0.02, Pose(0.0, 0.04, 0.0)
    poses = [PoseSample(k * FRAME, Pose(0.0, start.y + velocity * k * FRAME * 1e-9, 0.0)) for k in range(12)]
    pushers = [PusherSample(k * FRAME, 0.005 + velocity * k * FRAME * 1e-9, velocity, LINE, 3) for k in range(-1, 12)]
    first = feed(Trajectory(OUTLINE), in_time(poses, pushers))[0]
    assert first.twist == pytest.approx((0, velocity, 0))
    assert first.contact_point == pytest.approx((0.0, -0.032))
    assert first.duration == pytest.approx(2 * FRAME * 1e-9)
    assert first.stamp == poses[4].stamp  # in the first frame, the object may be at rest
    assert first.push_id == 3


def test_angles_that_wrap_do_not_disturb_the_motion():
    twist = Twist(-0.02, 0.0, 0.3)
    line = PushingLine((-0.2, 0.0), (1.0, 0.0), 0.0)
    found = []
    for offset in (0.0, 2 * np.pi):
        trajectory = Trajectory(OUTLINE)
        for k in range(12):
            x, y, theta = compose(Pose(0, 0, np.pi - 0.1), exp(twist, k / 14))
            wrapped = theta - offset if k % 2 else theta  # as a tracker that reports in (-pi, pi] does near pi
            position = line.touch(OUTLINE, Pose(x, y, theta)).distance
            samples = [PoseSample(k * FRAME, Pose(x, y, wrapped)), PusherSample(k * FRAME, position, 0.02, line, 0)]
            found.append([]) if not k else None
            found[-1] += feed(trajectory, samples)
    assert len(found[0]) == len(found[1]) > 0
    assert np.allclose([o.twist for o in found[0]], [o.twist for o in found[1]])


def test_an_object_at_rest_gives_nothing_whatever_speed_counts_as_moving():
    poses, pushers = samples_of_a_push()
    resting = [PoseSample(p.stamp, poses[20].pose) for p in poses]
    blocked = [p._replace(position=pushers[20].position) for p in pushers]
    assert feed(Trajectory(OUTLINE, TrajectoryConfig(minimum_speed=0.0)), in_time(resting, blocked)) == []


@pytest.mark.parametrize("lost", range(8, 30))
def test_no_observation_is_made_of_frames_from_both_sides_of_a_gap(lost):
    poses, pushers = samples_of_a_push()
    kept = [pose for pose in poses if pose is not poses[lost]]
    found = feed(Trajectory(OUTLINE, TrajectoryConfig(longest_gap=0.1)), in_time(kept, pushers))
    assert found
    assert all(abs(o.stamp - poses[lost].stamp) >= 4 * FRAME for o in found)


def test_a_pose_that_is_not_finite_is_refused():
    with pytest.raises(ValueError, match="must be finite"):
        Trajectory(OUTLINE).add_pose(PoseSample(1, Pose(np.nan, 0, 0)))
    with pytest.raises(ValueError, match="must be finite"):
        Trajectory(OUTLINE).add_pusher(PusherSample(1, np.nan, 0.0, LINE, None))


def shifted_across(poses, k):
    return Pose(poses[k].x + 0.025 * (k > 20), poses[k].y, poses[k].theta)


@pytest.mark.parametrize(
    ("fault", "expected"),
    [
        (lambda poses, k: poses[min(k, 12)], "does not follow the pusher: the tip would be ([6-9]|10) mm inside it"),
        (lambda poses, k: Pose(poses[k].x, poses[k].y + 0.025 * (k > 20), poses[k].theta), "leaps by 2[5-8] mm"),
        (shifted_across, "leaps by 2[5-8] mm"),
        (
            lambda poses, k: Pose(poses[k].x, poses[k].y + 0.025, poses[k].theta),
            "moves though the tip is more than 2[45] mm away",
        ),
    ],
    ids=["frozen", "shifted along", "shifted across", "away from the start"],
)
def test_poses_that_do_not_follow_the_pusher_contradict_it(fault, expected):
    poses, pushers = samples_of_a_push()
    wrong = [sample._replace(pose=fault([s.pose for s in poses], k)) for k, sample in enumerate(poses)]
    trajectory, said = Trajectory(OUTLINE, tolerance=0.005), []
    for sample in in_time(wrong, pushers):
        feed(trajectory, [sample])
        said += filter(None, [trajectory.contradiction])
    assert said
    assert re.search(expected, said[0])
    # the next push begins with nothing against it
    feed(trajectory, in_time(*samples_of_a_push(push_id=1, start=100 * FRAME)))
    assert trajectory.contradiction is None


def test_no_velocity_is_taken_across_a_leap():
    poses, pushers = samples_of_a_push()
    wrong = [sample._replace(pose=shifted_across([s.pose for s in poses], k)) for k, sample in enumerate(poses)]
    found = feed(Trajectory(OUTLINE), in_time(wrong, pushers))
    assert found
    leap = poses[21].stamp
    assert all(abs(o.stamp - leap) > 3 * FRAME for o in found)


def test_frames_that_are_missing_as_the_tip_comes_to_rest_are_no_leap():
    """The tip goes on by 7 mm while no frame comes, and rests in the next one."""
    poses, pushers = samples_of_a_push(frames=20, speed=0.06)
    trajectory = Trajectory(OUTLINE, tolerance=0.005)
    for sample in in_time([*poses[:11], *poses[13:]], pushers):
        feed(trajectory, [sample])
        assert trajectory.contradiction is None


def test_a_single_report_with_a_late_stamp_contradicts_nothing():
    poses, pushers = samples_of_a_push()
    pushers = [*pushers[:20], pushers[20]._replace(stamp=pushers[20].stamp - FRAME // 2, position=0.04), *pushers[21:]]
    trajectory = Trajectory(OUTLINE, tolerance=0.005)
    for sample in in_time(poses, pushers):
        feed(trajectory, [sample])
        assert trajectory.contradiction is None


# --- a tip that moves freely ---


def arm_samples(path, stamps, tip_rate=3):
    """What a camera and an arm would report of a push along a path: position (2,) of the tip at a time [s]."""
    pushed = PushedObject(OUTLINE, TABLE_1["wood_rect4"].support, 0.3, Pose(-0.02, 0.04, 0.02))
    poses, tips = [], []
    fine = np.linspace(stamps[0], stamps[-1], tip_rate * (len(stamps) - 1) + 1)
    for time in fine:
        velocity = (path(time + 1e-4) - path(time - 1e-4)) / 2e-4
        speed = float(np.hypot(*velocity))
        line = PushingLine(tuple(path(time).tolist()), tuple((velocity / speed).tolist()), 0.003)
        tips.append(PusherSample(round(time * 1e9), 0.0, speed, line, 0))
    before = stamps[0]
    for time in stamps:
        for step in np.linspace(before, time, 21)[1:]:
            start, end = path(step - (time - before) / 20), path(step)
            if length := float(np.hypot(*(end - start))):
                pushed.push(PushingLine(tuple(start.tolist()), tuple(((end - start) / length).tolist()), 0.003), length)
        before = time
        poses.append(PoseSample(round(time * 1e9), pushed.pose))
    return poses, tips


STAMPS = np.arange(0.0, 3.0, 1 / 14)


def curved(time):
    """A quarter of a circle at a speed that grows."""
    angle = 0.15 * time + 0.08 * time**2
    return np.array((0.06 * (np.cos(angle) - 1) + 0.01, 0.06 * np.sin(angle) - 0.004))


def test_a_tip_that_moves_freely_gives_the_motions_of_the_object_in_any_order_of_arrival(rng):
    poses, tips = arm_samples(curved, STAMPS)
    found = feed(Trajectory(OUTLINE), in_time(poses, tips))
    assert len(found) >= 4
    for observation in found:
        time = observation.stamp / 1e9
        velocity = (curved(time + 1e-4) - curved(time - 1e-4)) / 2e-4
        theta = observation.pose.theta
        expected = np.array(((np.cos(theta), np.sin(theta)), (-np.sin(theta), np.cos(theta)))) @ velocity
        assert observation.tip_velocity == pytest.approx(expected, abs=1e-3)
        tip = OUTLINE.nearest(transform(inverse(observation.pose), curved(time)))
        assert observation.contact_point == pytest.approx(tip.point, abs=5e-4)
        assert observation.contact_normal == (0.0, -1.0)
    assert len({round(np.degrees(np.arctan2(*o.tip_velocity)), 0) for o in found}) > 2  # it did turn
    for _ in range(10):
        assert feed(Trajectory(OUTLINE), merged(rng, (poses, tips))) == found


def test_a_free_tip_that_is_away_or_at_a_corner_gives_nothing():
    poses, tips = arm_samples(curved, STAMPS)

    def shifted(by):
        return [
            s._replace(line=dataclasses.replace(s.line, origin=(s.line.origin[0] + by[0], s.line.origin[1] + by[1])))
            for s in tips
        ]

    assert feed(Trajectory(OUTLINE), in_time(poses, shifted((0.0, -0.01)))) == []
    assert feed(Trajectory(OUTLINE), in_time(poses, shifted((0.2, 0.0)))) == []


def test_the_nearest_point_of_the_outline():
    square = Outline.rectangle(2.0, 2.0)
    side = square.nearest((0.25, -1.5))
    assert (side.distance, side.point.tolist(), side.normal.tolist(), side.edge) == (0.5, [0.25, -1.0], [0.0, -1.0], 0)
    assert square.nearest((0.25, -0.75)).distance == -0.25
    corner = square.nearest((4.0, 5.0))
    assert (corner.distance, corner.point.tolist(), corner.edge) == (5.0, [1.0, 1.0], None)
    assert corner.normal == pytest.approx((0.6, 0.8))


# --- an observation is the mean of one motion ---

APPROACH, HELD, STROKE = 0.006, (0.9, 1.7), 0.05


def travelled(time, speed=0.02):
    """Stroke [m] of a pusher that waits for .3 s, is held up for a while in the middle, and stops; and its speed."""
    moving = np.clip(time - 0.3, 0.0, HELD[0]) + max(time - 0.3 - HELD[1], 0.0)
    moves = 0.3 < time < 0.3 + HELD[0] or 0.3 + HELD[1] < time
    way = speed * moving
    return (way, speed * moves) if way < STROKE else (STROKE, 0.0)


@functools.cache
def frames_of_a_held_push(rate):
    pushed = PushedObject(OUTLINE, TABLE_1["wood_rect4"].support, 0.3, Pose(-0.02, 0.035 + APPROACH, 0.02))
    poses = []
    for frame in range(int(4.2 * rate)):
        time = frame / rate
        pushed.push(LINE, travelled(time)[0])
        poses.append(PoseSample(round(time * 1e9), pushed.pose))
    return poses


def mismatches(observations):
    """How much of the tip's speed the contact lacks, along the normal, in each observation."""
    return np.array([tip_at(observation)[1] for observation in observations])


@pytest.mark.parametrize(("rate", "reports"), [(10, 20), (14, 8), (14, 20), (14, 100), (40, 20)])
def test_the_contact_of_every_data_point_is_as_fast_as_the_tip(rate, reports, rng):
    """The approach, a tip that is held up, and its end are in no observation, however seldom it is reported and images come."""
    found = 0
    for late, lost, noise in ((0.0, 0.0, 0.0), (0.0, 0.1, 0.0), (0.15, 0.1, 0.0), (0.05, 0.0, 1e-5)):
        poses = [
            sample._replace(pose=Pose(*(np.array(sample.pose) + rng.normal(size=3) * (noise, noise, 10 * noise)).tolist()))
            for sample in frames_of_a_held_push(rate)
            if rng.random() >= lost
        ]
        tips = []
        for number in range(int(4.2 * reports)):
            true = number / reports
            stamp = true - late * rng.random()  # a busy machine stamps with a clock that has stood still
            tips.append(PusherSample(round(stamp * 1e9), *travelled(true), LINE, 0 if stamp < 4.1 else None))
        observations = feed(Trajectory(OUTLINE), in_time(poses, tips))
        known = [one for one in observations if one.tip_velocity is not None]
        found += len(known)
        assert np.abs(mismatches(known)).max(initial=0.0) < 0.03
        # the contact had moved before, and the tip is not held up
        assert all(0.5 < one.stamp * 1e-9 < 0.3 + HELD[0] or one.stamp * 1e-9 > 0.3 + HELD[1] for one in observations)
    assert found >= 8


def test_the_tip_is_unknown_where_distant_reports_leave_its_speed_open():
    """A busy machine reports nothing for a second, and then a tip that brakes: when it began to brake, nobody knows."""
    poses, pushers = samples_of_a_push()
    expected = feed(Trajectory(OUTLINE), in_time(poses, pushers))
    braking = pushers[30]._replace(speed=0.85 * pushers[30].speed)
    found = feed(Trajectory(OUTLINE), in_time(poses, [*pushers[:18], braking, *pushers[31:]]))
    assert [one.twist for one in found] == [one.twist for one in expected]
    silent = pushers[17].stamp, pushers[30].stamp
    before = [one for one in found if one.stamp + 4 * FRAME < silent[0]]
    during = [one for one in found if silent[0] < one.stamp < silent[1]]
    assert before
    assert all(abs(tip_at(one)[1]) < 0.01 for one in before)
    assert len(during) >= 2
    assert all(one.tip_velocity is None for one in during)


def test_a_free_tip_that_turns_at_once_gives_no_data_point_of_both_motions():
    def path(time):
        along = 0.02 * min(time, 1.2)
        return np.array((0.014 * max(time - 1.2, 0.0), along + 0.014 * max(time - 1.2, 0.0))) - (0.0, 0.003)

    stamps = np.arange(30) / 14
    found = feed(Trajectory(OUTLINE), in_time(*arm_samples(path, stamps, tip_rate=1)))
    assert found
    assert all(abs(one.stamp * 1e-9 - 1.2) > 1.5 / 14 for one in found)


def pushes_of(outline, count):
    """What a trajectory with this outline says of that many pushes of the object."""
    trajectory = Trajectory(outline)
    found = []
    for push_id in range(count):
        found += feed(trajectory, in_time(*samples_of_a_push(push_id, start=push_id * 10_000_000_000)))
    return trajectory, found


@pytest.mark.parametrize("error", [-0.0008, 0.0, 0.003])
def test_the_depth_is_how_much_too_large_the_outline_is(error):
    trajectory, found = pushes_of(Outline.rectangle(0.127 + 2 * error, 0.064 + 2 * error), 1)
    assert [one.depth for one in found] == pytest.approx([error] * len(found), abs=1e-4)
    assert trajectory.apart is None


def test_a_tip_that_moves_the_object_without_touching_its_outline_is_told():
    small = Outline.rectangle(0.123, 0.060)
    assert pushes_of(small, 2)[0].apart is None  # twice may be late stamps
    trajectory, found = pushes_of(small, 4)
    assert found == []
    pushes, of, distance = trajectory.apart
    assert (pushes, of) == (4, 4)
    assert distance == pytest.approx(0.002, abs=1e-4)
