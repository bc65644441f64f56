"""The contour tracker on rendered frames: accuracy in pixels, orientation, and no pose when in doubt."""

import re

import cv2
import numpy as np
import pytest
import shapely

from pushfric_core.errors import InvalidInput
from pushfric_core.geometry.planar import Pose, transform, wrap
from pushfric_core.simulated.camera import SimulatedCamera, coverage
from pushfric_core.vision.camera import Camera
from pushfric_core.vision.contour_tracker import ContourTracker
from pushfric_core.vision.sighting import NotSeen, Sighting

PIXEL = 0.000625
HEIGHT = 0.01
DISTORTED = (-0.2, 0.05, 0.001, -0.001, 0.0)
MIDDLE = Pose(0.1, 0.05, 0.0)

HALF_LENGTH, HALF_WIDTH = 0.0635, 0.032
SHAPES = {
    "rectangle": np.array(((-1, -1), (1, -1), (1, 1), (-1, 1))) * (HALF_LENGTH, HALF_WIDTH),
    "square": np.array(((-1, -1), (1, -1), (1, 1), (-1, 1))) * 0.045,
    "near_square": np.array(((-1, -1), (1, -1), (1, 1), (-1, 1))) * (0.045, 0.043),
    "triangle": np.array(((0, 0), (0.15, 0), (0, 0.15))) - 0.04,
    "L": np.array(((0, 0), (0.12, 0), (0.12, 0.04), (0.04, 0.04), (0.04, 0.09), (0, 0.09))) - 0.02,
}
SYMMETRY = {"rectangle": 2, "square": 4, "near_square": 2, "triangle": 1, "L": 1}


def looking_down(distortion=(0.0,) * 5) -> Camera:
    return Camera.looking_down(640, 480, (MIDDLE.x, MIDDLE.y), PIXEL, distortion=distortion)


def simulated(shape: str, rng, **options) -> SimulatedCamera:
    return SimulatedCamera(options.pop("camera", looking_down()), SHAPES[shape], HEIGHT, rng, **options)


def tracker(shape: str, camera: Camera | None = None, threshold: float | None = None) -> ContourTracker:
    return ContourTracker(camera or looking_down(), SHAPES[shape], HEIGHT, threshold)


def random_pose(rng, shape: str) -> Pose:
    """A pose with the whole object in view, in any orientation."""
    while True:
        pose = Pose(MIDDLE.x + rng.uniform(-0.05, 0.05), MIDDLE.y + rng.uniform(-0.03, 0.03), rng.uniform(-np.pi, np.pi))
        corners = looking_down(DISTORTED).project(transform(pose, SHAPES[shape]), HEIGHT)
        if (corners > 6).all() and (corners < (633, 473)).all():
            return pose


def error(sighting: Sighting, truth: Pose, shape: str) -> np.ndarray:
    """Errors of the middle of the object (x, y) [px] and of the angle [degree]."""
    middle = SHAPES[shape].mean(axis=0)
    shift = (transform(sighting.pose, middle) - transform(truth, middle)) / PIXEL
    return np.append(shift, np.degrees(wrap(sighting.pose.theta - truth.theta)))


@pytest.mark.parametrize(
    ("noise", "distortion", "shadow", "bound"),
    [
        (0.0, (0.0,) * 5, None, 0.01),
        (2.0, (0.0,) * 5, None, 0.01),
        (8.0, DISTORTED, (1.0, 0.3, 380.0), 0.04),
    ],
)
@pytest.mark.parametrize("shape", SHAPES)
def test_accuracy(rng, shape, noise, distortion, shadow, bound):
    camera = looking_down(distortion)
    simulation = simulated(shape, rng, camera=camera, noise_sigma=noise, shadow=shadow)
    seen = tracker(shape, camera)
    errors = []
    for _ in range(40):
        truth = random_pose(rng, shape)
        near = Pose(truth.x, truth.y, truth.theta + 0.2)
        errors.append(error(seen.track(simulation.render(truth), near), truth, shape))
    x, y, angle = np.sqrt(np.mean(np.square(errors), axis=0))
    assert max(x, y, angle) < bound  # rms [px, px, degree]
    assert np.abs(errors).max() < 4 * bound


def test_the_covariance_matches_the_errors(rng):
    simulation, seen = simulated("triangle", rng, noise_sigma=8.0), tracker("triangle")
    distances = []
    for _ in range(60):
        truth = random_pose(rng, "triangle")
        sighting = seen.track(simulation.render(truth))
        miss = np.array((sighting.pose.x - truth.x, sighting.pose.y - truth.y, wrap(sighting.pose.theta - truth.theta)))
        distances.append(miss @ np.linalg.solve(sighting.covariance, miss))
    assert 0.5 < np.mean(distances) / 3 < 2.0


@pytest.mark.parametrize("shape", ["triangle", "L"])
def test_orientation_is_found_without_expectation(rng, shape):
    simulation, seen = simulated(shape, rng), tracker(shape)
    for theta in np.arange(-3.1, 3.1, 0.4):
        truth = MIDDLE._replace(theta=theta)
        sighting = seen.track(simulation.render(truth))
        assert abs(wrap(sighting.pose.theta - theta)) < 0.001
        assert sighting.orientations == 1


@pytest.mark.parametrize("shape", SHAPES)
def test_symmetry_of_the_outline(rng, shape):
    assert tracker(shape).track(simulated(shape, rng).render(MIDDLE)).orientations == SYMMETRY[shape]


@pytest.mark.parametrize("theta", [0.3, 1.5, 1.7, -2.9, 3.1])
def test_expectation_resolves_a_half_turn(rng, theta):
    truth = MIDDLE._replace(theta=theta)
    frame = simulated("rectangle", rng).render(truth)
    flipped = Pose(truth.x, truth.y, wrap(theta + np.pi))
    for expected in (truth, flipped):
        for offset in (-1.2, 0.0, 1.2):
            near = expected._replace(theta=expected.theta + offset)
            assert abs(wrap(tracker("rectangle").track(frame, near).pose.theta - expected.theta)) < 0.001


@pytest.mark.parametrize("grey", [0, 100, 240])
def test_a_partly_hidden_edge_does_no_harm(rng, grey):
    simulation, seen = simulated("rectangle", rng), tracker("rectangle")
    truth = MIDDLE._replace(theta=0.3)
    frame = simulation.render(truth)
    ((u, v),) = looking_down().project([transform(truth, (0.02, -HALF_WIDTH))], HEIGHT)
    cv2.circle(frame, (round(u), round(v)), 12, grey, -1)
    sighting = seen.track(frame, truth)
    assert np.abs(error(sighting, truth, "rectangle")).max() < 0.05
    assert 0.85 < sighting.visible_fraction < 1.0


@pytest.mark.parametrize("shape", ["rectangle", "triangle", "L"])
@pytest.mark.parametrize("side", [(1, 0), (-1, 0), (0, 1), (0, -1)])
def test_a_partial_view_is_refused(rng, shape, side):
    simulation, seen = simulated(shape, rng), tracker(shape)
    reach = 0.2 * abs(side[0]) + 0.15 * abs(side[1])  # to the border of the image
    truth = Pose(MIDDLE.x + reach * side[0], MIDDLE.y + reach * side[1], 0.4)
    with pytest.raises(NotSeen, match="partial view"):
        seen.track(simulation.render(truth), truth)


def test_what_cannot_be_tracked_is_refused():
    seen = tracker("rectangle")
    for grey in (0, 255):
        with pytest.raises(NotSeen, match="saturated or empty frame"):
            seen.track(np.full((480, 640), grey, np.uint8))
    for image in (np.zeros((480, 641), np.uint8), np.zeros((480, 640)), np.zeros((480, 640, 3), np.uint8)):
        with pytest.raises(ValueError, match=r"image must be uint8 of shape \(480, 640\)"):
            seen.track(image)
    bent = np.full((480, 640), 20, np.uint8)
    bent[60:67, 60:461] = bent[60:300, 60:67] = 140
    bent[85:295, 85:455] = 255  # something brighter, in the box of what is no object
    with pytest.raises(NotSeen, match=r"outline does not fit: it looks \d+"):
        seen.track(bent)
    with pytest.raises(InvalidInput, match="too small or thin for the tracker: 6 px wide"):
        ContourTracker(Camera.looking_down(640, 480, (0.0, 0.0), 0.01), SHAPES["rectangle"], HEIGHT)


@pytest.mark.parametrize(
    ("one", "other", "why"),
    [
        (Pose(0.02, 0.05, 0.2), Pose(0.18, 0.05, 1.0), "two candidates"),
        (Pose(0.1, 0.1, 0.2), Pose(0.1, 0.04, 0.2), "outline does not fit"),  # they touch
    ],
)
def test_two_objects_are_refused(rng, one, other, why):
    simulation = simulated("rectangle", rng, noise_sigma=0.0)
    both = np.maximum(simulation.render(one), simulation.render(other))
    with pytest.raises(NotSeen, match=why):
        tracker("rectangle").track(both, one)


@pytest.mark.parametrize(
    ("shape", "there"),
    [
        ("rectangle", SHAPES["square"]),
        ("triangle", SHAPES["L"]),
        ("L", SHAPES["rectangle"]),
        ("square", SHAPES["near_square"]),
        ("L", SHAPES["L"][::-1] * (1, -1)),  # mirrored
        ("triangle", SHAPES["triangle"] * 1.05),  # two sides fit anywhere; only the third one tells its size
        ("rectangle", SHAPES["rectangle"] * (0.96, 1.0) - (0.04 * HALF_LENGTH, 0.0)),  # three sides fit, its end is missing
    ],
)
def test_another_object_is_refused_at_every_angle(rng, shape, there):
    simulation, seen = SimulatedCamera(looking_down(), there, HEIGHT, rng), tracker(shape)
    for theta in np.arange(-3.1, 3.1, 0.4):
        truth = MIDDLE._replace(theta=theta)
        with pytest.raises(NotSeen, match="outline does not fit"):
            seen.track(simulation.render(truth), truth)


def resized(shape: str, scale: float, higher: float, rng) -> tuple[SimulatedCamera, float]:
    """An object larger by a factor and higher by some metres than expected, and how much larger it looks."""
    camera = looking_down()
    looks = scale * camera.metres_per_pixel(HEIGHT) / camera.metres_per_pixel(HEIGHT + higher)
    return SimulatedCamera(camera, SHAPES[shape] * scale, HEIGHT + higher, rng), looks


@pytest.mark.parametrize("shape", ["rectangle", "square", "triangle"])
@pytest.mark.parametrize(("scale", "higher"), [(0.99, 0.0), (1.03, 0.0), (1.0, 0.01), (0.98, 0.0)])
def test_an_object_of_another_size_or_height_is_refused_with_both_sizes_and_the_cause(rng, shape, scale, higher):
    """The text also gives the height at which the outline would fit: what lies higher looks larger."""
    camera = looking_down()
    simulation, looks = resized(shape, scale, higher, rng)
    slope = (camera.metres_per_pixel(0.0) - camera.metres_per_pixel(0.1)) / 0.1
    fits = (camera.metres_per_pixel(0.0) - camera.metres_per_pixel(HEIGHT) / looks) / slope
    for theta in (0.0, 0.4, 2.0):
        with pytest.raises(NotSeen, match="outline does not fit") as refused:
            tracker(shape).track(simulation.render(MIDDLE._replace(theta=theta)), MIDDLE._replace(theta=theta))
        said = re.fullmatch(
            r"outline does not fit: it looks (\S+) x (\S+) mm, the outline is (\S+) x (\S+) mm: (\S+) % too (large|small); "
            r"check its size in the object's file(?:, or its height: it would fit (\S+) mm over the table, not 10.0 mm)?",
            str(refused.value),
        )
        assert said is not None, refused.value
        for seen, expected in ((said[1], said[3]), (said[2], said[4])):
            assert float(seen) / float(expected) == pytest.approx(looks, abs=0.002)
        assert float(said[5]) == pytest.approx(100 * abs(looks - 1), abs=0.2)
        assert said[6] == ("large" if looks > 1 else "small")
        assert (said[7] is None) == (fits < -0.001)
        if said[7] is not None:
            assert float(said[7]) == pytest.approx(1e3 * fits, abs=1.5)


@pytest.mark.parametrize("shape", ["rectangle", "triangle", "L"])
@pytest.mark.parametrize(("scale", "higher"), [(1.0, 0.0), (1.004, 0.0), (0.996, 0.0), (1.0, 0.0024)])
def test_a_size_or_height_that_is_a_little_wrong_is_said_with_numbers(rng, shape, scale, higher):
    simulation, looks = resized(shape, scale, higher, rng)
    for theta in (0.0, 0.4, 2.0):
        truth = MIDDLE._replace(theta=theta)
        sighting = tracker(shape).track(simulation.render(truth), truth)
        assert sighting.size == pytest.approx(looks, abs=0.0005)
        assert bool(sighting.doubt) == (abs(looks - 1) > 0.002)
        if sighting.doubt:
            assert re.search(
                rf": {abs(looks - 1) * 100:.1f} % too (large|small); check its size in the object's file", sighting.doubt
            )


def test_rendered_coverage_is_exact(rng):
    upright = np.array(((2.5, 3.25), (9.0, 3.25), (9.0, 7.0), (2.5, 7.0)))
    for polygon in (rng.uniform(1, 19, (3, 2)), SHAPES["L"] * 150 + 4.3, upright):
        exact = shapely.Polygon(polygon)
        expected = [[exact.intersection(shapely.box(u, v, u + 1, v + 1)).area for u in range(20)] for v in range(20)]
        np.testing.assert_allclose(coverage(polygon, 20, 20), expected, atol=1e-6)
