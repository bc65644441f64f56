"""The benchmark's figures of the live graph, from messages whose times are known."""

import pytest

from bench import pipeline

MS = 1_000_000


def test_latency_runs_from_the_newest_image_needed():
    """Frames come every 100 ms of both clocks. A frame is rendered in 4 ms and tracked in 3; a pusher state takes 10.

    One pusher state is lost, so the second estimate waits for the next.
    """
    listener = pipeline.Listener()
    for frame in range(10):
        stamp, wall = 100 * frame * MS, (5000 + 100 * frame) * MS
        listener.images[stamp] = wall + 4 * MS
        listener.poses[stamp] = wall + 7 * MS
        listener.pusher_states[stamp] = wall + 10 * MS
    del listener.pusher_states[400 * MS]
    listener.estimates = {100 * MS: 5412 * MS, 200 * MS: 5520 * MS}  # their newest images are frames 4 and 5
    assert listener.latency() == pytest.approx(
        {
            "estimates": 2,
            "p50_ms": 12.0,
            "p99_ms": 16.0,
            "pose_p50_ms": 3.0,
            "pusher_p50_ms": 1.5,
            "rest_p50_ms": 7.5,
        }
    )
