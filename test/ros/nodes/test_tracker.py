"""The tracker node over the real middleware, fed with rendered frames, video files and pictures."""

import array

import cv2
import numpy as np
import pytest
import yaml
from composition import made
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped
from printed import marked_picture
from sensor_msgs.msg import CompressedImage, Image
from videos import save_video

from pushfric_core.bags.samples import pose_from_msg, stamp_from_msg
from pushfric_core.errors import InvalidInput
from pushfric_core.geometry.planar import Pose, wrap
from pushfric_core.simulated.camera import SimulatedCamera
from pushfric_core.vision.camera import Camera, save_camera
from pushfric_core.vision.fiducial_tracker import load_fiducials
from pushfric_core.vision.image_messages import TO_GREY
from pushfric_core.vision.sighting import NO_OBJECT, UNMEASURED
from pushfric_ros.messages.conversions import pose_to_msg, stamp_to_msg
from pushfric_ros.node_kit.qos import LATCHED, SENSOR_DATA, SENSOR_QUEUE
from pushfric_ros.nodes.tracker import TrackerNode
from pushfric_ros.nodes.tracker.watch import FROZEN_FRAMES

CAMERA = Camera.looking_down(640, 480, (0.1, 0.05), 0.000625, distortion=(-0.1, 0.02, 0.0, 0.0, 0.0))
OUTLINE = np.array(((-1, -1), (1, -1), (1, 1), (-1, 1))) * (0.0635, 0.032)
HEIGHT = 0.012
TRUTH = Pose(0.11, 0.04, 0.3)
FIRST = 1_700_000_000_000_000_000
PERIOD = 16_666_667


class Cell:
    """A tracker in a namespace, with the other ends of its topics."""

    def __init__(self, ros, folder, **parameters) -> None:
        (folder / "object.yaml").write_text(yaml.safe_dump({"name": "block", "outline": OUTLINE.tolist(), "height": HEIGHT}))
        save_camera(CAMERA, folder / "camera.yaml")
        given = {"object": str(folder / "object.yaml"), "calibration": str(folder / "camera.yaml"), "source": "topic"}
        self.ros = ros
        self.simulation = SimulatedCamera(CAMERA, OUTLINE, HEIGHT, np.random.default_rng(0))
        self.here = ros.node("here", namespace="/cell")
        self.poses: list[PoseWithCovarianceStamped] = []
        self.reports: list[DiagnosticStatus] = []
        poses = self.here.create_subscription(PoseWithCovarianceStamped, "object_pose", self.poses.append, SENSOR_QUEUE)
        self.here.create_subscription(DiagnosticArray, "/diagnostics", lambda msg: self.reports.extend(msg.status), 10)
        self.images = self.here.create_publisher(Image, "image_raw", SENSOR_DATA)
        self.placements = self.here.create_publisher(PoseStamped, "placement", LATCHED)
        self.tracker = ros.compose(made(TrackerNode, **given | parameters))
        self.stamp = FIRST
        ros.wait_for(lambda: poses.get_publisher_count(), what="a publisher of object_pose")
        ros.wait_for(lambda: self.placements.get_subscription_count(), what="a subscriber to placement")
        if parameters.get("source", "topic") == "topic":
            ros.wait_for(lambda: self.images.get_subscription_count(), what="a subscriber to image_raw")

    def send(self, frame: np.ndarray, encoding: str = "mono8", stamp: int | None = None, **fields) -> None:
        if stamp is None:
            self.stamp += PERIOD
            stamp = self.stamp
        msg = Image(height=frame.shape[0], width=frame.shape[1], encoding=encoding, step=frame[0].nbytes)
        msg.data = array.array("B", frame.tobytes())
        msg.header.stamp = stamp_to_msg(stamp)
        for name, value in fields.items():
            setattr(msg, name, value)
        self.images.publish(msg)

    def see(self, truth: Pose) -> Pose:
        """Send a frame and return the pose that comes back."""
        count = len(self.poses)
        self.send(self.simulation.render(truth))
        self.ros.wait_for(lambda: len(self.poses) > count, what="a pose")
        return pose_from_msg(self.poses[-1].pose.pose)

    def place(self, pose: Pose) -> None:
        """Announce a placement; return once the tracker has it, or will have it before any later frame."""
        self.placements.publish(PoseStamped(pose=pose_to_msg(pose)))
        self.ros.wait_for(lambda: self.tracker._watch.placement == pytest.approx(pose), what="the placement's arrival")

    def report(self, **expected: str) -> DiagnosticStatus:
        """Wait for diagnostics with the expected values, and return them."""

        def found() -> bool:
            return any(self.values(status).items() >= expected.items() for status in self.reports)

        self.ros.wait_for(found, what=f"a report of {expected}")
        return next(status for status in self.reports if self.values(status).items() >= expected.items())

    @staticmethod
    def values(status: DiagnosticStatus) -> dict[str, str]:
        return {entry.key.replace(" ", "_").replace("/", "_"): entry.value for entry in status.values}


def assert_close(pose: Pose, truth: Pose) -> None:
    assert np.hypot(pose.x - truth.x, pose.y - truth.y) < 3e-5  # 0.05 px
    assert abs(wrap(pose.theta - truth.theta)) < 0.001


@pytest.fixture
def cell(ros, tmp_path) -> Cell:
    return Cell(ros, tmp_path)


def test_publishes_the_pose_at_the_time_of_the_image(cell):
    assert_close(cell.see(TRUTH), TRUTH)
    msg = cell.poses[0]
    assert msg.header.frame_id == "table"
    assert stamp_from_msg(msg.header.stamp) == cell.stamp
    covariance = msg.pose.covariance.reshape(6, 6)
    assert (np.diag(covariance)[[0, 1, 5]] > 0).all()
    assert (np.sqrt(np.diag(covariance)[[0, 1]]) < 1e-5).all()  # [m]
    np.testing.assert_allclose(covariance, covariance.T, rtol=1e-9)
    # z, roll and pitch are not measured: a variance of 0 would claim that they are exact
    np.testing.assert_array_equal(covariance[2:5], UNMEASURED * np.eye(6)[2:5])
    assert np.linalg.matrix_rank(covariance) == 6


def test_diagnostics_say_whether_the_object_is_seen(cell):
    cell.see(TRUTH)
    seen = cell.report(seen="1", object="block", visible="1.0")
    assert (seen.level, seen.message, cell.values(seen)["no_pose"]) == (DiagnosticStatus.OK, "seen", "")
    assert 0 < float(cell.values(seen)["residual_[px]"]) < 0.1
    cell.send(cell.simulation.render(None))
    lost = cell.report(frames="2", seen="1")
    assert (lost.level, lost.message) == (DiagnosticStatus.WARN, f"not seen: {NO_OBJECT}")
    assert cell.values(lost)["no_pose"] == NO_OBJECT
    cell.reports.clear()
    idle = cell.report(frames="2", frames_s="0.0")
    assert (idle.level, idle.message) == (DiagnosticStatus.ERROR, "no frames from image_raw")
    assert cell.values(idle)["no_pose"] == idle.message


def test_late_frames_are_dropped_and_counted(cell):
    cell.see(TRUTH)
    for stamp in (cell.stamp - PERIOD // 2, cell.stamp):
        cell.send(cell.simulation.render(TRUTH), stamp=stamp)
    cell.see(TRUTH)
    assert len(cell.poses) == 2
    cell.report(frames="2", late_frames_dropped="2")


@pytest.mark.parametrize(
    ("encoding", "fields", "reason"),
    [
        ("32FC1", {}, f"encoding must be {', '.join(TO_GREY)}, got '32FC1'"),
        ("mono8", {"width": 0}, "an image must have pixels, got 0 x 480 mono8"),
        ("mono8", {"width": 320, "step": 640}, "the camera is calibrated for 640 x 480 px, the image has 320 x 480"),
    ],
)
def test_unusable_frames_are_counted(cell, encoding, fields, reason):
    cell.send(cell.simulation.render(TRUTH), encoding, **fields)
    assert cell.report(unusable_frames="1", last_reason=reason).level == DiagnosticStatus.ERROR
    cell.see(TRUTH)
    assert len(cell.poses) == 1


@pytest.mark.parametrize("late", [False, True], ids=["placement first", "placement late"])
def test_an_object_turned_while_no_frame_came_is_seen_as_it_was_to_be_placed(cell, late):
    """For example, the tracker was stopped while the operator turned the object and put it back in its place."""
    cell.see(TRUTH)
    turned = TRUTH._replace(theta=wrap(TRUTH.theta + np.pi))
    cell.stamp += 10**9
    announced = PoseStamped(pose=pose_to_msg(turned))
    announced.header.stamp = stamp_to_msg(cell.stamp)
    cell.stamp += 10**9
    if late:  # of the messages that wait for a process, those of one topic may come before those of another
        cell.see(turned)
    cell.placements.publish(announced)
    cell.ros.wait_for(lambda: cell.tracker._watch.placement == pytest.approx(turned), what="the placement's arrival")
    assert_close(cell.see(turned), turned)
    assert_close(cell.see(turned), turned)


def test_a_placement_decides_between_orientations_that_look_the_same(cell):
    away = cell.simulation.render(None)
    for theta in (0.3, 0.3 + np.pi, 2.0, 2.0 - np.pi):
        truth = TRUTH._replace(theta=wrap(theta))
        cell.place(Pose(truth.x + 0.002, truth.y - 0.002, truth.theta + 0.2))
        cell.send(away)
        assert_close(cell.see(truth), truth)
        # from then on its last pose decides, through more than a quarter turn
        for turn in np.arange(0.2, 2.5, 0.2):
            assert_close(cell.see(truth._replace(theta=truth.theta + turn)), truth._replace(theta=truth.theta + turn))
        # a moment out of sight changes nothing
        cell.send(away)
        assert_close(cell.see(truth._replace(theta=truth.theta + 2.5)), truth._replace(theta=truth.theta + 2.5))


def test_compressed_images(ros, tmp_path):
    cell = Cell(ros, tmp_path, source="compressed")
    publisher = ros.publisher(cell.here, CompressedImage, "image_raw/compressed", SENSOR_DATA)

    def send(data: bytes, stamp: int) -> None:
        msg = CompressedImage(format="jpeg", data=array.array("B", data))
        msg.header.stamp = stamp_to_msg(stamp)
        publisher.publish(msg)

    for broken in (b"", b"no picture"):
        send(broken, FIRST)
    cell.report(unusable_frames="2", last_reason="not a picture: 10 bytes of format 'jpeg'")
    send(cv2.imencode(".jpg", cell.simulation.render(TRUTH))[1].tobytes(), FIRST)
    ros.wait_for(lambda: cell.poses, what="a pose")
    pose = pose_from_msg(cell.poses[0].pose.pose)
    assert np.hypot(pose.x - TRUTH.x, pose.y - TRUTH.y) < 1e-4  # as JPEG left it
    assert stamp_from_msg(cell.poses[0].header.stamp) == FIRST


def test_a_frozen_topic_gives_no_pose(cell):
    frame = cell.simulation.render(TRUTH)
    for _ in range(FROZEN_FRAMES + 3):
        cell.send(frame)
    cell.report(frames=str(FROZEN_FRAMES + 3), seen=str(FROZEN_FRAMES - 1), last_reason="frozen frame")
    assert_close(cell.see(TRUTH), TRUTH)


def test_markers_give_the_pose(ros, tmp_path):
    (tmp_path / "markers.yaml").write_text("{family: apriltag_36h11, markers: [{id: 5, size: 0.04, center: [0.02, 0.0]}]}")
    cell = Cell(ros, tmp_path, fiducials=str(tmp_path / "markers.yaml"))
    cell.send(marked_picture(load_fiducials(tmp_path / "markers.yaml"), CAMERA, TRUTH, HEIGHT, np.random.default_rng(0)))
    ros.wait_for(lambda: cell.poses, what="a pose")
    assert_close(pose_from_msg(cell.poses[0].pose.pose), TRUTH)


def test_poses_wait_for_those_who_must_not_miss_one(ros, tmp_path):
    cell = Cell(ros, tmp_path, heard_by=["late"])
    cell.send(cell.simulation.render(TRUTH))
    waiting = cell.report(seen="1")
    assert (waiting.level, waiting.message) == (DiagnosticStatus.WARN, "waiting for late to receive the poses")
    assert not cell.poses
    late = ros.node("late", namespace="/cell")
    late.create_subscription(PoseWithCovarianceStamped, "object_pose", lambda _: None, SENSOR_QUEUE)
    ros.wait_for(lambda: not cell.tracker._required_subscribers.missing, what="the late node")
    assert_close(cell.see(TRUTH), TRUTH)


def test_an_offset_shifts_the_stamp_and_a_threshold_is_used(ros, tmp_path):
    cell = Cell(ros, tmp_path, time_offset=-0.04, threshold=120)
    assert_close(cell.see(TRUTH), TRUTH)
    assert stamp_from_msg(cell.poses[0].header.stamp) == cell.stamp - 40_000_000


def test_the_overlay_shows_the_outline(cell):
    overlays: list[CompressedImage] = []
    subscription = cell.here.create_subscription(CompressedImage, "overlay/compressed", overlays.append, SENSOR_DATA)
    cell.ros.wait_for(
        lambda: subscription.get_publisher_count() and cell.tracker._drawing._out.get_subscription_count(),
        what="the overlay's subscriber",
    )
    cell.see(TRUTH)
    cell.ros.wait_for(lambda: overlays, what="an overlay")
    assert overlays[0].format == "jpeg"
    picture = cv2.imdecode(np.frombuffer(overlays[0].data, np.uint8), cv2.IMREAD_COLOR).astype(int)
    assert (picture[..., 1] - picture[..., 2] > 60).any()


def test_a_video_file_as_source(ros, tmp_path):
    simulation = SimulatedCamera(CAMERA, OUTLINE, HEIGHT, np.random.default_rng(0))
    truths = [TRUTH._replace(x=TRUTH.x + 0.001 * i) for i in range(10)]
    save_video(tmp_path / "pushes.avi", [simulation.render(truth) for truth in (*[TRUTH] * 60, *truths)], rate=100)
    cell = Cell(ros, tmp_path, source=str(tmp_path / "pushes.avi"))
    last = truths[-1].x - 2e-4
    ros.wait_for(lambda: len(cell.poses) >= 10 and cell.poses[-1].pose.pose.position.x > last, what="the last pose")
    for msg, truth in zip(cell.poses[-10:], truths, strict=True):
        assert abs(msg.pose.pose.position.x - truth.x) < 2e-4  # as JPEG left it
    assert (np.diff([stamp_from_msg(msg.header.stamp) for msg in cell.poses]) > 0).all()


@pytest.mark.parametrize(
    ("parameters", "text"),
    [
        ({"source": "99"}, "no camera at '99': expected a camera's index .*; or topic or compressed, for a camera"),
        ({"tracker": "fiducial"}, "fiducials must name the YAML file of the markers on the object, got ''"),
    ],
)
def test_unusable_parameters_are_refused(ros, tmp_path, parameters, text):
    with pytest.raises(InvalidInput, match=text):
        Cell(ros, tmp_path, **parameters)
