"""Every sample ends in exactly one account, and a wild stamp costs one sample."""

import dataclasses
import itertools
import pathlib
from collections import Counter

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from test_observation_maker import BAR, FRAME, FRAMES, made, merged, pose, pusher
from test_trajectory import feed

from pushfric_core.trajectories.ledger import (
    AHEAD,
    KINDS,
    NO_OBSERVATION,
    NO_PARTNER,
    NOT_SEEN,
    OUT_OF_ORDER,
    POSES,
    REASONS,
    STATES,
    USED,
    WAITING,
    WRENCHES,
    Account,
    DoubtCode,
    Ledger,
)
from pushfric_core.trajectories.observation_maker import ForceSample, ObservationMaker
from pushfric_core.trajectories.samples import TrajectoryConfig
from pushfric_core.trajectories.stream import CONFIRMED, LEAP, LONGEST_END_SKEW, Stream
from pushfric_core.trajectories.trajectory import Trajectory

SECOND, DAY = 10**9, 86_400 * 10**9
PUSHES = 5
COUNT = PUSHES * len(FRAMES)


def several(sample, push, number):
    """The same sample in the push of that number; each begins 3 s after the one before, without a pause."""
    return sample._replace(stamp=sample.stamp + number * 3 * SECOND, **({"push_id": number} if push else {}))


def streams(wrenches=True):
    poses = [several(pose(frame), False, number) for number in range(PUSHES) for frame in FRAMES]
    states = [several(pusher(frame), True, number) for number in range(PUSHES) for frame in FRAMES]
    for at in (0, 1, -2, -1):  # the pusher rests before the first push and after the last one
        states[at] = states[at]._replace(push_id=None, speed=0.0)
    forces = [ForceSample(sample.stamp + 1, (0.0, 1.0)) for sample in states]
    return [poses, states, forces] if wrenches else [poses, states]


def by_time(lists):
    """In order of the place in their streams, as messages arrive whatever their stamps."""
    return [sample for together in zip(*lists, strict=True) for sample in together]


def one_by_one(lists):
    """One stream after the other."""
    return list(itertools.chain(*lists))


def of(samples, forces=True):
    maker = ObservationMaker(BAR, with_forces=forces)
    found = made(maker, samples)
    return found, maker.ledger()


def check_sums(ledger, received):
    for kind in KINDS:
        account = ledger.accounts[kind]
        assert min(account.ended.values(), default=0) >= 0
        assert set(account.ended) <= set(REASONS)
        if kind in received:
            assert account.received == received[kind]
            assert account.open == 0, (kind, account)


@settings(derandomize=True, max_examples=80, deadline=None)
@given(
    seed=st.integers(0, 2**31),
    wild=st.lists(
        st.tuples(
            st.integers(0, 2),
            st.integers(0, COUNT - 1),
            st.sampled_from((-DAY, -SECOND, -FRAME, -1, 0, 1, FRAME, SECOND, DAY, 2**62)),
            st.integers(1, 40),
        ),
        max_size=8,
    ),
    stops=st.tuples(*[st.integers(0, COUNT)] * 3),
    window=st.sampled_from((1, 5)),
    stride=st.sampled_from((1, 5, 30)),
    forces=st.booleans(),
)
def test_every_sample_ends_in_one_account(seed, wild, stops, window, stride, forces):
    """Whatever the stamps, wherever streams stop, and in whatever order they come: sums and observations are the same."""
    lists = [samples[:stop] for samples, stop in zip(streams(), stops, strict=True)]
    for which, at, offset, length in wild:
        for number in range(at, min(at + length, len(lists[which]))):
            lists[which][number] = lists[which][number]._replace(stamp=lists[which][number].stamp + offset)
    lists = lists if forces else lists[:2]
    received = dict(zip((POSES, STATES, WRENCHES), map(len, lists), strict=False))
    rng, outcomes = np.random.default_rng(seed), []
    for _ in range(3):
        maker = ObservationMaker(BAR, TrajectoryConfig(window=window, stride=stride), with_forces=forces)
        found = made(maker, merged(rng, lists))
        ledger = maker.ledger()
        check_sums(ledger, received)
        assert ledger.sums() == maker.ledger().sums()  # to ask changes nothing
        outcomes.append((found, ledger.sums(), ledger.lines))
    assert outcomes[0] == outcomes[1] == outcomes[2]


@settings(derandomize=True, max_examples=100, deadline=None)
@given(stamps=st.lists(st.integers(-(2**62), 2**62) | st.integers(0, 50), max_size=60), distinct=st.booleans())
def test_a_stream_returns_stamps_in_order_and_counts_all(stamps, distinct):
    stream, asked = Stream(distinct), Stream(distinct)
    known = [one.stamp for number, stamp in enumerate(stamps) for one in stream.take(ForceSample(stamp, (number, 0.0)))]
    for number, stamp in enumerate(stamps):
        asked.take(ForceSample(stamp, (number, 0.0)))
        asked.close(Ledger(), POSES, 0)  # to ask changes nothing
    assert vars(asked) | {"account": None} == vars(stream) | {"account": None}
    assert known == sorted(known)
    assert not distinct or len(set(known)) == len(known)
    ledger = Ledger()
    stream.account.end(USED, len(known))
    stream.close(ledger, POSES, None)
    check_sums(ledger, {POSES: len(stamps)})


@pytest.mark.parametrize("which", range(3))
@pytest.mark.parametrize("offset", [-DAY, 2 * SECOND, 3600 * SECOND])
def test_a_wild_stamp_costs_one_sample(which, offset):
    """Ahead or behind, in whatever stream, wherever: what comes of it is what would come if this sample were missing."""
    for at in (0, 2, 34, 100, COUNT - 1):
        lists = streams()
        wild = lists[which][at]._replace(stamp=lists[which][at].stamp + offset)
        lists[which][at] = wild
        found, ledger = of(by_time(lists))
        without = [[*samples[:at], *samples[at + 1 :]] if number == which else samples for number, samples in enumerate(lists)]
        expected, _ = of(one_by_one(without))
        assert found == expected
        account = ledger.accounts[(POSES, STATES, WRENCHES)[which]]
        lost = account.ended[AHEAD] + account.ended[OUT_OF_ORDER]
        trails = at == COUNT - 1 and 0 < offset <= LONGEST_END_SKEW * SECOND  # a stream may go on a little longer
        if not trails and (at >= CONFIRMED or offset > 0):  # which of the first is wild, nobody knows
            assert (lost, len(ledger.doubts)) == (1, 1)
            assert f"1 of {COUNT}" in ledger.doubts[0].text


@pytest.mark.parametrize("seed", range(10))
def test_several_wild_stamps_cost_as_many_samples(seed):
    rng, lists = np.random.default_rng(seed), streams()
    kept = [list(samples) for samples in lists]
    count = 0
    for which, samples in enumerate(lists):
        for at in sorted(rng.choice(np.arange(4, COUNT - 1), size=5, replace=False), reverse=True):
            offset = int(rng.choice((-1, 1)) * 10 ** rng.uniform(9.5, 14))
            samples[at] = samples[at]._replace(stamp=samples[at].stamp + offset)
            del kept[which][at]
            count += 1
    found, ledger = of(by_time(lists))
    assert found == of(one_by_one(kept))[0]
    lost = sum(account.ended[AHEAD] + account.ended[OUT_OF_ORDER] for account in ledger.accounts.values())
    assert lost == count


def test_a_good_observation_comes_as_soon_as_without_the_rule(monkeypatch):
    samples = by_time(streams(wrenches=False))
    moments = []
    for far in (LEAP, 10**9):
        monkeypatch.setattr("pushfric_core.trajectories.stream.LEAP", far)
        trajectory = ObservationMaker(BAR)
        moments.append([number for number, sample in enumerate(samples) if made(trajectory, [sample])])
    assert moments[0] == moments[1]
    assert len(moments[0]) >= 9


@pytest.mark.parametrize(("hours", "reason"), [(1, NO_PARTNER), (-1, OUT_OF_ORDER)])
def test_a_camera_clock_that_is_an_hour_off_from_half_on_is_a_doubt(hours, reason):
    poses, states = streams(wrenches=False)
    half = COUNT // 2
    off = [sample._replace(stamp=sample.stamp + hours * 3600 * SECOND) for sample in poses[half:]]
    found, ledger = of(by_time([[*poses[:half], *off], states]), forces=False)
    assert 0 < len(found) < len(of(one_by_one([poses, states]), forces=False)[0])
    lost = ledger.accounts[POSES].ended[reason]
    assert COUNT - half <= lost <= COUNT - half + 1  # the first pose of all has no partner
    codes = [doubt.code for doubt in ledger.doubts]
    assert DoubtCode.POSES_MISSING in codes
    assert (DoubtCode.STAMPS_BEHIND in codes, DoubtCode.STATES_MISSING in codes) == (hours < 0, hours > 0)
    assert hours > 0 or any(f"{lost} of {COUNT} poses are" in line for line in ledger.lines)


@pytest.mark.parametrize("stopped", [0, 1])
def test_a_stream_that_stops_half_way_is_a_doubt(stopped):
    lists = streams(wrenches=False)
    lists[stopped] = lists[stopped][: COUNT // 4]
    found, ledger = of(one_by_one(lists), forces=False)
    assert 0 < len(found) < len(of(one_by_one(streams(wrenches=False)), forces=False)[0])
    texts = {0: "no pose came for 10.8", 1: "the poses go on for"}
    assert any(line.startswith(texts[stopped]) for line in ledger.lines)
    other = ledger.accounts[(STATES, POSES)[stopped]]
    assert other.ended[(NOT_SEEN, NO_PARTNER)[stopped]] > COUNT / 3


@pytest.mark.parametrize("first", [0, 12])
def test_a_pose_that_stays_the_same_in_a_push_is_a_doubt(first):
    """A tracker that stood still and published its last pose with new stamps cost observations without a word."""
    poses, states = streams(wrenches=False)
    frozen = [
        sample._replace(pose=poses[first].pose) if first <= number < 25 else sample for number, sample in enumerate(poses)
    ]
    found, ledger = of(by_time([frozen, states]), forces=False)
    assert len(found) < len(of(by_time([poses, states]), forces=False)[0])
    (doubt,) = ledger.doubts
    assert doubt.code == DoubtCode.POSES_FROZEN
    assert poses[first].stamp <= doubt.stamp < poses[25].stamp


def test_what_is_held_at_the_end_waits_unless_it_is_wild():
    for ahead, reason in ((0.6, WAITING), (86_400, AHEAD)):
        trajectory = Trajectory(BAR)
        poses, states = streams(wrenches=False)
        held = poses[-41]._replace(stamp=poses[-41].stamp + round(ahead * SECOND))
        feed(trajectory, [*poses[:-40], held, *states])
        ledger = trajectory.ledger()
        assert ledger.accounts[POSES].ended[reason] == 1


def test_an_account_never_hides_what_it_received():
    account = Account()
    account.enter(USED, 2)
    account.received += 1
    assert account.sums() == {"received": 3, USED: 2, WAITING: 1}
    ledger = Ledger()
    ledger.accounts[POSES].add(account)
    assert ledger.sums() == {POSES: {"received": 3, USED: 2, WAITING: 1}}
    for _ in range(2):
        ledger.doubt(DoubtCode.RUN_DIFFERS, "one pose is missing")
    assert ledger.lines == ["one pose is missing"]
    assert CONFIRMED == 3


def test_the_accounts_are_documented():
    text = (pathlib.Path(__file__).parents[3] / "docs/files.md").read_text(encoding="utf-8")
    table = text.split("| account | what ended there |\n|---|---|\n")[1].split("\n\n")[0]
    assert table == "\n".join(f"| {reason} | {meaning} |" for reason, meaning in REASONS.items())


@pytest.mark.parametrize("tick", [2, 5])
def test_poses_that_differ_but_not_in_their_stamps_are_counted_as_wrong(tick):
    poses, states = streams(wrenches=False)
    coarse = [one._replace(stamp=one.stamp // (tick * FRAME) * tick * FRAME) for one in poses]
    first = {one.stamp: one.pose for one in reversed(coarse)}
    number = sum(one.pose != first[one.stamp] for one in coarse)
    _, ledger = of(by_time([coarse, states]), forces=False)
    assert ledger.accounts[POSES].ended[OUT_OF_ORDER] == number
    assert f"{number} of {COUNT} poses are stamped like another that came first, and left out" in ledger.lines


def test_forces_of_one_stamp_all_count():
    """A sensor is faster than the clock that stamps what it measures."""
    poses, states, forces = streams()
    found, _ = of(by_time([poses, states, forces]))
    twice = [one._replace(force=(force, 1.0)) for one in forces for force in (-0.5, 0.5)]
    again, ledger = of(merged(np.random.default_rng(0), [poses, states, twice]))
    assert np.allclose([one.force for one in again], [one.force for one in found])
    assert (ledger.doubts, ledger.accounts[WRENCHES].ended[OUT_OF_ORDER]) == ([], 0)


def test_a_push_that_moves_the_object_but_gives_nothing_is_a_doubt():
    poses, states = streams(wrenches=False)
    for number, one in enumerate(states):
        if one.push_id in (1, 3):
            states[number] = one._replace(line=dataclasses.replace(one.line, origin=(0.5, one.line.origin[1])))
    found, ledger = of(by_time([poses, states]), forces=False)
    (doubt,) = ledger.doubts
    assert doubt.code is DoubtCode.FEW_OBSERVATIONS
    assert doubt.text.startswith("push 1, push 3 moved the object, but gave 0 observations, about ")
    ledger.settle(Counter(one.push_id for one in found), Counter(one.push_id for one in found), (), ())
    assert ledger.sums()["pushes"] == {"received": PUSHES, USED: PUSHES - 2, NO_OBSERVATION: 2}
