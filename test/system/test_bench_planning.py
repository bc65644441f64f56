"""The benchmark's figures of what planners get, from short campaigns."""

from bench import display, planning, services, simulators


def test_strokes_are_predicted_and_predictions_are_exact(monkeypatch):
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
    monkeypatch.setattr(simulators, "OBJECTS", ("wood_rect4",))
    monkeypatch.setattr(simulators, "STROKES", 3)
    figures = simulators.measure(lambda _: None)
    exported, without = figures["strokes"]
    assert (exported["scene"], without["scene"]) == ("exported", "without a model")
    assert exported["median_mm"] < 0.5 < without["median_mm"]
    assert [verdict.met for verdict in simulators.verdicts(figures)] == [True, True]


def test_a_crowd_is_answered_by_a_planner_that_has_only_its_topic(monkeypatch):
    for constant, value in (("CLIENTS", 3), ("AT_ONCE", 6), ("EACH", 5), ("TIMES", 2)):
        monkeypatch.setattr(services, constant, value)
    figures = services._crowd()
    assert (figures["at_once"], figures["in_a_row"]) == (6, 6)
    assert figures["p50_ms"] <= figures["p99_ms"]
