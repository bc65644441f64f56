"""Pictures of flat printed patterns as a known camera sees them: lens, perspective, pixel coverage, blur and noise."""

import re
import zlib

import cv2
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import PathPatch
from matplotlib.path import Path
from scipy.interpolate import RectBivariateSpline

from pushfric_core.geometry.planar import Pose
from pushfric_core.vision.camera import Camera
from pushfric_core.vision.fiducial_tracker import Fiducials

_FINE = 4  # samples per pixel and axis


def picture(
    camera: Camera,
    pattern: np.ndarray,
    corner: tuple[float, float],
    per_metre: float,
    rng: np.random.Generator,
    height: float = 0.0,
    noise_sigma: float = 2.0,
    blur_px: float = 0.7,
    background: int = 20,
) -> np.ndarray:
    """The frame (height, width) with a pattern lying on the plane at `height` [m].

    Args:
        camera: lens and plane.
        pattern: (rows, columns) uint8, upright: rows towards -y of the plane.
        corner: (x, y) of the pattern's lower left corner [m].
        per_metre: pixels of the pattern per metre.
        background: grey level around the pattern.
    """
    inner = (np.arange(_FINE) + 0.5) / _FINE - 0.5
    u = (np.arange(camera.width)[:, None] + inner).ravel()
    v = (np.arange(camera.height)[:, None] + inner).ravel()
    # the distortion varies slowly, so a coarse grid of rays and a spline are enough
    step = 8
    coarse_u, coarse_v = (np.arange(-step, size + 2 * step, step, dtype=float) for size in (camera.width, camera.height))
    grid = np.stack(np.meshgrid(coarse_u, coarse_v), axis=-1)
    plane = camera.unproject(grid.reshape(-1, 2), height).reshape(grid.shape)
    places = np.stack(
        (
            (plane[..., 0] - corner[0]) * per_metre - 0.5,
            len(pattern) - (plane[..., 1] - corner[1]) * per_metre - 0.5,
        ),
        axis=-1,
    )
    at = np.dstack([RectBivariateSpline(coarse_v, coarse_u, places[..., i])(v, u) for i in range(2)]).astype(np.float32)
    fine = cv2.remap(
        pattern.astype(np.float32), at, None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=background
    )
    frame = cv2.resize(fine, (camera.width, camera.height), interpolation=cv2.INTER_AREA)
    if blur_px > 0:
        frame = cv2.GaussianBlur(frame, (0, 0), blur_px)
    return np.clip(np.rint(frame + rng.normal(0, noise_sigma, frame.shape)), 0, 255).astype(np.uint8)


def black_rings(path) -> list[np.ndarray]:
    """Outlines (n, 2) [mm] of the one area that a PDF fills."""
    streams = re.findall(rb"stream\r?\n(.*?)\r?\nendstream", path.read_bytes(), re.DOTALL)
    drawing = next(text for text in map(zlib.decompress, streams) if b" l\n" in text).decode()
    rings: list[list[tuple[float, float]]] = []
    for x, y, operator in re.findall(r"^([-\d.]+) ([-\d.]+) ([ml])$", drawing[: drawing.index("\nf")], re.MULTILINE):
        if operator == "m":
            rings.append([])
        rings[-1].append((float(x) * 25.4 / 72, float(y) * 25.4 / 72))
    return [np.array(ring) for ring in rings if len(ring) > 3]


def rasterised(path, margin: float, per_metre: float) -> np.ndarray:
    """A PDF as a printer prints it: its black area on white, with a margin around it [m]."""
    rings = black_rings(path)
    every = np.concatenate(rings)
    low = every.min(axis=0) - 1e3 * margin
    width, height = np.ptp(every, axis=0) + 2e3 * margin
    figure = Figure(figsize=(width / 25.4, height / 25.4), dpi=per_metre * 0.0254, facecolor="white")
    axes = figure.add_axes((0, 0, 1, 1), xlim=(low[0], low[0] + width), ylim=(low[1], low[1] + height))
    axes.set_axis_off()
    axes.add_patch(PathPatch(Path.make_compound_path(*map(Path, rings)), color="black", linewidth=0, snap=False))
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    white = np.asarray(canvas.buffer_rgba())[..., 0]
    return np.rint(20 + white * (200 / 255)).astype(np.uint8)


HALF_SIZE = np.array((0.0635, 0.032))
"""Size of the object with markers [m]."""
MARKED_PER_METRE = 8000


def marked_object(fiducials: Fiducials) -> np.ndarray:
    """A light rectangle with markers, MARKED_PER_METRE pixels per metre."""
    face = np.full(np.rint(2 * HALF_SIZE[::-1] * MARKED_PER_METRE).astype(int), 220, np.uint8)
    for marker in fiducials.markers:
        side = round(marker.size * MARKED_PER_METRE)
        code = np.rot90(fiducials.dictionary.generateImageMarker(marker.id, side), round(marker.angle_deg / 90))
        left, bottom = np.rint((HALF_SIZE + marker.center) * MARKED_PER_METRE - side / 2).astype(int)
        top = len(face) - bottom - side
        face[top : top + side, left : left + side] = np.where(code > 0, 220, 20)
    return face


def marked_picture(
    fiducials: Fiducials, camera: Camera, pose: Pose, height: float, rng: np.random.Generator, noise_sigma: float = 2.0
) -> np.ndarray:
    """The frame with a marked object at `pose` and its top at `height` [m] over the table."""
    c, s = np.cos(pose.theta), np.sin(pose.theta)
    over_object = camera.over(camera.H @ np.array(((c, -s, pose.x), (s, c, pose.y), (0, 0, 1))))
    corner = (-HALF_SIZE[0], -HALF_SIZE[1])
    return picture(over_object, marked_object(fiducials), corner, MARKED_PER_METRE, rng, height, noise_sigma)
