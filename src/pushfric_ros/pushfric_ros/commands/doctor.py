"""Checks everything that a cell needs, without moving anything, and says what to do about each fault."""

import contextlib
import ctypes
import itertools
import math
import os
import pathlib
import shutil
import sys
import threading
import time
from collections.abc import Callable, Iterator
from typing import Annotated, Any, NamedTuple

import numpy as np
import typer
from ament_index_python.packages import get_package_share_directory
from rich.console import Console
from rich.table import Table
from rich.text import Text
from sensor_msgs.msg import CompressedImage
from sensor_msgs.msg import Image as ImageMsg

from pushfric_core.errors import InvalidInput
from pushfric_ros.commands import dependencies, discovery
from pushfric_ros.commands.console import console
from pushfric_ros.commands.json_option import STDOUT, JsonOption, write_json
from pushfric_ros.commands.recorded_run import RUNS
from pushfric_ros.files.cell_file import CellConfig, CellFile, load_cell
from pushfric_ros.files.node_settings import CameraConfig, PlanConfig
from pushfric_ros.files.object_file import ObjectModel, load_object
from pushfric_ros.files.plan_file import load_plan
from pushfric_ros.graph import supervisor
from pushfric_ros.messages.conversions import stamp_from_msg
from pushfric_ros.messages.types import message_class
from pushfric_ros.node_kit import network
from pushfric_ros.node_kit.visit import middleware, visit
from pushfric_ros.nodes.tracker import IMAGE_QUEUE, TOPICS, grey_from_msg
from pushfric_ros.pushers.check import Check, Level
from pushfric_ros.pushers.pusher import PusherConfig
from pushfric_ros.report.report import to_json
from pushfric_ros.vision.camera import Camera, Image, load_camera, picture_from
from pushfric_ros.vision.edge_fit import MIN_CONTRAST, SATURATED
from pushfric_ros.vision.frame_source import Device
from pushfric_ros.vision.sighting import NotSeen, Tracker

TRIED_DISTROS, TRIED_RMW = ("jazzy", "kilted"), "rmw_fastrtps_cpp"
LAST_DOMAIN = 101
"""Higher ROS domains use ephemeral ports, which Linux may give to any program."""
PATIENCE = 5.0
"""How long to wait for another process, or for the first frame [s]."""
FRAMES, WATCHED = 20, 3.0
"""A camera is watched for this many frames, or for this long [s]."""
SLOWEST = 10.0
"""Frame rate that a push at 2 cm/s needs [1/s]."""
BRIGHTEST, MOST_SATURATED = 235, 0.01
"""Grey level from which a pixel counts as saturated (video ends there), and the largest fraction of such pixels."""
COARSEST = 0.5e-3
"""Largest useful size of a pixel on the table [m]."""
LENS_ERROR_PX = 0.5
"""The way from a pixel to the table and back must end within this distance of the pixel."""
STALE = 1.0
"""Frames older than this on arrival [s], or from the future, have stamps of another clock."""
BAG_RATE = 10e3
"""Disk space that a recorded cell needs, without images [byte/s]."""
LEAST_SPACE, AMPLE_SPACE = 100e6, 1e9  # [byte]
TIME_ERROR = 5  # what adjtimex returns if nothing disciplines the clock (linux/timex.h)


class Frame(NamedTuple):
    """A frame of the camera as it arrived."""

    stamp: int  # [ns]
    arrival: int  # [ns]
    image: Image


def examine(path: pathlib.Path | None, bags: pathlib.Path, progress: Callable[[str], None]) -> Iterator[Check]:
    """All checks, one after another; checks that depend on a failed one are left out.

    Args:
        path: path of the cell's file; None: check only what does not depend on a cell.
        bags: folder in which bags will be recorded.
        progress: called with the name of what is checked next.
    Raises:
        InvalidInput: the cell's file cannot be read, or describes no cell; before any check.
    """
    cell = load_cell(path) if path is not None else None
    # as the nodes will, this process and its children look for others where the cell's file says
    os.environ.update(network.asked_for(CellConfig.discovery if cell is None else cell.discovery))
    progress("environment")
    yield check_ros()
    yield check_packages()
    yield check_build()
    yield check_clock()
    yield check_disk(bags)
    progress("discovery")
    yield check_discovery()
    yield check_multicast()
    if cell is None:
        return
    with contextlib.ExitStack() as claim:
        try:
            claim.enter_context(supervisor.lock(cell.namespace))
        except InvalidInput as error:
            yield Check("cell", Level.FAILED, str(error), "end that run before you check its parts")
            return
        yield Check("cell", Level.OK, f"{path}: {cell.namespace}")
        yield from _examine_cell(cell, progress)


def _examine_cell(cell: CellFile, progress: Callable[[str], None]) -> Iterator[Check]:
    model: ObjectModel | None = None
    try:
        model = load_object(cell.object)
        if cell.pusher is not None:
            yield check_plan(cell.plan, cell.pusher, model)
    except InvalidInput as error:
        yield Check("object", Level.FAILED, str(error), "docs/files.md shows an object's file")
    if cell.camera is not None:
        yield from _examine_camera(cell, cell.camera, model, progress)
    if cell.pusher is not None and cell.driver is not None:
        progress("pusher")
        yield from cell.driver.checks(cell.pusher, cell.plan.distance, cell.plan.speed)


def _examine_camera(
    cell: CellFile, source: CameraConfig, model: ObjectModel | None, progress: Callable[[str], None]
) -> Iterator[Check]:
    camera: Camera | None = None
    try:
        camera = load_camera(source.calibration)
    except InvalidInput as error:
        yield Check("calibration", Level.FAILED, str(error), "calibrate again: ./pushfric calibrate --help")
    progress("camera")
    try:
        frames = watch(source, cell.namespace, (camera.width, camera.height) if camera is not None else None)
    except InvalidInput as error:
        holder = "check that it is plugged in, that you may read /dev/video*, and that no other program holds it"
        yield Check("camera", Level.FAILED, str(error), holder)
        frames = []
    else:
        yield check_camera(frames, source.source)
    if frames:
        yield check_exposure(frames[-1].image)
        if source.source in TOPICS:  # frames of a device get their stamps here
            yield check_stamps(frames)
    if camera is not None:
        if cell.pusher is not None:
            yield check_calibration(camera, frames[-1].image if frames else None, cell.pusher)
        if model is not None:
            yield check_object(cell, camera, model, frames[-1].image if frames else None)


# The machine


def check_ros() -> Check:
    """Python, ROS 2 and its middleware."""
    distro, rmw = os.environ.get("ROS_DISTRO", ""), middleware()
    finding = f"Python {sys.version.split()[0]}, ROS 2 {distro or 'of unknown distribution'}, {rmw}"
    if distro not in TRIED_DISTROS or rmw != TRIED_RMW:
        advice = f"it may well work; tested were {' and '.join(TRIED_DISTROS)} with RMW_IMPLEMENTATION={TRIED_RMW}"
        return Check("ROS 2", Level.WARNING, finding, advice)
    return Check("ROS 2", Level.OK, finding)


def check_packages() -> Check:
    """The Python packages that pushfric needs."""
    wanted = dependencies.declared()
    if lacking := dependencies.unmet(wanted):
        finding = f"missing or too old: {', '.join(f'{requirement} ({found})' for requirement, found in lacking)}"
        return Check("packages", Level.FAILED, finding, dependencies.advice(lacking))
    return Check("packages", Level.OK, f"{len(wanted)} needed, all there")


def check_build() -> Check:
    """Whether the interfaces are built from their present source."""
    stale = stale_interfaces(pathlib.Path(get_package_share_directory("pushfric_msgs")))
    if stale:
        finding = f"older than the source, or not built: {', '.join(stale)}"
        return Check("build", Level.FAILED, finding, "build the workspace again: ./pushfric setup, or colcon build")
    return Check("build", Level.OK, "pushfric_msgs is built from its present source")


def stale_interfaces(share: pathlib.Path) -> list[str]:
    """Interfaces of pushfric_msgs that are not built, or whose fields differ from their source files.

    Args:
        share: where they are installed; links lead to the source.
    """
    stale = []
    for kind, parts in INTERFACE_PARTS.items():
        folders = {path.resolve().parent for path in (share / kind).glob(f"*.{kind}")}
        for source in sorted(source for folder in folders for source in folder.glob(f"*.{kind}")):
            wanted = [_fields(text) for text in source.read_text(encoding="utf-8").split("\n---\n")]
            try:
                built = message_class(f"pushfric_msgs/{kind}/{source.stem}")
            except InvalidInput:
                stale.append(source.name)
                continue
            classes: list[Any] = [getattr(built, part) for part in parts] or [built]
            if [made.get_fields_and_field_types() for made in classes] != wanted:
                stale.append(source.name)
    return stale


INTERFACE_PARTS = {"msg": (), "srv": ("Request", "Response"), "action": ("Goal", "Result", "Feedback")}
PRIMITIVES = {"bool": "boolean", "float32": "float", "float64": "double", "byte": "octet", "char": "uint8"}
"""Names of types in interface files -> names that rosidl uses."""


def _fields(text: str) -> dict[str, str]:
    """Names and types of the fields that an interface file defines, as rosidl calls them."""
    fields = {}
    for line in text.splitlines():
        words = line.partition("#")[0].split()
        if len(words) < 2 or "=" in "".join(words[1:]):  # blank, or a constant
            continue
        base, bracket, size = words[0].rstrip("]").partition("[")
        base = PRIMITIVES.get(base, f"pushfric_msgs/{base}" if base[0].isupper() else base)
        if size.isdecimal():
            base = f"{base}[{size}]"
        elif bracket:
            base = f"sequence<{base}{size.replace('<=', ', ')}>"
        fields[words[1]] = base
    return fields


def check_clock() -> Check:
    """Whether the system clock is later than this file and synchronised."""
    now, written = time.time(), pathlib.Path(__file__).stat().st_mtime
    said = time.strftime("%Y-%m-%d %H:%M:%S", time.localtime(now))
    if now < written:
        finding = f"{said}, which was before this program was installed"
        return Check("clock", Level.FAILED, finding, "set it: sudo timedatectl set-ntp true")
    if clock_state() == TIME_ERROR:
        advice = "nothing to do for a cell on one computer; for more: sudo timedatectl set-ntp true, or chrony"
        return Check("clock", Level.WARNING, f"{said}, but nothing synchronises it", advice)
    return Check("clock", Level.OK, f"{said}, synchronised")


def clock_state() -> int:
    """The state of the kernel's clock, as adjtimex(2) returns it."""
    # a struct timex of zeros only asks; this is larger than the struct on any machine
    return int(ctypes.CDLL(None).adjtimex(ctypes.create_string_buffer(1024)))


def check_disk(folder: pathlib.Path) -> Check:
    """Whether there is space for bags in a folder, which need not exist yet."""
    there = next(parent for parent in (folder.resolve(), *folder.resolve().parents) if parent.exists())
    free = shutil.disk_usage(there).free
    finding = f"{free / 1e9:.1f} GB free at {there}, {free / BAG_RATE / 3600:.0f} hours of recording"
    if not os.access(there, os.W_OK):
        return Check("disk", Level.FAILED, f"you may not write to {there}", "record elsewhere, with --bag")
    if free < AMPLE_SPACE:
        level = Level.FAILED if free < LEAST_SPACE else Level.WARNING
        return Check("disk", level, finding, "make room, or record elsewhere, with --bag")
    return Check("disk", Level.OK, finding)


def check_discovery() -> Check:
    """Whether a message reaches another process on this machine, and the answer comes back."""
    text = os.environ.get("ROS_DOMAIN_ID", "0")
    if not text.isdecimal() or int(text) > LAST_DOMAIN:
        finding, advice = f"ROS_DOMAIN_ID is {text!r}", f"set it to a number from 0 to {LAST_DOMAIN}, the same in all terminals"
        return Check("discovery", Level.FAILED, finding, advice)
    seconds = discovery.round_trip(PATIENCE)
    where = f"on domain {int(text)}, discovery range {os.environ.get('ROS_AUTOMATIC_DISCOVERY_RANGE', 'SUBNET')}"
    if seconds is None:
        advice = "check ROS_AUTOMATIC_DISCOVERY_RANGE (not OFF), firewall rules for UDP 7400 and up, and free space in /dev/shm"
        return Check("discovery", Level.FAILED, f"another process did not answer within {PATIENCE:g} s {where}", advice)
    return Check("discovery", Level.OK, f"another process answered after {seconds:.1f} s {where}")


def check_multicast() -> Check:
    """Whether multicast works, by which other machines are found."""
    if os.environ.get("ROS_AUTOMATIC_DISCOVERY_RANGE", "SUBNET") != "SUBNET":
        return Check("multicast", Level.OK, "not needed: only this machine is looked for")
    fault = discovery.multicast(1.0)
    if fault is not None:
        advice = "other machines will not be found; for this one alone set discovery: localhost in the cell's file"
        return Check("multicast", Level.WARNING, f"does not work: {fault}", advice)
    return Check("multicast", Level.OK, "works")


# The camera


def watch(entry: CameraConfig, namespace: str, size: tuple[int, int] | None) -> list[Frame]:
    """The first frames of a camera, which is a device or a topic; empty if no frame comes in time.

    Args:
        entry: the section `camera` of the cell's file.
        namespace: namespace of the cell.
        size: width and height to ask of a device [px]; None: its default.
    Raises:
        InvalidInput: there is no such device, or the topic carries no pictures.
    """
    if entry.source in TOPICS:
        return _watch_topic(entry.source, namespace)
    arrived = threading.Event()
    device = Device(entry.source, size, time.time_ns, arrived.set)
    frames: list[Frame] = []
    deadline = time.monotonic() + PATIENCE
    device.start()
    try:
        while len(frames) < FRAMES and time.monotonic() < deadline and (device.is_alive() or device.frames):
            arrived.wait(0.1)
            arrived.clear()
            while device.frames:
                if not frames:
                    deadline = time.monotonic() + WATCHED
                stamp, image = device.frames.popleft()
                frames.append(Frame(stamp, time.time_ns(), image))
    finally:
        device.close()
    return frames


def _watch_topic(source: str, namespace: str) -> list[Frame]:
    frames: list[Frame] = []
    problems: list[str] = []

    def take(msg: Any) -> None:
        arrival = time.time_ns()
        try:
            image = grey_from_msg(msg) if source == "topic" else picture_from(np.frombuffer(msg.data, np.uint8), msg.format)
        except ValueError as error:
            problems.append(str(error))
            return
        frames.append(Frame(stamp_from_msg(msg.header.stamp), arrival, image))

    with visit("doctor", namespace) as here:
        here.node.create_subscription(ImageMsg if source == "topic" else CompressedImage, TOPICS[source], take, IMAGE_QUEUE)
        deadline = time.monotonic() + PATIENCE
        while len(frames) < FRAMES and not problems and time.monotonic() < deadline:
            here.spin_once(0.1)
            if len(frames) == 1:
                deadline = min(deadline, time.monotonic() + WATCHED)
    if problems:
        raise InvalidInput(f"{TOPICS[source]}: {problems[0]}")
    return frames


def check_camera(frames: list[Frame], source: str) -> Check:
    """Whether frames come, come fast enough, and change."""
    what = TOPICS.get(source, source)
    if not frames:
        advice = "check that its driver runs and publishes in the cell's namespace" if source in TOPICS else "plug it in again"
        return Check("camera", Level.FAILED, f"no frames from {what}", advice)
    height, width = frames[0].image.shape
    seconds = (frames[-1].arrival - frames[0].arrival) / 1e9
    rate = (len(frames) - 1) / seconds if seconds > 0 else math.nan
    finding = f"{what}: {width} x {height} px, {rate:.1f} frames/s"
    if len(frames) > 2 and all(np.array_equal(frame.image, frames[0].image) for frame in frames):
        return Check("camera", Level.FAILED, f"{finding}, all of them equal", "it hangs: unplug it and plug it in again")
    if not rate >= SLOWEST:
        advice = f"{SLOWEST:g} frames/s or more are needed: shorter exposure with more light, or another port or format"
        return Check("camera", Level.WARNING, finding, advice)
    return Check("camera", Level.OK, finding)


def check_exposure(image: Image) -> Check:
    """Whether an image (height, width), mono8, is neither saturated nor too dark."""
    saturated, bright, middle = np.mean(image >= BRIGHTEST), np.percentile(image, 99.9), np.median(image)
    finding = (
        f"{100 * saturated:.1f} % of the pixels are saturated, the brightest have {bright:.0f}, the median is {middle:.0f}"
    )
    if middle >= SATURATED:
        return Check("exposure", Level.WARNING, finding, "the table must be dark: shorter exposure, less gain")
    if saturated > MOST_SATURATED:
        return Check(
            "exposure", Level.WARNING, finding, "saturated areas look too large: shorter exposure, less gain, no highlights"
        )
    if bright < MIN_CONTRAST:
        return Check("exposure", Level.WARNING, finding, "too dark to see an object: more light or exposure, and no lens cap")
    return Check("exposure", Level.OK, finding)


def check_stamps(frames: list[Frame]) -> Check:
    """Whether the stamps of the frames agree with this machine's clock."""
    ages = [(frame.arrival - frame.stamp) / 1e9 for frame in frames]
    finding = f"{np.median(ages):.3f} s old on arrival"
    backwards = any(b.stamp <= a.stamp for a, b in itertools.pairwise(frames))
    if not -STALE / 10 <= np.median(ages) <= STALE or backwards:
        finding += ", not in order" if backwards else ""
        advice = "the driver's clock is not this one: synchronise them; small constant offsets go into camera.time_offset"
        return Check("stamps", Level.FAILED, finding, advice)
    return Check("stamps", Level.OK, finding)


def check_calibration(camera: Camera, image: Image | None, pusher: PusherConfig) -> Check:
    """The calibration, compared with the camera's picture (height, width), if there is one, and with the pushing line."""
    if image is not None and image.shape != (camera.height, camera.width):
        got = f"{image.shape[1]} x {image.shape[0]}"
        finding = f"made for {camera.width} x {camera.height} px, the camera gives {got}"
        return Check("calibration", Level.FAILED, finding, "set the camera to that size, or calibrate it at this one")
    corners = np.array([(u, v) for u in (0, camera.width - 1) for v in (0, camera.height - 1)], dtype=float)
    off = np.abs(camera.project(camera.unproject(corners)) - corners).max()
    if not off < LENS_ERROR_PX:
        advice = "calibrate the lens again, with the board in the corners of the picture"
        return Check("calibration", Level.FAILED, "the lens model fails in the corners of the picture", advice)
    direction = np.asarray(pusher.line_direction) / np.hypot(*pusher.line_direction)
    line = np.asarray(pusher.line_origin) + np.linspace(0, pusher.stroke, 50)[:, None] * direction
    pixels = camera.project(line)
    seen = np.mean(((pixels >= 0) & (pixels <= (camera.width - 1, camera.height - 1))).all(axis=1))
    pixel = camera.metres_per_pixel()
    finding = f"a pixel is {1e3 * pixel:.2f} mm, {100 * seen:.0f} % of the pushing line are in the picture"
    if not seen:
        advice = "check table_homography, line_origin and line_direction: they must mean the same table frame"
        return Check("calibration", Level.FAILED, finding, advice)
    if pixel > COARSEST:
        advice = f"{1e3 * COARSEST:g} mm or less are needed: a camera nearer to the table, or with more pixels"
        return Check("calibration", Level.WARNING, finding, advice)
    return Check("calibration", Level.OK, finding)


def check_object(cell: CellFile, camera: Camera, model: ObjectModel, image: Image | None) -> Check:
    """Whether the tracker can find such an object, and whether it sees it now; the object need not lie there yet."""
    try:
        tracker: Tracker = cell.tracker.open_tracker(camera, model, (cell.camera and cell.camera.object_height) or model.height)
    except InvalidInput as error:
        return Check("object", Level.FAILED, str(error), "a camera nearer to the table, larger markers, or another object")
    if image is None or image.shape != (camera.height, camera.width):
        return Check("object", Level.OK, f"{model.name}: nobody looked whether it is seen")
    try:
        sighting = tracker.track(image)
    except NotSeen as reason:
        return Check("object", Level.OK, f"{model.name} is not seen now: {reason}")
    x, y = 1e3 * sighting.pose.x, 1e3 * sighting.pose.y
    return Check(
        "object", Level.OK, f"{model.name} is seen at ({x:.0f}, {y:.0f}) mm, edges fit to {sighting.residual_px:.2f} px"
    )


# The pusher


def check_plan(plan: PlanConfig, pusher: PusherConfig, model: ObjectModel) -> Check:
    """Whether the push plan fits the object and the pusher."""
    try:
        pushes = load_plan(plan.plan, model)
    except InvalidInput as error:
        return Check("plan", Level.FAILED, str(error), "docs/files.md shows a plan")
    finding = f"{plan.choose or len(pushes)} pushes of {1e3 * plan.distance:g} mm at {1e3 * plan.speed:g} mm/s"
    if plan.distance > pusher.stroke or plan.speed > pusher.max_speed:
        finding += f"; the pusher's stroke is {1e3 * pusher.stroke:g} mm, its greatest speed {1e3 * pusher.max_speed:g} mm/s"
        return Check("plan", Level.FAILED, finding, "shorten plan.distance, lower plan.speed")
    return Check("plan", Level.OK, finding)


# What is told


def passed(checks: list[Check]) -> bool:
    """Whether no check failed; a warning is not a failure."""
    return all(check.level is not Level.FAILED for check in checks)


def table(checks: list[Check]) -> Table:
    """The checks as a table."""
    colors = {Level.OK: "green", Level.WARNING: "yellow", Level.FAILED: "red"}
    made = Table(box=None, header_style="bold", pad_edge=False)
    for title in ("", "check", "finding", "what to do"):
        made.add_column(title, overflow="fold")
    for check in checks:
        made.add_row(Text(check.level.value, colors[check.level]), check.name, Text(check.finding), Text(check.advice))
    return made


def findings(checks: list[Check]) -> dict[str, Any]:
    """The checks as one JSON object."""
    return {"passed": passed(checks), "checks": [check._asdict() | {"level": check.level.value} for check in checks]}


# The command

app = typer.Typer(add_completion=False)


@app.command()
def doctor(
    cell: Annotated[
        pathlib.Path | None, typer.Argument(help="Cell YAML; without one, only this machine is checked.", show_default=False)
    ] = None,
    json: JsonOption = None,
) -> None:
    """Exit code 0: nothing failed; 1: a check failed; 2: wrong input, such as a cell file that cannot be read or is invalid."""
    with console.status("") as status:
        checks = list(examine(cell, RUNS, lambda what: status.update(f"checking the {what}")))
    write_json(to_json(findings(checks)), json)
    if json != STDOUT:
        Console().print(table(checks))
    if not passed(checks):
        sys.exit(1)
