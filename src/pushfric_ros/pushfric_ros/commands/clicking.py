"""Points of the table, clicked in a browser."""

import pathlib
import queue

import cv2

from pushfric_core.cell.node_settings import ViewConfig
from pushfric_core.commands.console import console
from pushfric_core.errors import InvalidInput
from pushfric_core.vision.camera import Image, Lens, save_camera
from pushfric_core.vision.frame_source import Frames
from pushfric_core.vision.table_calibration import TableCalibration, check_size
from pushfric_ros.view.clicked_points import MOST, ClickedPoints
from pushfric_ros.view.points_server import PNG, PointsServer, Question, Reply


def click_points(
    source: Frames, lens: Lens, marks: list[list[float]], shown: ViewConfig, target: pathlib.Path
) -> TableCalibration:
    """Serve the page until somebody there saves the calibration.

    Args:
        source: not opened yet; one of its frames is shown, and the next when the page asks for it.
        lens: of the camera.
        marks: x and y of the points to click [m]; empty: they are typed on the page.
        shown: where the page is served.
        target: the file that the calibration is written to.
    Raises:
        InvalidInput: too many marks, the first picture cannot be had, or the page cannot be served there.
    """
    if len(marks) > MOST:
        raise InvalidInput(f"expected at most {MOST} points to click, got {len(marks)}")
    # Everything is done in this thread: a topic is received in the one that opened it.
    questions: queue.SimpleQueue[Question] = queue.SimpleQueue()
    with source:
        clicked, picture = ClickedPoints(lens), _picture(source, lens)
        server = PointsServer(shown, questions.put)
        try:
            console.print(f"view: {server.url}", markup=False)
            about = {"camera": str(target), "source": source.name, "width": lens.width, "height": lens.height, "marks": marks}
            while True:
                asked = questions.get()
                reply: Reply
                try:
                    if asked.what == PNG:
                        reply = cv2.imencode(".png", picture)[1].tobytes()
                    elif asked.what == "another":
                        picture = _picture(source, lens)
                        reply = {"done": True}
                    elif asked.what == "save":
                        if clicked.found is None:
                            raise InvalidInput(clicked.problem)
                        save_camera(clicked.found.camera, target)
                        asked.answer({"done": True, "message": f"Saved in {target}. You can close this page"})
                        return clicked.found
                    else:
                        if asked.what == "points":
                            clicked.take(asked.body)
                        reply = {"done": True, **about, **clicked.figures()}
                except (InvalidInput, OSError) as error:
                    reply = {"done": False, "message": str(error)}
                asked.answer(reply)
        finally:
            server.close()


def _picture(source: Frames, lens: Lens) -> Image:
    source.forget()
    for frame in source:
        check_size(frame, lens, source.name)
        return frame
    raise InvalidInput(f"{source.name}: no further picture")
