"""The fiducial tracker on rendered frames: accuracy in pixels, and no pose when in doubt."""

import numpy as np
import pytest
from printed import HALF_SIZE, black_rings, marked_picture, picture, rasterised

from pushfric_core import InvalidInput, Outline, Pose
from pushfric_core.geometry.planar import transform, wrap
from pushfric_core.vision.camera import Camera
from pushfric_core.vision.fiducial_tracker import Fiducials, FiducialTracker, Marker, load_fiducials
from pushfric_core.vision.printed_pdf import save_markers
from pushfric_core.vision.sighting import NotSeen

PIXEL = 0.000625
HEIGHT = 0.01
CAMERA = Camera.looking_down(640, 480, (0.1, 0.05), PIXEL, distortion=(-0.2, 0.05, 0.001, -0.001, 0.0))
OUTLINE = np.array(((-1, -1), (1, -1), (1, 1), (-1, 1))) * HALF_SIZE
TRUTH = Pose(0.11, 0.04, 0.3)
ONE = Fiducials(family="apriltag_36h11", markers=[Marker(id=5, size=0.04)])
TWO = Fiducials(
    family="4x4_50",
    markers=[Marker(id=3, size=0.03, center=(-0.04, 0.005)), Marker(id=7, size=0.03, center=(0.04, -0.005), angle_deg=90)],
)


def tracker(fiducials: Fiducials) -> FiducialTracker:
    return FiducialTracker(CAMERA, OUTLINE, HEIGHT, fiducials)


def shown(fiducials: Fiducials, pose: Pose, rng, **options) -> np.ndarray:
    return marked_picture(fiducials, CAMERA, pose, HEIGHT, rng, **options)


@pytest.mark.parametrize("fiducials", [ONE, TWO], ids=["one", "two"])
@pytest.mark.parametrize(("noise", "bound"), [(0.0, 0.01), (8.0, 0.05)])
def test_accuracy(rng, fiducials, noise, bound):
    seen = tracker(fiducials)
    errors, distances = [], []
    for theta in np.linspace(-3, 3, 6):
        truth = Pose(0.1 + rng.uniform(-0.04, 0.04), 0.05 + rng.uniform(-0.02, 0.02), theta)
        sighting = seen.track(shown(fiducials, truth, rng, noise_sigma=noise))
        miss = np.array((sighting.pose.x - truth.x, sighting.pose.y - truth.y, wrap(sighting.pose.theta - truth.theta)))
        errors.append((miss[0] / PIXEL, miss[1] / PIXEL, np.degrees(miss[2])))
        distances.append(miss @ np.linalg.solve(sighting.covariance, miss))
        assert sighting.orientations == 1
        assert sighting.visible_fraction > 0.95
    assert np.sqrt(np.mean(np.square(errors), axis=0)).max() < bound  # rms [px, px, degree]
    if noise:
        assert 0.3 < np.mean(distances) / 3 < 3


def test_printed_markers_are_found_where_they_are_pasted(tmp_path, rng):
    """The PDF, cut along the outline; the area of its black is that of the markers, to scale."""
    save_markers(TWO, Outline(OUTLINE), tmp_path / "markers.pdf")
    margin, per_metre = 0.01, 8000
    face = rasterised(tmp_path / "markers.pdf", margin, per_metre)
    c, s = np.cos(TRUTH.theta), np.sin(TRUTH.theta)
    over_object = CAMERA.over(CAMERA.H @ np.array(((c, -s, TRUTH.x), (s, c, TRUTH.y), (0, 0, 1))))
    corner = np.min([np.subtract(one.center, one.size / 2) for one in TWO.markers], axis=0) - margin
    frame = picture(over_object, face, corner, per_metre, rng, HEIGHT, noise_sigma=0.0, background=220)
    sighting = tracker(TWO).track(frame)
    assert np.hypot(sighting.pose.x - TRUTH.x, sighting.pose.y - TRUTH.y) < 0.05 * PIXEL
    assert abs(wrap(sighting.pose.theta - TRUTH.theta)) < np.radians(0.05)
    every = np.concatenate(black_rings(tmp_path / "markers.pdf"))
    np.testing.assert_allclose(np.ptp(every, axis=0), (110, 40), atol=1e-3)  # [mm]


def test_a_hidden_marker_does_no_harm(rng):
    frame = shown(TWO, TRUTH, rng)
    ((u, v),) = CAMERA.project([transform(TRUTH, TWO.markers[0].center)], HEIGHT)
    frame[int(v) - 8 : int(v) + 8, int(u) - 8 : int(u) + 8] = 220
    sighting = tracker(TWO).track(frame)
    assert np.hypot(sighting.pose.x - TRUTH.x, sighting.pose.y - TRUTH.y) < 0.15 * PIXEL
    assert sighting.visible_fraction == 0.5


def test_two_objects_are_refused(rng):
    both = np.maximum(shown(ONE, Pose(0.02, 0.05, 1.2), rng), shown(ONE, Pose(0.18, 0.05, 1.5), rng))
    with pytest.raises(NotSeen, match="two candidates"):
        tracker(ONE).track(both)


def test_markers_that_do_not_lie_as_given_are_refused(rng):
    moved = TWO.model_copy(update={"markers": [TWO.markers[0], TWO.markers[1].model_copy(update={"center": (0.044, -0.005)})]})
    with pytest.raises(NotSeen, match="markers do not lie as given"):
        tracker(moved).track(shown(TWO, TRUTH, rng))


def test_a_marker_of_another_size_is_refused(rng):
    smaller = Fiducials(family=ONE.family, markers=[Marker(id=5, size=0.0385)])
    with pytest.raises(NotSeen, match=r"markers do not fit|markers do not lie as given"):
        tracker(smaller).track(shown(ONE, TRUTH, rng))


def test_markers_too_small_for_the_image_are_refused():
    small = Fiducials(family="apriltag_36h11", markers=[Marker(id=5, size=0.015)])
    with pytest.raises(InvalidInput, match=r"the markers are too small: 3\.0 px per module, expected at least 4"):
        tracker(small)


@pytest.mark.parametrize(
    ("content", "text"),
    [
        ("{family: 9x9, markers: [{id: 1, size: 0.03}]}", "family must be one of 4x4_100, .*apriltag_36h11"),
        ("{family: 4x4_50, markers: [{id: 1, size: 0.03}, {id: 1, size: 0.02}]}", "each marker id may occur once"),
        ("{family: 4x4_50, markers: [{id: 50, size: 0.03}]}", "4x4_50 has the ids 0 to 49"),
    ],
)
def test_a_bad_file_is_refused(tmp_path, content, text):
    path = tmp_path / "markers.yaml"
    path.write_text(content)
    with pytest.raises(InvalidInput, match=text) as raised:
        load_fiducials(path)
    assert str(raised.value).startswith(f"{path}: ")


def test_a_file_of_markers_is_read(tmp_path):
    path = tmp_path / "markers.yaml"
    path.write_text("family: 4x4_50\nmarkers:\n  - {id: 3, size: 0.03, center: [-0.04, 0.005]}\n")
    assert load_fiducials(path).markers == TWO.markers[:1]
