"""The benchmark's figures of what planners get, from short campaigns and from messages whose times are known."""

import math
import pathlib

import pytest

from pushfric_msgs.msg import Heartbeat

ROOT = pathlib.Path(__file__).resolve().parents[2]
MS = 1_000_000


@pytest.fixture(autouse=True)
def bench(monkeypatch):
    monkeypatch.syspath_prepend(ROOT)


def test_strokes_are_predicted_and_predictions_are_exact(monkeypatch):
    from bench import display, planning

    name = "delrin_rect_right"
    for constant, value in (
        ("OBJECTS", (name,)),
        ("SEEDS", 1),
        ("STROKES", 3),
        ("CHECKED", 20),
        ("ROUNDS", 1),
        ("PREDICTIONS", 800),
    ):
        monkeypatch.setattr(planning, constant, value)
    told = []
    figures = planning.measure(told.append)
    assert told == [f"strokes of {name}", "predictions"]
    (row,) = figures["strokes"]
    assert (row["object"], row["strokes"]) == (name, 3)
    assert 0 < row["median_mm"] <= row["p90_mm"] < 5
    assert figures["predictions"]["count"] == 800
    assert 0 < figures["predictions"]["largest_difference"] < 1e-3
    targets = list(planning.verdicts(figures))
    assert [target.asked for target in targets] == ["<= 1", "<= 0.5", "<= 0.2", "<= 0.001"]
    assert targets[-1].met
    shown = list(display.plain_tables("planning", figures))
    assert [(table.title, table.row_count) for table in shown] == [("planning", 3), ("planning: strokes", 1)]


def test_exported_scenes_are_compared_with_predictions(monkeypatch):
    from bench import simulators

    monkeypatch.setattr(simulators, "OBJECTS", ("wood_rect4",))
    monkeypatch.setattr(simulators, "STROKES", 3)
    figures = simulators.measure(lambda _: None)
    exported, without = figures["strokes"]
    assert (exported["scene"], without["scene"]) == ("exported", "without a model")
    assert exported["median_mm"] < 0.5 < without["median_mm"]
    assert [verdict.met for verdict in simulators.verdicts(figures)] == [True, True]


def test_estimates_of_the_kinds_of_pushes_are_kept_apart():
    """Frames and pusher states come every 100 ms; of push 1, in which the client asks, each estimate takes 5 ms longer."""
    from bench import display, services

    planner = services._Planner()
    for frame in range(24):
        stamp, wall = 100 * frame * MS, (5000 + 100 * frame) * MS
        planner.poses[stamp] = wall + 7 * MS
        planner.pusher_states[stamp] = wall + 10 * MS
        planner._pushes[stamp] = -1 if 10 <= frame < 13 else int(frame >= 13)
    ahead = services.pipeline.TrajectoryConfig.window // 2 + 1  # frames until the newest that an estimate needs
    for frame, took in ((3, 4), (4, 6), (11, 50), (14, 10), (15, 12), (16, 12)):
        planner.estimates[100 * frame * MS] = planner.poses[100 * (frame + ahead) * MS] + took * MS
    planner._answers["asked"] += [2.0, 3.0, 4.0]
    planner._now = "loaded"
    for moment, stalled in ((0, 0.0), (50, 0.01), (150, 0.02), (200, 0.12)):
        planner._on_heartbeat(Heartbeat(node="/cell/estimator", stalled=stalled), {"source_timestamp": moment * MS})
    figures = {**planner.figures(), "crowd": {"at_once": 200, "in_a_row": 999, "p50_ms": 80.0, "p99_ms": 90.0}}
    assert figures["answers"]["asked"] == {"count": 3, "p50_ms": 3.0, "p90_ms": 4.0, "p99_ms": 4.0}
    assert figures["estimates"]["quiet"] == {"count": 2, "p50_ms": 6.0, "p90_ms": 6.0, "p99_ms": 6.0}
    assert figures["estimates"]["asked"] == {"count": 3, "p50_ms": 12.0, "p90_ms": 12.0, "p99_ms": 12.0}
    assert figures["heartbeat_gap_s"]["loaded"] == 0.12
    found = {verdict.target.split(",")[0]: (verdict.measured, verdict.met) for verdict in services.verdicts(figures)}
    assert found["an answer while pushes run"] == (3.0, True)
    assert found["an estimate later by"][1] is False  # there was no loaded push
    assert found["the estimator's heartbeat"] == (0.12, True)
    assert found["answers to 200 calls at once"] == (200, True)
    assert found["answers to 50 clients in a row"] == (999, False)
    assert found["the same"] == (90.0, True)
    assert [table.title for table in display.plain_tables("services", figures)]


def test_a_crowd_is_answered_by_a_planner_that_has_only_its_topic(monkeypatch):
    from bench import services

    for constant, value in (("CLIENTS", 3), ("AT_ONCE", 6), ("EACH", 5), ("TIMES", 2)):
        monkeypatch.setattr(services, constant, value)
    figures = services._crowd()
    assert (figures["at_once"], figures["in_a_row"]) == (6, 6)
    assert figures["p50_ms"] <= figures["p99_ms"]


def test_a_run_without_answers_meets_no_target():
    from bench import services

    nothing = services._Planner().figures()
    assert math.isnan(nothing["answers"]["asked"]["p50_ms"])
    crowd = {"at_once": 0, "in_a_row": 0, "p50_ms": math.nan, "p99_ms": math.nan}
    assert not any(verdict.met for verdict in services.verdicts({**nothing, "crowd": crowd}))
