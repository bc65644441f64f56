"""The benchmark's figures of what planners get, from short campaigns and from messages whose times are known."""

import math
import pathlib

import pytest

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
    assert [target.asked for target in targets] == ["<= 1", "<= 0.5", "<= 1", "<= 0.001"]
    assert targets[-1].met
    shown = list(display.plain_tables("planning", figures))
    assert [(table.title, table.row_count) for table in shown] == [("planning", 3), ("planning: strokes", 1)]


def test_estimates_of_pushes_with_questions_are_kept_apart_from_the_others():
    """Frames and pusher states come every 100 ms; of push 1, in which the client asks, each estimate takes 5 ms longer."""
    from bench import display, services

    planner = services._Planner()
    for frame in range(24):
        stamp, wall = 100 * frame * MS, (5000 + 100 * frame) * MS
        planner._poses[stamp] = wall + 7 * MS
        planner._pusher_states[stamp] = wall + 10 * MS
        planner._pushes[stamp] = -1 if 10 <= frame < 13 else int(frame >= 13)
    ahead = services.TrajectoryConfig.window // 2 + 1  # frames until the newest that an estimate needs
    for frame, took in ((3, 4), (4, 6), (11, 50), (14, 10), (15, 12), (16, 12)):
        planner._estimates[100 * frame * MS] = planner._poses[100 * (frame + ahead) * MS] + took * MS
    planner._answers += [2.0, 3.0, 4.0]
    figures = planner.figures()
    assert figures["answers"] == {"count": 3, "p50_ms": 3.0, "p90_ms": 4.0, "p99_ms": 4.0}
    assert figures["estimates"]["quiet"] == {"count": 2, "p50_ms": 6.0, "p90_ms": 6.0, "p99_ms": 6.0}
    assert figures["estimates"]["asked"] == {"count": 3, "p50_ms": 12.0, "p90_ms": 12.0, "p99_ms": 12.0}
    answered, later = services.verdicts(figures)
    assert (answered.measured, answered.met) == (3.0, True)
    assert (later.measured, later.met) == (6.0, False)
    (shown,) = display.plain_tables("services", figures)
    assert shown.row_count == 12


def test_a_run_without_answers_meets_no_target():
    from bench import services

    nothing = services._Planner().figures()
    assert math.isnan(nothing["answers"]["p50_ms"])
    assert not any(verdict.met for verdict in services.verdicts(nothing))
