"""A page on which a person works over a camera's picture, in a browser; knows no ROS and no camera driver."""

import queue
from collections.abc import Callable
from contextlib import nullcontext
from typing import Any, Protocol

import cv2

from pushfric_core.cell.node_settings import ViewConfig
from pushfric_core.errors import InvalidInput
from pushfric_core.page.server import PageServer, Reply, Request
from pushfric_core.vision.camera import Image
from pushfric_core.vision.frame_source import Frames

PNG = "picture.png"

ADDRESSES = f"state|{PNG}", "work|another|save"
"""The requests that change nothing, and the others."""


class Work(Protocol):
    """The work on such a page, until it is saved. Each method may raise InvalidInput, whose text the page shows."""

    def show(self, image: Image, source: str) -> None:
        """Take a picture (height, width) of a source to work over, the first or another one."""

    def picture(self) -> Image:
        """The picture as the page shows it."""

    def take(self, body: bytes) -> None:
        """Take what the page's visitor has done so far, a JSON text."""

    def figures(self) -> dict[str, Any]:
        """The content of the page: all lengths in m, all pixels as (u, v)."""

    def save(self) -> str:
        """Write the result; return what the page says then."""


def work_in_a_browser(page: str, work: Work, source: Frames | None, shown: ViewConfig, announce: Callable[[str], None]) -> None:
    """Serve a page until somebody there saves the work.

    Args:
        page: name of its file.
        work: what is done on it.
        source: not opened yet; one of its frames is shown, and the next when the page asks for it. None: no picture.
        shown: where the page is served.
        announce: called with the line that names its address.
    Raises:
        InvalidInput: the first picture cannot be had, or the page cannot be served there.
    """
    # Everything is done in this thread: a topic is received in the one that opened it.
    requests: queue.SimpleQueue[Request] = queue.SimpleQueue()
    with nullcontext() if source is None else source:
        if source is not None:
            work.show(_next_picture(source), source.name)
        server = PageServer(shown, page, requests.put, *ADDRESSES)
        try:
            announce(f"view: {server.url}")
            saved = False
            while not saved:
                asked = requests.get()
                reply: Reply
                try:
                    if asked.what == PNG:
                        reply = "image/png", cv2.imencode(".png", work.picture())[1].tobytes()
                    elif asked.what == "another":
                        if source is not None:
                            work.show(_next_picture(source), source.name)
                        reply = {"done": True}
                    elif asked.what == "save":
                        reply = {"done": True, "message": work.save()}
                        saved = True
                    else:
                        if asked.what == "work":
                            work.take(asked.body)
                        reply = {"done": True, "source": source and source.name, **work.figures()}
                except (InvalidInput, OSError) as error:
                    reply = {"done": False, "message": str(error)}
                asked.answer(reply)
        finally:
            server.close()


def _next_picture(source: Frames) -> Image:
    """The present frame of a camera, or the next picture of an opened source.

    Raises:
        InvalidInput: there is none.
    """
    source.forget()
    for frame in source:
        return frame
    raise InvalidInput(f"{source.name}: no further picture")
