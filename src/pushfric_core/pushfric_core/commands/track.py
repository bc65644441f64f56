"""The command `track`."""

import csv
import io
import math
import pathlib
from collections.abc import Iterator
from typing import Annotated, Any

import numpy as np
import typer

from pushfric_core.bags.bag import Bag
from pushfric_core.bags.recorded import beside
from pushfric_core.cell.cell_file import load_cell
from pushfric_core.cell.node_settings import CameraConfig
from pushfric_core.commands.application import Application
from pushfric_core.commands.console import warn
from pushfric_core.commands.options import JsonOption
from pushfric_core.commands.result import answer
from pushfric_core.errors import InvalidInput
from pushfric_core.files.disk import write_whole
from pushfric_core.files.object_file import CAMERA_FILE
from pushfric_core.offline.inputs import object_of
from pushfric_core.offline.tracking import Retracked, image_topic, track_again
from pushfric_core.vision.camera import load_camera
from pushfric_core.vision.sighting import TrackerDriver
from pushfric_core.vision.tracker_settings import ContourConfig
from pushfric_core.wording import counted

app = Application()


@app.command()
def track(
    source: Annotated[pathlib.Path, typer.Argument(help="Bag with images (folder or .mcap).")],
    cell: Annotated[
        pathlib.Path | None,
        typer.Option(
            help="Cell YAML: its section camera has the tracker, its settings and the calibration.",
            show_default="the contour tracker, and the bag's own camera.yaml",
        ),
    ] = None,
    object_name: Annotated[
        str, typer.Option("--object", help="Name of an object of Table 1, or object YAML.", show_default="the bag's own")
    ] = "",
    topic: Annotated[str, typer.Option(help="Topic of the images.", show_default="the only one, or the keyframes")] = "",
    out: Annotated[pathlib.Path | None, typer.Option("--csv", help="Write a row for each image to this file.")] = None,
    json: JsonOption = None,
) -> None:
    """Bags that ros2 bag recorded will do. Exit code 1: an image that showed the object no longer does."""
    model, _ = object_of(source, object_name, warn)
    driver: TrackerDriver = ContourConfig()
    offset, height, calibration = CameraConfig.time_offset, CameraConfig.object_height, ""
    if cell is not None:
        file = load_cell(cell)
        if file.camera is None:
            raise InvalidInput(f"{cell}: others track this cell's object, expected the section camera")
        driver, calibration = file.tracker, file.camera.calibration
        offset, height = file.camera.time_offset, file.camera.object_height
    if not (calibrated := calibration or beside(source, CAMERA_FILE)):
        raise InvalidInput(f"{source}: no {CAMERA_FILE}, the calibration, beside the bag; give --cell CELL.yaml")
    camera, bag = load_camera(calibrated), Bag(source)
    if bag.damage is not None:
        warn(bag.what_is_missing())
    found = track_again(bag, image_topic(bag, topic), driver.open_tracker(camera, model, height or model.height), offset)
    if not found.images:
        raise InvalidInput(f"{source}: no image on {found.topic}")
    if out is not None:
        _write(found, out)
    told = _summary(found)
    answer(told, json, _lines(told))
    if told["no_longer_seen"]:
        raise typer.Exit(1)


def _summary(found: Retracked) -> dict[str, Any]:
    off = np.array([one.off for one in found.images if one.off is not None]).reshape(-1, 2)
    return {
        "topic": found.topic,
        "images": len(found.images),
        "seen": sum(one.pose is not None for one in found.images),
        "newly_seen": found.count(now=True, before=False),
        "no_longer_seen": found.count(now=False, before=True),
        "compared": len(off),
        "distance": {"median": np.median(off[:, 0]), "max": off[:, 0].max()} if len(off) else None,
        "angle": {"median": np.median(off[:, 1]), "max": off[:, 1].max()} if len(off) else None,
        "not_seen": dict(found.reasons),
    }


def _lines(told: dict[str, Any]) -> Iterator[str]:
    yield f"{told['topic']}: the object is seen in {told['seen']} of {counted(told['images'], 'image')}"
    if told["compared"]:
        places, turns = told["distance"], told["angle"]
        apart = f"{1e3 * places['median']:.3f} mm and {math.degrees(turns['median']):.3f} degrees apart (median)"
        most_apart = f"{1e3 * places['max']:.3f} mm and {math.degrees(turns['max']):.3f} degrees at most"
        yield f"{counted(told['compared'], 'pose')} compared with the recorded: {apart}, {most_apart}"
    if number := told["newly_seen"]:
        yield f"{counted(number, 'image')}: shows the object now, without a recorded pose"
    if number := told["no_longer_seen"]:
        yield f"{counted(number, 'image')}: no longer shows the object"
    for reason, number in sorted(told["not_seen"].items(), key=lambda one: -one[1]):
        yield f"  {number} x {reason}"


def _write(found: Retracked, out: pathlib.Path) -> None:
    text = io.StringIO()
    rows = csv.writer(text)
    rows.writerow(("stamp", "x", "y", "theta", "recorded_x", "recorded_y", "recorded_theta", "reason"))
    for one in found.images:
        rows.writerow((one.stamp, *(one.pose or ("",) * 3), *(one.recorded or ("",) * 3), one.reason))
    write_whole(out, text.getvalue())
