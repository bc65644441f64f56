"""A bag that is whole in every byte but tells something else than what happened does not add up, by whatever door."""

import contextlib
import dataclasses
import json
import pathlib
import re

import numpy as np
import pytest
from calls import invoked
from rich.console import Console
from semantic_damage import DAMAGES, SECOND, STREAM_DAMAGES, STREAMS, Recording, damaged

from pushfric_core import InvalidInput, Outline, TrajectoryConfig, load
from pushfric_core.bags.bag_writer import BagWriter
from pushfric_core.bags.recorded import Recorded
from pushfric_core.files.estimator_settings import ChosenSettings
from pushfric_core.files.object_file import load_object
from pushfric_core.trajectories.ledger import POSES, DoubtCode
from pushfric_msgs.msg import FrictionEstimate, PlanProgress
from pushfric_ros.commands.recorded_run import disagreements, result_of
from pushfric_ros.commands.watch import Monitor

DEMO = pathlib.Path(__file__).resolve().parents[3] / "bags/rubber_rect4"
POSE, STATE = STREAMS
DAY, HOUR = 86_400 * SECOND, 3600 * SECOND


@pytest.fixture(scope="module")
def recording():
    return Recording(DEMO)


@pytest.fixture(scope="module")
def whole():
    return reading_of(DEMO)


def reading_of(bag):
    """What a bag gives, and what is said of it."""
    warnings = []
    reading = Recorded(bag).read(load_object(str(DEMO / "object.yaml")), Recorded(bag).settings, warnings.append)
    return reading, warnings


def told(*arguments, code=1):
    """What a call says on stderr, in one line; it must end with this code."""
    run = invoked(*arguments)
    assert run.exit_code == code, run.output
    return " ".join(run.stderr.split())


def contents(reading):
    return {(one.push_id, one.stamp, one.contact_point, one.twist) for one in reading.observations}


def without(bag, topic, begin=0.0, end=np.inf):
    """The bag's messages without those of a topic in a part of its time, given by fractions."""
    length = bag.end - bag.start
    return [m for m in bag.messages if m.topic != topic or not begin <= (m.log_time_ns - bag.start) / length < end]


def test_a_sound_bag_adds_up(whole, tmp_path):
    assert (whole[0].ledger.lines, whole[1]) == ([], [])
    run = invoked("bag", "verify", DEMO)
    assert (run.exit_code, run.stderr) == (0, "")
    run = invoked("estimate", DEMO, "--ledger", tmp_path / "ledger.json", "--json")
    assert run.exit_code == 0, run.stderr
    ledger = json.loads((tmp_path / "ledger.json").read_text())
    assert [file.name for file in tmp_path.iterdir()] == ["ledger.json"]
    assert ledger == json.loads(run.stdout)["ledger"]
    assert (ledger["doubts"], ledger["remarks"]) == ([], [])
    accounts = ledger["accounts"]
    assert {kind: sums.pop("received") for kind, sums in accounts.items()} == {
        kind: sum(sums.values()) for kind, sums in accounts.items()
    }
    assert accounts["observations"] == {"used": 72}
    assert accounts["pushes"] == {"used": 14}
    run = invoked("estimate", DEMO, "--ledger", "--exclude-push", "3")
    assert run.exit_code == 0
    rows = {re.sub(r" {2,}.*", "", line): line.split()[-1] for line in run.stderr.splitlines()}
    assert (rows["received"], rows["used"], rows["excluded"]) == ("14", "13", "1")


@pytest.mark.parametrize("topic", STREAMS)
@pytest.mark.parametrize("offset", [DAY, -DAY])
def test_one_wild_stamp_costs_one_message_and_is_said(recording, whole, tmp_path, topic, offset):
    for number in (60, 400):
        bag = recording.write(tmp_path / f"{number}", recording.restamped(topic, [number], offset))
        reading, _ = reading_of(bag)
        count, noun = len(recording.numbers(topic)), "poses" if topic == POSE else "pusher states"
        how = "ahead of those that follow" if offset > 0 else "before those that came first"
        assert re.fullmatch(rf"1 of {count} {noun} is stamped 86\d+.\d+ s {how}, and left out", reading.ledger.doubts[0].text)
        missing = list(recording.messages)
        del missing[recording.numbers(topic)[number]]
        expected, _ = reading_of(recording.write(tmp_path / f"{number} missing", missing))
        assert contents(reading) == contents(expected)
        assert len(reading.observations) >= len(whole[0].observations) - 1
    if (topic, offset) != (POSE, DAY):
        return  # every door reads the same ledger
    for command in (["estimate"], ["bag", "verify"], ["bag", "recover", "--out", tmp_path / "saved"]):
        assert f"1 of {count} {noun} is stamped" in told(*command, bag)
    assert invoked("estimate", bag, "--partial").exit_code == 0


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda bag: bag.restamped(POSE, slice(435, None), HOUR), "the poses go on for 3"),
        (lambda bag: bag.restamped(POSE, slice(435, None), -HOUR), "of 871 poses are stamped up to 3599"),
        (lambda bag: bag.restamped(STATE, slice(600, None), HOUR), "of pushes 6 to 14"),
        (lambda bag: without(bag, POSE, 0.5), "of pushes 7 to 14"),
        (lambda bag: without(bag, STATE, 0.5), "the poses go on for 3"),
        (lambda bag: without(bag, POSE, 0.4, 0.6), "of pushes 5 to 8"),
        (lambda bag: without(bag, STATE, 0.4, 0.6), "pushes 5 to 7 are missing: the ids of the pushes jump"),
    ],
)
def test_clocks_and_streams_that_stop_half_way_are_said(recording, tmp_path, change, said):
    bag = recording.write(tmp_path / "bag", change(recording))
    for command in (["estimate"], ["bag", "verify"]):
        text = told(*command, bag)
        assert said in text
        assert re.search(
            r"of the 72 observations that the run recorded, \d+ do not come out of its poses and pusher states", text
        )


@pytest.mark.parametrize(
    ("write", "kinds", "seed"),
    [(Recording.write, DAMAGES, seed) for seed in range(len(DAMAGES))]
    + [(Recording.write_elsewhere, STREAM_DAMAGES, seed) for seed in range(2 * len(STREAM_DAMAGES))],
)
def test_nothing_is_lost_in_silence(recording, whole, tmp_path, write, kinds, seed):
    """A sample of the campaign: where observations are lost or changed, the bag does not add up, whatever recorded it."""
    said, messages = damaged(recording, seed, kinds)
    try:
        reading, _ = reading_of(write(recording, tmp_path / "bag", messages))
    except InvalidInput:
        return  # nothing is left, and the command ends with 2
    assert contents(whole[0]) <= contents(reading) or reading.ledger.doubts, said


@pytest.mark.parametrize(
    ("pushes", "said"),
    [
        (range(5, 6), "push 5 is missing: the ids of the pushes jump"),
        (range(2, 5), "pushes 2 to 4 are missing: the ids of the pushes jump"),
        (range(3), "pushes 0 to 2 are missing: the ids of the pushes jump"),
    ],
)
def test_pushes_that_are_missing_are_named_by_every_door(recording, whole, tmp_path, pushes, said):
    begin, end = recording.span_of(pushes[0])[0] if pushes.start else recording.start, recording.span_of(pushes[-1])[1]
    kept = [m for m in recording.messages if not begin <= m.log_time_ns <= end]
    bag = recording.write_elsewhere(tmp_path / "bag", kept)
    reading, _ = reading_of(bag)
    (doubt,) = (one for one in reading.ledger.doubts if one.code is not DoubtCode.BOTH_MISSING)
    gone = len(contents(whole[0]) - contents(reading))
    assert (doubt.code, doubt.text) == (DoubtCode.PUSHES_MISSING, said)
    assert abs(doubt.lost - gone) <= 0.4 * gone
    assert begin - 3 * SECOND < doubt.stamp < end + 3 * SECOND
    if pushes.start:
        return  # every door reads the same ledger
    expected = [one._asdict() for one in reading.ledger.doubts]
    for command in (["estimate"], ["bag", "verify"], ["bag", "info"]):
        assert said in told(*command, bag)
        run = invoked(*command, bag, "--json", *(["--ledger", tmp_path / "ledger.json"] if command == ["estimate"] else []))
        figures = json.loads(run.stdout)
        assert figures.get("ledger", figures)["doubts"] == expected
    assert said in told("region", bag)
    assert invoked("region", bag, "--partial").exit_code == 0
    with pytest.warns(UserWarning, match=said):
        load(bag)
    run = invoked("report", bag, "--html", tmp_path / "report.html")
    assert (run.exit_code, said in (tmp_path / "report.html").read_text()) == (1, True)


def test_only_what_is_proven_is_called_whole(recording, tmp_path):
    """Recorded elsewhere, or with single frames that a camera has dropped: nothing is wrong, nor proven."""
    sentence = "complete as far as the streams can say"
    moments = [recording.span_of(push)[1] - SECOND for push in (3, 6)]
    out = [next(n for n in recording.numbers(POSE) if recording.messages[n].log_time_ns > at) for at in moments]
    dropped = [m for number, m in enumerate(recording.messages) if number not in out]
    cases = (
        (recording.write, recording.messages, "whole", ""),
        (recording.write_elsewhere, recording.messages, sentence, ""),
        (recording.write_elsewhere, dropped, sentence, "2 poses of pushes did not come, one or two at a time"),
    )
    for number, (write, messages, state, remark) in enumerate(cases):
        original, bag = write(tmp_path / f"of {number}", messages), tmp_path / f"{number}"
        told("bag", "recover", original, "--out", bag, code=0)  # which proves no more than there was
        for command in ("verify", "info"):
            run = invoked("bag", command, bag)
            assert run.exit_code == 0
            assert re.search(rf"{bag}: {state}, \d+ messages", run.stdout)
            assert remark in " ".join(run.stderr.split())
        assert json.loads(invoked("bag", "verify", bag, "--json").stdout)["whole"] == (state == "whole")
        assert remark in told("estimate", bag, code=0)


def renamed(recording, other, since=0):
    """The messages, with other ids of pushes from a time on."""

    def change(msg):
        msg.push_id = other.get(msg.push_id, msg.push_id)

    return [recording.changed(m, change) if m.topic == STATE and m.log_time_ns > since else m for m in recording.messages]


def each(recording, topic, step, since=0):
    """Only each so many message of a topic, after the first ones."""
    kept = {*recording.numbers(topic)[:since], *recording.numbers(topic)[since::step]}
    return [m for number, m in enumerate(recording.messages) if m.topic != topic or number in kept]


@pytest.mark.parametrize(
    ("change", "said"),
    [  # the ids of repeated pushes go back, too, but by the number of the plan's
        (lambda bag: renamed(bag, {6: 13, 13: 6}), "push 6 is missing: the ids of the pushes jump"),
        (lambda bag: renamed(bag, {3: 10, 10: 3}), "push 3 is missing: the ids of the pushes jump"),
        (lambda bag: renamed(bag, {3: 14}, sum(bag.span_of(3)) // 2), "the beginning of push 14 is missing"),
        (lambda bag: renamed(bag, {13: 2_000_000_000}), "pushes 13 to 1999999999 are missing: the ids of the pushes jump"),
        (lambda bag: each(bag, STATE, 20), "pusher states came in the "),
        (lambda bag: each(bag, POSE, 4, 435), "poses of pushes did not come"),
    ],
)
def test_streams_that_are_thin_or_whose_ids_change_are_a_doubt(recording, whole, tmp_path, change, said):
    reading, _ = reading_of(recording.write_elsewhere(tmp_path / "bag", change(recording)))
    assert not contents(whole[0]) <= contents(reading)
    assert any(said in one.text for one in reading.ledger.doubts)


def test_single_frames_are_a_doubt_where_they_cost_observations(recording, whole, tmp_path):
    out = set(recording.numbers(POSE)[::20])
    bag = recording.write_elsewhere(tmp_path / "bag", [m for n, m in enumerate(recording.messages) if n not in out])
    reading, _ = reading_of(bag)
    (doubt,) = reading.ledger.doubts
    fewer = len(whole[0].observations) - len(reading.observations)
    assert (doubt.code, 1 <= doubt.lost <= fewer + 3) == (DoubtCode.POSES_DROPPED, True)


@pytest.mark.parametrize("offset", [0.06, -0.06])
def test_clocks_that_step_against_each_other_are_a_doubt(recording, tmp_path, offset):
    bag = recording.write_elsewhere(tmp_path / "bag", recording.restamped(POSE, slice(435, None), round(offset * SECOND)))
    reading, _ = reading_of(bag)
    (doubt,) = reading.ledger.doubts
    how = "later" if offset > 0 else "earlier"
    assert doubt.code == DoubtCode.CLOCKS_STEP
    assert doubt.text == f"the clocks step: from here on, poses are stamped 0.060 s {how} against the pusher states"
    assert abs(doubt.stamp - recording.messages[recording.numbers(POSE)[435]].log_time_ns) < 3 * SECOND


def test_a_busy_start_is_no_step_of_a_clock(recording, tmp_path):
    """All of its first poses come 60 to 160 ms late, in order, as where a cell starts on a computer that has other work."""
    poses = recording.numbers(POSE)
    late = np.zeros(len(poses), int)
    late[:60] = np.random.default_rng(0).integers(60 * SECOND // 1000, 160 * SECOND // 1000, 60)
    times = np.maximum.accumulate(late + [recording.messages[number].log_time_ns for number in poses])
    came = dict(zip(poses, (times + np.arange(len(poses))).tolist(), strict=True))
    busy = [m._replace(log_time_ns=came.get(n, m.log_time_ns)) for n, m in enumerate(recording.messages)]
    reading, _ = reading_of(recording.write_elsewhere(tmp_path / "bag", sorted(busy, key=lambda m: m.log_time_ns)))
    assert reading.ledger.doubts == []


def test_a_clock_of_the_receiver_that_stands_still_is_no_step_of_another(recording, tmp_path):
    """The recorder of a simulated cell takes its time from /clock, which comes late on a busy computer."""
    at = recording.messages[recording.numbers(POSE)[435]].log_time_ns

    def received(m):
        """By a clock that goes on every quarter of a second for a while."""
        since = m.log_time_ns - at
        return m.log_time_ns - since % (SECOND // 4) if m.topic == POSE and 0 <= since < 2 * SECOND else m.log_time_ns

    late = sorted((m._replace(log_time_ns=received(m)) for m in recording.messages), key=lambda m: m.log_time_ns)
    reading, _ = reading_of(recording.write_elsewhere(tmp_path / "bag", late))
    assert reading.ledger.doubts == []


def test_a_run_that_went_on_to_another_object_is_a_doubt(recording, tmp_path):
    (start,) = (one for one in recording.messages if one.topic == "/cell/estimation_start")
    said = "the run went on from 'rubber_rect4' to 'wood_rect3': the pushes are not of one object"
    for name, doubts in (("wood_rect3", [said]), ("rubber_rect4", [])):
        later = recording.changed(start, lambda msg, name=name: setattr(msg, "object", name))
        messages = [*recording.messages, later._replace(log_time_ns=recording.end)]
        ledger = Recorded(recording.write(tmp_path / name, messages)).ledger()
        assert [one.text for one in ledger.doubts] == doubts


def test_the_last_push_may_be_repeated_twice(recording, tmp_path):
    """Without the plan, which has twelve pushes here."""
    reading, _ = reading_of(recording.write_elsewhere(tmp_path / "bag", renamed(recording, {12: 23, 13: 35})))
    assert reading.ledger.doubts == []


@pytest.mark.parametrize("speed", [0.5, 3.0])
def test_a_recorder_with_another_kind_of_time_shows_no_steps(recording, tmp_path, speed):
    """`ros2 bag record` of a simulated cell, which runs at another speed than the time of day."""
    hurried = [m._replace(log_time_ns=round((m.log_time_ns - recording.start) / speed)) for m in recording.messages]
    reading, _ = reading_of(recording.write_elsewhere(tmp_path / "bag", hurried))
    assert reading.ledger.lines == []


def test_a_loss_before_a_recovery_decides(recording, tmp_path):
    """Chunks without any observation are lost: what comes out is the same, but nobody can know that."""
    bag = recording.write(tmp_path / "bag", recording.messages)
    file = bag / "bag_0.mcap"
    file.write_bytes(file.read_bytes()[:-60_000])
    (bag / "metadata.yaml").unlink()
    saved = tmp_path / "saved"
    told("bag", "recover", bag, "--out", saved)
    for command in (["bag", "verify"], ["estimate"]):
        run = invoked(*command, saved)
        assert run.exit_code == 1
        assert "was recovered; before that, " in " ".join(run.stderr.split())
        assert "whole" not in run.stdout


@pytest.mark.parametrize("seconds", [44, 52])
def test_an_interrupted_run_does_not_add_up(recording, tmp_path, seconds):
    end = recording.start + seconds * SECOND
    bag = recording.write(tmp_path / "bag", [m for m in recording.messages if m.log_time_ns < end])
    doubts = {doubt.code: doubt.text for doubt in reading_of(bag)[0].ledger.doubts}
    assert re.match(r"the plan is not finished: it stands at push (8|10) of 14", doubts[DoubtCode.PLAN_UNFINISHED])
    assert invoked("bag", "verify", bag).exit_code == 1
    assert [invoked("estimate", bag, *how).exit_code for how in ([], ["--partial"])] == [1, 0]


def test_what_other_settings_or_another_object_give_is_not_compared():
    settings, model = Recorded(DEMO).settings, load_object(str(DEMO / "object.yaml"))
    sparse = dataclasses.replace(settings, trajectory=TrajectoryConfig(stride=8))
    other = dataclasses.replace(model, outline=Outline.rectangle(0.1272, 0.0642))
    for chosen, of in ((sparse, model), (settings, other)):
        reading = Recorded(DEMO).read(of, chosen, lambda _: None)
        assert contents(reading) != contents(reading_of(DEMO)[0])
        assert reading.ledger.doubts == []


def test_only_a_bag_of_something_adds_up(recording, tmp_path):
    """A bag of no run does."""
    bag = recording.write(tmp_path / "bag", [m for m in recording.messages if "fault" in m.topic])
    assert Recorded(bag).ledger() is None
    assert "holds nothing of a cell" in told("bag", "verify", bag, code=0)
    assert "holds no messages" in told("bag", "verify", recording.write(tmp_path / "empty", []))


def test_a_topic_of_two_types_is_counted_and_doubted(recording, tmp_path):
    kinds = [("/cell/object_pose", f"geometry_msgs/msg/Pose{kind}Stamped") for kind in ("WithCovariance", "")]
    with BagWriter(tmp_path / "bag") as writer:
        for count, (name, kind) in enumerate(
            [*kinds, ("/cell/pusher_state", "pushfric_msgs/msg/PusherState"), ("/a\x1b[31m", "std_msgs/msg/String")]
        ):
            writer.add_topic(name, kind, [])
            for stamp in range(count):
                writer.write(name, stamp, b"\0\1\0\0", kind)
    assert "/cell/object_pose holds messages of geometry_msgs/msg/PoseStamped, expected" in told(
        "bag", "verify", tmp_path / "bag"
    )
    run = json.loads(invoked("bag", "info", tmp_path / "bag", "--json", "-").stdout)
    assert (run["topics"]["/cell/object_pose"], run["types"]["/cell/object_pose"]) == (1, ", ".join(kind for _, kind in kinds))
    assert "\x1b" not in invoked("bag", "info", tmp_path / "bag").output


def test_without_the_object_only_the_streams_are_checked(recording, tmp_path):
    """Poses that come .1 s late are a doubt only where it is known when the tip touches the object."""
    late = [recording.stamped(m, SECOND // 10) if m.topic == POSE else m for m in recording.restamped(POSE, [300], DAY)]
    bag = recording.write_elsewhere(tmp_path / "bag", late)
    assert [one.code for one in Recorded(bag).ledger().doubts] == [DoubtCode.STAMPS_AHEAD, DoubtCode.CLOCKS_DIFFER]
    (bag / "object.yaml").unlink()
    ledger = Recorded(bag).ledger()
    assert [one.code for one in ledger.doubts] == [DoubtCode.STAMPS_AHEAD]
    assert set(ledger.sums()[POSES]) == {"received", "between pushes", "no partner", "not judged", "ahead"}
    assert "without object.yaml in it, nobody knows which observations" in told("bag", "verify", bag)


def test_aborted_pushes_are_counted_against_the_plan():
    """All pushes of a plan count, also those that were given up before the pusher moved."""
    live = FrictionEstimate(object="rubber_rect4", data_points=72, pushes=14)
    assert disagreements(result_of(DEMO), live, 14, 0) == []
    other, said = disagreements(result_of(DEMO), FrictionEstimate(object="wood", data_points=60, pushes=12), 14, 0)
    assert other == "the live estimate is of wood, what is written here of rubber_rect4"
    assert said.startswith(
        "one of bag and live estimate missed messages, or the estimate was begun again: it has 60 observations"
    )
    assert disagreements(result_of(DEMO), live, 14, 13) == ["13 of 14 pushes were aborted"]
    assert disagreements(result_of(DEMO), live, 1, 1) == ["1 of 1 push was aborted"]
    with contextlib.closing(Monitor(Console(quiet=True), "/planned", "pushing", None, live=False)) as monitor:
        for phase, push_id, aborted in ((0, 4, 0), (1, 4, 0), (1, 5, 1), (2, 6, 2), (3, 13, 9)):
            monitor._on_progress(PlanProgress(phase=phase, push_id=push_id, count=14, aborted=aborted))
        assert (monitor.planned, monitor.aborted) == (10, 9)
        monitor._on_progress(PlanProgress(phase=PlanProgress.PHASE_PUSHING, push_id=14 + 3, count=14))
        assert monitor.next_push == 4


def test_poses_that_are_stamped_late_are_doubted_and_corrected(recording, whole, tmp_path):
    late = recording.restamped(POSE, slice(None), SECOND // 10)
    bag = recording.write(tmp_path / "late", late)
    said = "the motion shows that poses are stamped"
    assert said in told("estimate", bag)
    assert said not in told("estimate", bag, "--pose-lag", 0.1, code=0)
    settings = ChosenSettings({"pose_lag": 0.1}).over(Recorded(bag).settings)
    reading = Recorded(bag).read(load_object(str(DEMO / "object.yaml")), settings, lambda _: None)
    assert contents(reading) == contents(whole[0])


@pytest.mark.parametrize("command", ["estimate", "region", "predict", "stable", "export"])
def test_every_command_ends_alike_for_a_bag_in_doubt(recording, tmp_path, command):
    bag = recording.write_elsewhere(tmp_path / "bag", recording.without_push(5))
    contact = {"contact_x": 0.0, "contact_y": -0.032, "normal_x": 0, "normal_y": -1}
    moved, turned = {"tip_vx": 0.0, "tip_vy": 0.02}, {"half_width": 0.01, "cor_x": 0.5, "cor_y": 0.0, "turn": 1}
    for name, more in (("predict", moved), ("stable", turned)):
        row = contact | more
        (tmp_path / f"{name}.csv").write_text(f"{','.join(row)}\n{','.join(map(str, row.values()))}\n")
    options = {
        "predict": ("--pushes", tmp_path / "predict.csv"),
        "stable": ("--pushes", tmp_path / "stable.csv"),
        "export": ("--to", "json", "--out", tmp_path),
    }
    call = (command, bag, *options.get(command, ()))
    for partial, code in (((), 1), (("--partial",), 0)):
        assert "push 5 is missing" in told(*call, *partial, code=code)


def test_poses_that_are_too_early_for_most_observations_are_a_doubt(recording, whole, tmp_path):
    """By less than what is a doubt of its own: for a while, the object seems to move before the tip is there."""
    bag = recording.write_elsewhere(tmp_path / "bag", recording.restamped(POSE, slice(None), round(-0.063 * SECOND)))
    reading, _ = reading_of(bag)
    fewer = len(whole[0].observations) - len(reading.observations)
    (doubt,) = reading.ledger.doubts
    assert doubt.code is DoubtCode.FEW_OBSERVATIONS
    assert 0.4 * fewer < doubt.lost < 1.5 * fewer


@pytest.mark.parametrize("change", [lambda bag: bag.without_push(13, STATE, SECOND // 2), lambda bag: renamed(bag, {13: -1})])
def test_a_push_that_no_pusher_state_tells_of_is_a_doubt_where_the_object_moves(recording, tmp_path, change):
    """Not the time alone: a pusher at rest may report seldom."""
    reading, _ = reading_of(recording.write_elsewhere(tmp_path / "bag", change(recording)))
    (doubt,) = reading.ledger.doubts
    assert doubt.code is DoubtCode.STATES_MISSING
    assert re.fullmatch(r"no pusher state tells of a push for \d\.\d+ s, in which the object moved by \d+ mm", doubt.text)
