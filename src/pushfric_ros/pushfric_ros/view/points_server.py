"""Serves the page on which points of the table are clicked in a camera's picture; knows no ROS and no camera."""

import asyncio
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, NamedTuple

from pushfric_core.cell.node_settings import ViewConfig
from pushfric_core.report.report import to_json
from pushfric_ros.view.page_server import Asked, PageServer

PNG = "picture.png"

Reply = bytes | dict[str, Any]
"""A picture, or what becomes JSON."""


class Question(NamedTuple):
    """Something that the page asks for."""

    what: str  # state, points, another, save, or PNG
    body: bytes  # of the request
    answer: Callable[[Reply], None]  # from any thread; only the first answer counts


class PointsServer(PageServer):
    """The server of one calibration.

    Args:
        config: where to serve, and the token that a visitor must show.
        on_question: called from the server's thread with each question.
    Raises:
        InvalidInput: the server cannot listen there.
    """

    def __init__(self, config: ViewConfig, on_question: Callable[[Question], None]) -> None:
        self._on_question = on_question
        self._answering: set[asyncio.Future[None]] = set()
        super().__init__(config, "points.html", [(rf"/(state|{PNG})", Shown), (r"/(points|another|save)", Done)])

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
    server: PointsServer

    async def _pass_on(self, what: str) -> None:
        self.admit()
        with self.server.answering():
            reply = await self.server.ask(what, self.request.body)
            self.set_header("Content-Type", "image/png" if isinstance(reply, bytes) else "application/json")
            await self.finish(reply if isinstance(reply, bytes) else to_json(reply))


class Shown(_Question):
    """What the page shows; changes nothing."""

    async def get(self, what: str) -> None:
        """Answer the question, unless it comes from the page of another site or without the token."""
        await self._pass_on(what)


class Done(_Question):
    """What the page changes."""

    async def post(self, what: str) -> None:
        """Carry the request out, unless it comes from the page of another site or without the token."""
        await self._pass_on(what)
