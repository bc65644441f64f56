"""Serves the page of a run, live or over, its story and its pictures, and takes the requests of visitors; knows no ROS.

A slow visitor gets fewer, later changes, and delays nobody: each visitor has one parcel of changes on the way and one that
waits, in which later values of a key replace earlier ones.
"""

import asyncio
import json
import math
import pathlib
import time
from collections.abc import Awaitable, Callable
from typing import NamedTuple

from tornado.web import HTTPError
from tornado.websocket import WebSocketClosedError, WebSocketHandler

from pushfric_core.cell.node_settings import REPORT_FILE, ViewConfig
from pushfric_core.geometry.planar import Pose
from pushfric_core.page.server import Asked, PageServer
from pushfric_core.page.story import PASSING, Change, Told, as_object
from pushfric_core.records import to_json
from pushfric_core.trajectories.observation import PUSH_IDS

AT_THE_CELL = ("lamp", "unplug", "emergency_stop")
"""The switches of a simulated cell that a visitor turns over, as a person there would."""

ACTIONS = ("stop", "reset", "repeat", "skip", "end", *AT_THE_CELL)
"""The requests of a visitor that need nothing but their name."""

FREE_FOR_ALL = "stop"
"""The action that needs no token."""

ANSWER_WITHIN = 15.0
"""If nobody answers within this time [s], the visitor is told so."""

WITHOUT_TOKEN, RUN_ENDED = 4001, 1001
"""WebSocket status codes that say why a visitor's connection is closed."""


class Answer(NamedTuple):
    """The answer to a visitor's request."""

    done: bool
    message: str


class Request(NamedTuple):
    """Something that a visitor asks for."""

    action: str  # one of ACTIONS, exclude, keep, or lay
    push: int | None  # to exclude or keep
    answer: Callable[[Answer], None]  # from any thread; only the first answer counts
    pose: Pose | None = None  # where to lay the simulated object


class Server(PageServer):
    """The server of one run.

    Args:
        config: where to serve, and the token that a visitor must show.
        on_request: called from the server's thread with each request.
        on_looking: called from the server's thread with whether anybody looks, whenever that changes.
        report: file of the page that the run leaves behind; it need not exist before the end. None: there will be none.
    Raises:
        InvalidInput: the server cannot listen there.
    """

    def __init__(
        self,
        config: ViewConfig,
        on_request: Callable[[Request], None],
        on_looking: Callable[[bool], None],
        report: pathlib.Path | None = None,
    ) -> None:
        self._on_request, self._on_looking, self.report = on_request, on_looking, report
        self.told = Told()
        self._came: dict[str, float] = {}  # when what passes did
        self._visitors: set[Visitor] = set()
        self._looking = False
        routes = [
            (r"/live", Visitor),
            (r"/(picture/\d{1,9})", Picture),
            (rf"/{REPORT_FILE}", Report),
            (rf"/({'|'.join(ACTIONS)})", Action),
            (r"/(exclude|keep)/(-?\d{1,10})", Action),
            (r"/lay/(-?\d{1,5})/(-?\d{1,5})/(-?\d{1,5})", Laying),
        ]
        super().__init__(config, "index.html", routes)

    def show(self, change: Change, jpeg: bytes = b"") -> None:
        """Send a change of the story to the visitors, with the picture that it tells of, if any; from any thread."""
        self.call(self._show, change, jpeg)

    def picture(self, jpeg: bytes) -> None:
        """Show the newest picture to those who look; from any thread."""
        self.call(self._picture, jpeg)

    def welcome(self, visitor: "Visitor") -> None:
        """Send everything so far to a new visitor."""
        self._visitors.add(visitor)
        now = time.monotonic()
        ages = {key: now - came for key, came in self._came.items()}
        visitor.tell(self.told.values | ({"ages": to_json(ages)} if ages else {}))
        self.look()

    def leave(self, visitor: "Visitor") -> None:
        """Forget a visitor."""
        self._visitors.discard(visitor)
        self.look()

    def look(self) -> None:
        """Find out whether anybody looks."""
        looking = any(visitor.looks for visitor in self._visitors)
        if looking != self._looking:
            self._looking = looking
            self._on_looking(looking)

    def ask(self, action: str, push: int | None = None, pose: Pose | None = None) -> Awaitable[Answer]:
        """Pass a request on; the answer comes later."""
        answered, answer = self.awaited()
        self._on_request(Request(action, push, answer, pose))
        return asyncio.wait_for(answered, ANSWER_WITHIN)

    async def bid_farewell(self) -> None:
        """Tell the visitors that the run has ended, once they have its report."""
        if self.report is not None and self.report.is_file():
            self._show({"reported": True}, b"")
            while any(not visitor.has_report for visitor in self._visitors):
                await asyncio.sleep(0.02)
        await asyncio.gather(*(visitor.bid_farewell() for visitor in list(self._visitors)), return_exceptions=True)

    def _show(self, change: Change, jpeg: bytes) -> None:
        told = self.told.take(change, jpeg)  # once, not for each visitor: a story may be long
        self._came |= {key: time.monotonic() for key in change if key.startswith(PASSING)}
        for visitor in self._visitors:
            visitor.tell(told)

    def _picture(self, jpeg: bytes) -> None:
        for visitor in self._visitors:
            visitor.show(jpeg)


class Visitor(WebSocketHandler):
    """An open page. It gets `{"all": story}` first, then `{"some": change}`, and JPEG pictures as binary messages."""

    def initialize(self, server: Server) -> None:
        self._server = server
        self.looks, self.has_report = True, False
        self._whole = True  # the first parcel is the whole story
        self._parcel: dict[str, str] = {}  # a change of the story, or all of it; each value as JSON
        self._jpeg: bytes | None = None
        self._news = asyncio.Event()
        self._sending: asyncio.Task[None] | None = None

    def prepare(self) -> None:
        """Accept only pages of this server: those of other sites must not read the story.

        The library asks `check_origin` only where origin and host differ: not where another site's name leads here.
        """
        headers = self.request.headers
        origin = headers.get("Origin") or headers.get("Sec-Websocket-Origin")
        if not self._server.is_asked_from_here(self.request.host, origin):
            raise HTTPError(403)

    def open(self, *_: str, **__: str) -> None:
        """Refuse a visitor without the right token; the page then says so."""
        if not self._server.allows(self.get_query_argument("token", None)):
            self.close(WITHOUT_TOKEN, "the token is missing or wrong")
            return
        self._sending = asyncio.create_task(self._send())
        self._server.welcome(self)

    def on_message(self, message: str | bytes) -> None:
        """A page says whether it is seen, as one in the background needs no pictures, or that it has the report."""
        try:
            said = json.loads(message)
            if "has_report" in said:
                self.has_report = bool(said["has_report"])
            else:
                self.looks = bool(said["looks"])
        except (ValueError, TypeError, KeyError, RecursionError):
            self.close(1003, "expected what the page says of itself")
            return
        self._server.look()

    def on_close(self) -> None:
        """Forget the visitor, who no longer looks."""
        if self._sending is not None:
            self._sending.cancel()
            self._server.leave(self)

    def tell(self, told: dict[str, str]) -> None:
        """Put a change into the parcel that waits."""
        self._parcel |= told
        self._news.set()

    def show(self, jpeg: bytes) -> None:
        """Show a picture as soon as the one before has left; only the newest waits."""
        if self.looks:
            self._jpeg = jpeg
            self._news.set()

    async def bid_farewell(self) -> None:
        """Send what still waits, and close."""
        self._news.set()
        await asyncio.sleep(0)
        self.close(RUN_ENDED, "the run has ended")

    async def _send(self) -> None:
        try:
            while True:
                await self._news.wait()
                self._news.clear()
                parcel, self._parcel = self._parcel, {}
                jpeg, self._jpeg = self._jpeg, None
                if parcel:
                    kind, self._whole = "all" if self._whole else "some", False
                    await self.write_message(f'{{"{kind}": {as_object(parcel)}}}')
                if jpeg is not None:
                    await self.write_message(jpeg, binary=True)
        except WebSocketClosedError:
            pass  # on_close follows


class Picture(Asked):
    """A picture of the story, for those who may read it."""

    server: Server

    def get(self, key: str) -> None:
        """A picture, as JPEG."""
        self.admit()
        jpeg = self.server.told.pictures.get(key)
        if jpeg is None:
            raise HTTPError(404)
        self.set_header("Content-Type", "image/jpeg")
        self.write(jpeg)


class Report(Asked):
    """The page that the run leaves behind, for those who may read it."""

    server: Server

    def get(self) -> None:
        """The page, once it is written; it is not to be opened here, where its own scripts are not allowed."""
        self.admit()
        if self.server.report is None or not self.server.report.is_file():
            raise HTTPError(404)
        self.set_header("Content-Type", "text/plain; charset=utf-8")
        self.write(self.server.report.read_bytes())


class Action(Asked):
    """Visitors' requests, each a POST; the answer is `{"done": ..., "message": ...}`."""

    server: Server

    async def post(self, action: str, push: str | None = None) -> None:
        """Carry out a request, unless it comes from the page of another site or without the token."""
        self.admit(free=action == FREE_FOR_ALL)
        number = None if push is None else int(push)
        if number is not None and not 0 <= number < PUSH_IDS:
            raise HTTPError(400, f"a push has a number in [0, {PUSH_IDS})")
        try:
            answer = await self.server.ask(action, number)
        except TimeoutError:
            answer = Answer(False, f"nobody answered within {ANSWER_WITHIN:g} s")
        self.write(answer._asdict())


class Laying(Asked):
    """Where a visitor lays the simulated object: x and y in tenths of a millimetre, and its turn in tenths of a degree."""

    server: Server

    async def post(self, x: str, y: str, turn: str) -> None:
        """Lay it there."""
        self.admit()
        pose = Pose(1e-4 * int(x), 1e-4 * int(y), math.radians(0.1 * int(turn)))
        self.write((await self.server.ask("lay", pose=pose))._asdict())
