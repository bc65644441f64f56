"""Small files in the form of public data sets."""

import io
import json
import pathlib

import numpy as np
from scipy.io import savemat

from bench.public import mitpush

OUTLINE = mitpush.outline_of("rect1", pathlib.Path())


def strokes_file() -> bytes:
    """A file of `mitpush`, of two strokes on the lower side of a plate: straight ahead, and past it; and two pairs."""
    record = np.dtype(
        [(name, object) for name in ("init_pose_gt", "final_pose_gt", "final_pose_sim", "init_tip_pt", "final_tip_pt")]
    )
    past = (
        np.array([0.3, 0.0, 0.0]),
        np.array([0.3, 0.0, 0.0]),
        np.array([0.3, 0.0, 0.0]),
        np.array([0.4, 0.0]),
        np.array([0.4, 0.04]),
    )
    ahead = (
        *(np.array([0.3, 0.0, 0.0]), np.array([0.3, 0.04, 0.0]), np.array([0.301, 0.039, 0.02])),
        *(np.array([0.31, -0.04975]), np.array([0.31, -0.00975])),
    )
    records = np.empty((2, 1), dtype=object)
    for row, values in enumerate((ahead, past)):
        one = np.empty((1, 1), dtype=record)
        one[0, 0] = values
        records[row, 0] = one
    # straight up through (0.01, -0.045), and along a line below the plate
    wrenches = np.array(((0.0, 2.0, 0.02 / RHO), (1.0, 0.0, 0.06 / RHO)))
    twists = np.array(((0.0, 0.01, 0.1 * RHO), (0.01, 0.0, 0.0)))
    training = {"wrenches": wrenches, "twists": twists, "mu_best": 0.2}
    file = io.BytesIO()
    savemat(file, {"record_all": records, "record_ls_training": training})
    return file.getvalue()


RHO = 0.045 * 2**0.5
"""By which `mitpush` divides the moments of a plate of 90 mm."""


def clone(folder: pathlib.Path, *names: str) -> pathlib.Path:
    """A clone of the tool box of `mitpush` with these files, each `SURFACE_SHAPE_MODEL`."""
    (folder / mitpush.FOLDER).mkdir(parents=True)
    for name in names:
        (folder / mitpush.FOLDER / f"wrench1twist1_20percenttraining{name}_v10.mat").write_bytes(strokes_file())
    return folder


def run_file(samples: int = 500) -> bytes:
    """A run of `cpush`: straight ahead along x at 50 mm/s, 10 mm left of the middle of the block, which turns clockwise."""
    times = np.arange(samples) * 1e-3
    turn = -0.5 * times
    contact = np.array(((-0.05, 0.01),) * samples)  # the tip's centre, object frame
    c, s = np.cos(turn), np.sin(turn)
    tip = np.stack((0.05 * times, np.zeros(samples)))
    x, y = tip - np.stack((c * contact[:, 0] - s * contact[:, 1], s * contact[:, 0] + c * contact[:, 1]))
    block = np.stack((x, y, turn))[:, np.arange(samples) // 4 * 4]  # a new value every 4 ms
    content = {"timeJSON": times, "q_sliderJSON": block[:, :-3], "q_pusher_sensedJSON": tip}
    return json.dumps({key: value.tolist() for key, value in content.items()}).encode()
