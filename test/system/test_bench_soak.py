"""The soak test of the benchmark: what it calls flat, and that it follows every node."""

import pathlib
import sys

import numpy as np

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[2]))

from bench import soak


def growth(node: str, memory, threads=12.0, keeps=0.0) -> dict[str, soak.Growth]:
    times = np.arange(200) * 2.0
    samples = np.column_stack((times, *np.broadcast_arrays(memory, np.full(200, threads), 30.0)))
    return {one.kind: one for one in soak._growth(node, samples, keeps)}


def test_what_grows_is_told_from_what_is_flat(rng):
    noise = rng.normal(0, 100, 200)
    assert all(one.flat for one in growth("tracker", 60_000 + noise).values())
    warming = 60_000 - 20_000 * np.exp(-np.arange(200) / 10.0)
    assert growth("tracker", warming)["memory, kB"].flat
    grows = growth("tracker", 60_000 + noise + 60 * np.arange(200))["memory, kB"]
    assert not grows.flat
    assert abs(grows.slope - 60 / 2 * 3600) < 3000
    (failure,) = soak.failures(
        {"growth": [grows._asdict(), *(one._asdict() for one in growth("tracker", 60_000 + noise).values())]}
    )
    assert failure.startswith("memory, kB of tracker: grows from ")
    # an estimator may keep its observations
    assert growth("estimator", 60_000 + 60 * np.arange(200), keeps=2000 * soak.PER_DATA_POINT)["memory, kB"].flat
    leaking = np.floor(12 + np.arange(200) / 20)
    assert not growth("tracker", 60_000.0, threads=leaking)["threads"].flat


def test_every_node_of_a_running_cell_is_followed():
    figures = soak.measure(0.1, lambda _: None)
    assert {(one["node"], one["kind"]) for one in figures["growth"]} == {
        (node, kind)
        for node in ("simulated_cell", "recorder", "estimator", "tracker", "actuator", "experiment")
        for kind in soak.KINDS
    }
    assert all(max(one["first"], one["last"]) > 0 for one in figures["growth"])  # of a line through few samples
