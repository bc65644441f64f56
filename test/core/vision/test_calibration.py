"""Calibration from rendered pictures of the board through a known lens, the board's PDF, and what is refused."""

import http.server
import math
import re
import threading

import cv2
import numpy as np
import pytest
from calls import printed
from printed import black_rings, picture, rasterised
from videos import save_video

from pushfric_core.errors import InvalidInput
from pushfric_core.geometry.planar import rotation
from pushfric_core.vision.board import Board, BoardFinder, View, charuco
from pushfric_core.vision.calibration import (
    calibrate_lens,
    calibrate_table,
    lens_from_frames,
    read_table_points,
    table_from_frames,
)
from pushfric_core.vision.camera import Camera, Lens, load_camera, load_lens, save_camera
from pushfric_core.vision.frame_source import DeviceFrames
from pushfric_core.vision.printed_pdf import save_board

BOARD = Board()
LENS = Lens(640, 480, np.array(((900.0, 0, 330), (0, 905, 236), (0, 0, 1))), np.array((-0.2, 0.08, 0.001, -0.0005, 0)))
PER_METRE = 5000
MARGIN = 0.014
# tilt about u and v, roll [rad]; distance, and offset of the board's middle to the right and down [m]
FLAT = (0.0, 0.0, 0.0, 0.45, 0.0, 0.0)
VIEWS = (
    (0.4, 0.0, 0.1, 0.42, 0.03, 0.02),
    (-0.4, 0.1, 0.0, 0.42, -0.05, 0.03),
    (0.0, 0.45, 0.2, 0.42, 0.06, -0.03),
    (0.1, -0.45, -0.1, 0.42, -0.06, -0.03),
    (0.3, 0.3, 0.5, 0.38, 0.02, 0.0),
    (-0.3, 0.3, 1.5, 0.42, 0.0, 0.02),
    (-0.3, -0.35, 0.0, 0.40, -0.02, -0.03),
    (0.35, -0.3, 0.1, 0.40, 0.05, 0.03),
)


def over_board(tilt_u, tilt_v, roll, distance, right, down, lens=LENS) -> Camera:
    """The camera, with the board's frame as the table frame."""
    turns = [cv2.Rodrigues(np.array(turn, dtype=float))[0] for turn in ((tilt_u, 0, 0), (0, tilt_v, 0), (0, 0, roll))]
    R = turns[0] @ turns[1] @ turns[2] @ np.diag((1.0, -1, -1))
    middle = np.array((*BOARD.size, 0)) / 2
    return lens.over(lens.K @ np.column_stack((R[:, :2], np.array((right, down, distance)) - R @ middle)))


@pytest.fixture(scope="module")
def printed_board(tmp_path_factory) -> np.ndarray:
    """The board's PDF as a printer prints it: black and white, with MARGIN around the squares."""
    path = tmp_path_factory.mktemp("board") / "board.pdf"
    save_board(BOARD, path)
    return rasterised(path, MARGIN, PER_METRE)


def shown(printed_board, *place) -> np.ndarray:
    return picture(over_board(*place), printed_board, (-MARGIN, -MARGIN), PER_METRE, np.random.default_rng(0))


@pytest.fixture(scope="module")
def pictures(printed_board) -> list[np.ndarray]:
    return [shown(printed_board, *place) for place in VIEWS]


@pytest.fixture(scope="module")
def flat(printed_board) -> np.ndarray:
    return shown(printed_board, *FLAT)


@pytest.fixture(scope="module")
def views(pictures):
    return [BoardFinder(BOARD).view(frame) for frame in pictures]


def grid() -> np.ndarray:
    """Pixels all over the image."""
    return np.stack(np.meshgrid(np.linspace(20, 620, 7), np.linspace(20, 460, 5)), axis=-1).reshape(-1, 2)


def assert_recovered(lens: Lens) -> None:
    assert (lens.width, lens.height) == (640, 480)
    np.testing.assert_allclose(np.diag(lens.K), np.diag(LENS.K), rtol=1e-3)
    np.testing.assert_allclose(lens.K[:2, 2], LENS.K[:2, 2], atol=1.5)
    # distortion coefficients can compensate each other, so the pixels of rays are compared
    rays = cv2.undistortPoints(grid().reshape(-1, 1, 2), LENS.K, LENS.D)
    solid = np.column_stack((rays.reshape(-1, 2), np.ones(len(rays))))
    pixels, _ = cv2.projectPoints(solid, np.zeros(3), np.zeros(3), lens.K, lens.D)
    off = pixels.reshape(-1, 2) - grid()
    assert np.abs(off).max() < 1.5
    assert np.abs(off - off.mean(axis=0)).max() < 0.5  # a shift of the principal point acts like a tilt of the camera


def test_the_lens_is_recovered(views):
    calibration = calibrate_lens(views, 640, 480)
    assert_recovered(calibration.lens)
    assert calibration.rms_px < 0.05
    assert calibration.view_rms_px.shape == (8,)
    assert 0 < calibration.focal_error < 0.002


def test_from_pictures_to_a_file(tmp_path, flat, pictures):
    folder = tmp_path / "views"
    folder.mkdir()
    for number, frame in enumerate((*pictures, pictures[0], np.zeros_like(flat))):  # one twice, one without the board
        cv2.imwrite(str(folder / f"{number}.png"), frame)
    (folder / "10.png").write_text("no picture")
    told: list[str] = []
    calibration = lens_from_frames(DeviceFrames(str(folder)), BOARD, told.append)
    assert_recovered(calibration.lens)
    assert [line.partition(":")[0] for line in told[:8]] == [f"view {number}" for number in range(1, 9)]
    assert told[8:] == [
        "1 of 11 pictures left out, the board lies as in a picture before it: 8.png",
        "1 of 11 pictures left out, the board is not found: 9.png",
        "1 of 11 pictures left out, the file is no picture: 10.png",
    ]
    save_camera(calibration.lens, tmp_path / "lens.yaml")
    lens = load_lens(tmp_path / "lens.yaml")
    cv2.imwrite(str(tmp_path / "[table].png"), flat)
    cv2.imwrite(str(tmp_path / "table.png"), flat)
    table = table_from_frames(DeviceFrames(str(tmp_path / "table*.png")), BOARD, lens, told.append)
    np.testing.assert_allclose(table.camera.unproject(grid()), over_board(*FLAT).unproject(grid()), atol=3e-4)


def test_only_views_at_rest_are_taken_from_a_video(tmp_path, pictures):
    frames = [frame for number, frame in enumerate(pictures) for _ in range(1 if number == 3 else 2)]
    save_video(tmp_path / "views.avi", frames, rate=200)
    with pytest.raises(InvalidInput, match=r"views\.avi: too few different views of the board: expected at least 8, got 7"):
        lens_from_frames(DeviceFrames(str(tmp_path / "views.avi")), BOARD, lambda line: None)
    save_video(tmp_path / "moving.avi", pictures, rate=200)
    with pytest.raises(InvalidInput, match=r"moving\.avi: the board never rests in 8 pictures; hold it still in each place$"):
        lens_from_frames(moving := DeviceFrames(str(tmp_path / "moving.avi")), BOARD, lambda line: None)
    assert not moving._device._capture.isOpened()  # the next one can open it


def test_a_live_camera_is_read_until_the_views_are_enough(pictures):
    jpegs = [cv2.imencode(".jpg", frame, (cv2.IMWRITE_JPEG_QUALITY, 98))[1].tobytes() for frame in pictures]
    over = threading.Event()
    told: list[str] = []

    class Stream(http.server.BaseHTTPRequestHandler):
        def do_GET(self):
            self.send_response(200)
            self.send_header("Content-Type", "multipart/x-mixed-replace; boundary=frame")
            self.end_headers()
            while not over.wait(0.02):
                jpeg = jpegs[min(len(told), len(jpegs) - 1)]  # the next view once this one has been taken
                head = f"--frame\r\nContent-Type: image/jpeg\r\nContent-Length: {len(jpeg)}\r\n\r\n".encode()
                try:
                    self.wfile.write(head + jpeg + b"\r\n")
                except OSError:
                    return

        def log_message(self, *_):
            pass

    server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), Stream)
    thread = threading.Thread(target=server.serve_forever)
    thread.start()
    try:
        calibration = lens_from_frames(DeviceFrames(f"http://127.0.0.1:{server.server_port}/stream.mjpg"), BOARD, told.append)
    finally:
        over.set()
        server.shutdown()
        server.server_close()
        thread.join()
    assert_recovered(calibration.lens)
    assert told[0].endswith("; too few different views of the board: expected at least 8, got 1")


def test_too_little_tilt_is_refused(printed_board, flat):
    # tilted up and down only
    places = [(0.3 * np.sign(x), 0, 0, 0.45, x, y) for x in (-0.06, 0.06) for y in (-0.04, 0.04)]
    views = [BoardFinder(BOARD).view(shown(printed_board, *place)) for place in places] * 2
    with pytest.raises(
        InvalidInput, match=r"too little tilt left and right: [0-9] degrees between the views, expected at least 20"
    ):
        calibrate_lens(views, 640, 480)
    with pytest.raises(InvalidInput, match="too little tilt left and right: 0 degrees"):
        calibrate_lens([BoardFinder(BOARD).view(flat)] * 8, 640, 480)


def test_views_that_hardly_determine_the_focal_length_are_refused(views, rng):
    blurred = [view._replace(pixels=view.pixels + rng.normal(0, 0.65, view.pixels.shape)) for view in views]
    with pytest.raises(InvalidInput, match=r"the focal length is known only to .*%"):
        calibrate_lens(blurred, 640, 480)


def measured(pixels, tmp_path, head="u,v,x,y"):
    """A file of points on the table, measured without error."""
    table = over_board(*FLAT).unproject(pixels)
    rows = [",".join(map(repr, map(float, (*pixel, *point)))) for pixel, point in zip(pixels, table, strict=True)]
    path = tmp_path / "points.csv"
    path.write_text("\n".join((head, *rows)) + "\n")
    return path


WIDE = [(100, 80), (540, 90), (560, 400), (90, 390)]


def test_the_table_is_recovered_from_four_points(tmp_path):
    calibration = calibrate_table(LENS, [read_table_points(measured(WIDE, tmp_path))])
    np.testing.assert_allclose(calibration.camera.unproject(grid()), over_board(*FLAT).unproject(grid()), atol=1e-6)
    assert calibration.rms_px < 1e-3


def test_the_cameras_file_gets_the_table_and_stays_as_it_is(tmp_path):
    file = tmp_path / "camera.yaml"
    save_camera(LENS, file)
    text = file.read_text().replace("camera_name: camera", "camera_name: straight_down  # over the cell")
    file.write_text(text)
    points = measured(WIDE, tmp_path)
    for name in ("points.csv", "POINTS.CSV"):
        printed("calibrate", "table", points.rename(points.with_name(name)), "--camera", file)
        assert file.read_text().startswith(f"{text}table_homography: ")
    assert np.array_equal(load_camera(file).H, calibrate_table(LENS, [read_table_points(points.with_name(name))]).camera.H)
    with pytest.raises(InvalidInput, match=r"camera\.yaml exists: give --force, or another --out FILE"):
        printed("calibrate", "lens", tmp_path, "--out", file)


def test_exact_points_seen_straight_from_above_are_not_mirrored():
    """For these, OpenCV's solver for planes gives a wrong pose."""
    camera = Camera.looking_down(640, 480, (0.16, 0.12), 0.0005)
    points = np.array([(x, y) for x in (0.0, 0.1, 0.2) for y in (0.0, 0.1, 0.2)])
    found = calibrate_table(camera, [View(np.arange(9), points, camera.project(points))])
    np.testing.assert_allclose(found.camera.unproject(grid()), camera.unproject(grid()), atol=1e-6)


@pytest.mark.parametrize("name", ["one.png", "photo[1].png", "shots[2]/", "h?x/"])
def test_a_file_or_folder_is_read_whatever_its_name(tmp_path, name):
    path = tmp_path / f"{name}a.png" if name.endswith("/") else tmp_path / name
    path.parent.mkdir(exist_ok=True)
    cv2.imwrite(str(path), np.zeros((48, 64), np.uint8))
    with DeviceFrames(str(tmp_path / name)) as frames:
        assert (frames.pictures, len(list(frames))) == (True, 1)


@pytest.mark.parametrize("source", ["http://localhost:1/a.mjpg?size=640", "4294967296"])
def test_an_address_is_no_pattern_and_a_large_number_no_camera(source):
    with pytest.raises(InvalidInput, match="no camera at "), DeviceFrames(source):
        pass


def test_a_picture_that_is_too_large_costs_only_itself(tmp_path, monkeypatch):
    read = cv2.imread
    for name in "abc":
        cv2.imwrite(str(tmp_path / f"{name}.png"), np.zeros((48, 64), np.uint8))

    def refuse_b(path, flags):
        if path.endswith("b.png"):
            raise cv2.error("pixels <= CV_IO_MAX_IMAGE_PIXELS")
        return read(path, flags)

    monkeypatch.setattr(cv2, "imread", refuse_b)
    with DeviceFrames(str(tmp_path)) as frames:
        assert (len(list(frames)), frames.unread) == (2, ["b.png"])


@pytest.mark.parametrize(
    ("pixels", "text"),
    [
        (WIDE[:3], "too few different points: expected at least 4, got 3"),
        ([(2 * u, 2 * v) for u, v in WIDE], "a pixel lies outside the image for which the lens is calibrated: 640 x 480 px"),
        (
            [(100, 80), (200, 180), (300, 280), (400, 380)],
            "the points lie on a line or in one place: expected points spread over the table",
        ),
        (
            [(20, 20), (200, 20), (200, 200), (20, 200)],
            "badly spread: an error of 1 px in them grows to [0-9]+ px in the image's lower right",
        ),
    ],
)
def test_points_that_do_not_determine_the_table_are_refused(tmp_path, pixels, text):
    with pytest.raises(InvalidInput, match=text):
        calibrate_table(LENS, [read_table_points(measured(pixels, tmp_path))])


WIDE_LENS = Lens(640, 480, np.array(((560.0, 0, 330), (0, 560, 236), (0, 0, 1))), np.zeros(5))
PLACES = ((0.0, 0.0, 0.0), (0.12, 0.02, 0.4), (-0.12, 0.06, -0.3), (-0.1, -0.1, 1.6), (0.1, -0.12, -0.8))
"""Poses of the board's frame on the table [m, rad]; the first is the table frame."""


def far_places(noise_px, seed=0):
    """A wide-angle camera 0.6 m over the table, and the corners of a board in PLACES, with noisy pixels."""
    camera = over_board(0.15, -0.1, 0.0, 0.6, 0.0, 0.0, WIDE_LENS)
    rng = np.random.default_rng(seed)
    corners = np.array(charuco(BOARD).getChessboardCorners(), dtype=float)[:, :2]
    about = np.array(BOARD.size) / 2
    placements = []
    for x, y, angle in PLACES:
        turned = (corners - about) @ rotation(angle).T + about + (x, y)
        pixels = camera.project(turned) + rng.normal(0, noise_px, corners.shape)
        placements.append(View(np.arange(len(corners)), corners, pixels))
    return camera, placements


def test_a_board_that_is_small_in_the_image_is_laid_in_several_places():
    truth, placements = far_places(0.1)
    with pytest.raises(InvalidInput, match=r"grows to .* px in the image's .*; add points there, or lay the board there too"):
        calibrate_table(WIDE_LENS, placements[:1])
    calibration = calibrate_table(WIDE_LENS, placements)
    assert calibration.rms_px == pytest.approx(0.1 * math.sqrt(2), rel=0.2)
    np.testing.assert_allclose(calibration.camera.unproject(grid()), truth.unproject(grid()), atol=1e-3)
    assert calibration.map.errors.max() < 1e-3


def test_the_map_says_how_far_places_are_off():
    squares = []
    for seed in range(30):
        truth, placements = far_places(0.2, seed)
        found = calibrate_table(WIDE_LENS, placements)
        pixels = found.camera.project(found.map.places.reshape(-1, 2))
        off = np.linalg.norm(truth.unproject(pixels) - found.map.places.reshape(-1, 2), axis=1)
        squares.append((off / found.map.errors.ravel()) ** 2)
    # the squares of errors over their sigmas average to 1, in every part of the image
    assert np.mean(squares) == pytest.approx(1.0, abs=0.3)
    assert np.mean(squares, axis=0).max() < 2


def test_a_point_measured_wrongly_is_named(tmp_path):
    seen = read_table_points(measured([*WIDE, (330, 240), (320, 100)], tmp_path))
    seen.points[4] += (0.03, 0)
    with pytest.raises(InvalidInput, match=r"the points disagree by .* px \(.* mm\); the worst is number 5, by .* px"):
        calibrate_table(LENS, [seen])


def test_the_board_is_printed_to_scale(tmp_path):
    board = Board(5, 4, 0.0365)
    save_board(board, tmp_path / "board.pdf")
    every = np.concatenate(black_rings(tmp_path / "board.pdf"))
    np.testing.assert_allclose(np.ptp(every, axis=0), (5 * 36.5, 4 * 36.5), atol=1e-3)  # [mm]
    (page,) = re.findall(rb"/MediaBox \[ 0 0 ([\d.]+) ([\d.]+) \]", (tmp_path / "board.pdf").read_bytes())
    np.testing.assert_allclose([float(side) * 25.4 / 72 for side in page], (297, 210), atol=0.01)


@pytest.mark.parametrize(
    ("fields", "text"),
    [
        ({"columns": 3}, "must have 4 x 4 to 500 squares, got 3 x 6"),
        ({"square": 0.0}, "larger than 0 and smaller than 1 m, got 0"),
    ],
)
def test_no_real_board_is_refused(fields, text):
    with pytest.raises(ValueError, match=text):
        Board(**fields)
