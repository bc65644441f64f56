"""Serves a page on which a person works over a camera's picture; knows no ROS and no camera driver."""

import asyncio
import queue
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from typing import Any, NamedTuple, Protocol

import cv2

from pushfric_core.cell.node_settings import ViewConfig
from pushfric_core.errors import InvalidInput
from pushfric_core.page.server import Asked, PageServer
from pushfric_core.records import to_json
from pushfric_core.vision.camera import Image
from pushfric_core.vision.frame_source import Frames

PNG = "picture.png"

Reply = bytes | dict[str, Any]
"""A picture, or what becomes JSON."""


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
    questions: queue.SimpleQueue[Question] = queue.SimpleQueue()
    with nullcontext() if source is None else source:
        if source is not None:
            work.show(_next_picture(source), source.name)
        server = PictureServer(shown, page, questions.put)
        try:
            announce(f"view: {server.url}")
            saved = False
            while not saved:
                asked = questions.get()
                reply: Reply
                try:
                    if asked.what == PNG:
                        reply = cv2.imencode(".png", work.picture())[1].tobytes()
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


class Question(NamedTuple):
    """Something that the page asks for."""

    what: str  # state, work, another, save, or PNG
    body: bytes  # of the request
    answer: Callable[[Reply], None]  # from any thread; only the first answer counts


class PictureServer(PageServer):
    """The server of one piece of work.

    Args:
        config: where to serve, and the token that a visitor must show.
        page: name of the file that is the page.
        on_question: called from the server's thread with each question.
    Raises:
        InvalidInput: the server cannot listen there.
    """

    def __init__(self, config: ViewConfig, page: str, on_question: Callable[[Question], None]) -> None:
        self._on_question = on_question
        self._answering: set[asyncio.Future[None]] = set()
        super().__init__(config, page, [(rf"/(state|{PNG})", Shown), (r"/(work|another|save)", Done)])

    async def ask(self, what: str, body: bytes) -> Reply:
        """Pass a question on, and wait for the answer."""
        answered, answer = self.awaited()
        self._on_question(Question(what, body, answer))
        reply: Reply = await answered
        return reply

    @contextmanager
    def answering(self) -> Iterator[None]:
        """While an answer is on its way, the server does not close."""
        over = asyncio.get_running_loop().create_future()
        self._answering.add(over)
        try:
            yield
        finally:
            self._answering.discard(over)
            over.set_result(None)

    async def bid_farewell(self) -> None:
        """Let the last answers arrive."""
        if self._answering:
            await asyncio.wait(self._answering, timeout=1.0)


class _Question(Asked):
    server: PictureServer

    async def _pass_on(self, what: str) -> None:
        self.admit()
        with self.server.answering():
            reply = await self.server.ask(what, self.request.body)
            self.set_header("Content-Type", "image/png" if isinstance(reply, bytes) else "application/json")
            await self.finish(reply if isinstance(reply, bytes) else to_json(reply))


class Shown(_Question):
    """An answer of the page's content; changes nothing."""

    async def get(self, what: str) -> None:
        """Answer the question, unless it comes from the page of another site or without the token."""
        await self._pass_on(what)


class Done(_Question):
    """A change by the page."""

    async def post(self, what: str) -> None:
        """Carry the request out, unless it comes from the page of another site or without the token."""
        await self._pass_on(what)
