"""The benchmark's figures of the live graph and of bags, from messages whose times are known and from a short recording."""

import pathlib

import pytest

ROOT = pathlib.Path(__file__).resolve().parents[2]
MS = 1_000_000


@pytest.fixture
def pipeline(monkeypatch):
    monkeypatch.syspath_prepend(ROOT)
    from bench import pipeline

    return pipeline


@pytest.fixture
def recording(monkeypatch):
    monkeypatch.syspath_prepend(ROOT)
    from bench import recording

    return recording


def test_latency_runs_from_the_newest_image_needed(pipeline):
    """Frames come every 100 ms of both clocks. A frame is rendered in 4 ms and tracked in 3; a pusher state takes 10.

    One pusher state is lost, so the second estimate waits for the next.
    """
    listener = pipeline.LatencyListener()
    for frame in range(10):
        stamp, wall = 100 * frame * MS, (5000 + 100 * frame) * MS
        listener._ticks[stamp] = wall
        listener._images[stamp] = wall + 4 * MS
        listener._poses[stamp] = wall + 7 * MS
        listener._pusher_states[stamp] = wall + 10 * MS
    del listener._pusher_states[400 * MS]
    listener._estimates = {100 * MS: 5412 * MS, 200 * MS: 5520 * MS}  # their newest images are frames 4 and 5
    assert listener.latency() == pytest.approx(
        {
            "estimates": 2,
            "p50_ms": 12.0,
            "p99_ms": 16.0,
            "max_ms": 16.0,
            "from_stamp_p50_ms": 16.0,
            "from_stamp_p99_ms": 20.0,
            "pose_p50_ms": 3.0,
            "pusher_p50_ms": 1.5,
            "rest_p50_ms": 7.5,
            "rest_p99_ms": 10.0,
        }
    )
    listener.started = 4000 * MS
    assert listener.first_pose_s() == pytest.approx(1.007)


@pytest.mark.parametrize("dropped", [0, 3])
def test_a_frame_on_its_way_is_not_dropped(pipeline, dropped):
    listener = pipeline.LatencyListener()
    listener.seconds, listener.cpu_seconds = 10.0, 5.0
    # numbered from 21: the first ones came before the listener
    listener._frames = [(50 * number * MS, 21 + number) for number in range(201)]
    # at each second one frame of two is still on its way; 20 came before the tracker
    listener._tracked = [(1000 * k * MS, 1 + 20 * k - k % 2 - (dropped if k > 5 else 0)) for k in range(1, 11)]
    assert listener.frames() == {"published_hz": 20.0, "published": 200, "dropped": dropped, "cores": 0.5}


def test_images_are_recorded(recording, monkeypatch):
    monkeypatch.setattr(recording, "SECONDS", 0.5)
    images = recording.measure(lambda what: None)["images"]
    assert images["published"] == 30
    assert 0 < images["recorded"] <= 30
    assert images["megabytes"] == pytest.approx(0.9216 * images["recorded"], rel=0.01)


def test_the_cost_of_the_view_is_measured_side_by_side(pipeline, monkeypatch):
    from bench import view_cost

    monkeypatch.setattr(view_cost, "_run", lambda way: {"estimates": 9, "p50_ms": len(way), "p99_ms": 50.0, "cores": 0.5})
    said: list[str] = []
    figures = view_cost.measure(said.append)
    assert len(said) == view_cost.STEPS
    assert [way["p50_ms"] for way in figures.values()] == [len(way) for way in figures]
    (verdict,) = view_cost.verdicts(figures)
    assert not verdict.met
    figures[view_cost.NOBODY]["p50_ms"] = 14.0
    (verdict,) = view_cost.verdicts(figures)
    assert verdict.met
