"""Serves the page of a run, live or over, its story and its pictures, and takes the requests of visitors; knows no ROS.

A slow visitor gets fewer, later changes, and delays nobody: each visitor has one parcel of changes on the way and one that
waits, in which later values of a key replace earlier ones.
"""

import asyncio
import json
import pathlib
import time
from collections.abc import Callable

from tornado.web import HTTPError
from tornado.websocket import WebSocketClosedError, WebSocketHandler

from pushfric_core.cell.node_settings import REPORT_FILE, SWITCHES, ViewConfig
from pushfric_core.page.server import PageServer, Reply, Request
from pushfric_core.page.story import PASSING, Broadcast, Change, as_object
from pushfric_core.records import to_json
from pushfric_core.trajectories.observation import PUSH_IDS

SERVICES = {
    "stop": "actuator/stop",
    "reset": "actuator/reset",
    "repeat": "experiment/repeat",
    "skip": "experiment/skip",
    "end": "experiment/end",
}
"""The requests of a visitor, besides those to turn one of SWITCHES over, and the services that carry them out."""

PUSH_SERVICES = {"exclude": "estimator/exclude_push", "keep": "estimator/keep_push"}
"""The same for requests that name a push."""

ANSWER_WITHIN = 15.0
"""If nobody answers within this time [s], the visitor is told so."""

WITHOUT_TOKEN, RUN_ENDED = 4001, 1001
"""WebSocket status codes that say why a visitor's connection is closed."""


class Server(PageServer):
    """The server of one run.

    Args:
        config: where to serve, and the token that a visitor must show.
        on_request: called from the server's thread with each request: one of SERVICES or SWITCHES; one of PUSH_SERVICES, as
            exclude/PUSH; or lay/X/Y/TURN, where to lay the simulated object, in tenths of a millimetre and of a degree.
        on_looking: called from the server's thread with whether anybody looks, whenever that changes.
        report: file of the page that the run leaves behind; it need not exist before the end. None: there will be none.
    Raises:
        InvalidInput: the server cannot listen there.
    """

    FREE_FOR_ALL = "stop"

    def __init__(
        self,
        config: ViewConfig,
        on_request: Callable[[Request], None],
        on_looking: Callable[[bool], None],
        report: pathlib.Path | None = None,
    ) -> None:
        self._on_looking, self.report = on_looking, report
        self.broadcast = Broadcast()
        self._came: dict[str, float] = {}  # when what passes did
        self._visitors: set[Visitor] = set()
        self._looking = False
        shown = rf"picture/\d{{1,9}}|{REPORT_FILE}"
        done = rf"{'|'.join((*SERVICES, *SWITCHES))}|(?:{'|'.join(PUSH_SERVICES)})/-?\d{{1,10}}|lay(?:/-?\d{{1,5}}){{3}}"
        super().__init__(config, "index.html", on_request, shown, done, [("/live", Visitor)])

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
        visitor.tell(self.broadcast.values | ({"ages": to_json(ages)} if ages else {}))
        self.count_watchers()

    def leave(self, visitor: "Visitor") -> None:
        """Forget a visitor."""
        self._visitors.discard(visitor)
        self.count_watchers()

    def count_watchers(self) -> None:
        """Find out whether anybody looks."""
        looking = any(visitor.looks for visitor in self._visitors)
        if looking != self._looking:
            self._looking = looking
            self._on_looking(looking)

    async def reply(self, what: str, body: bytes) -> Reply:
        """A picture of the story; or the report, which is not to be opened here, where its own scripts are not allowed; or what
        becomes of a request."""
        kind, _, number = what.partition("/")
        if kind == "picture" and what in self.broadcast.pictures:
            return "image/jpeg", self.broadcast.pictures[what]
        if what == REPORT_FILE and self.report is not None and self.report.is_file():
            return "text/plain; charset=utf-8", self.report.read_bytes()
        if kind in ("picture", REPORT_FILE):
            raise HTTPError(404)
        if kind in PUSH_SERVICES and not 0 <= int(number) < PUSH_IDS:
            raise HTTPError(400, f"a push has a number in [0, {PUSH_IDS})")
        try:
            return await asyncio.wait_for(super().reply(what, body), ANSWER_WITHIN)
        except TimeoutError:
            return {"done": False, "message": f"nobody answered within {ANSWER_WITHIN:g} s"}

    async def bid_farewell(self) -> None:
        """Tell the visitors that the run has ended, once they have its report."""
        if self.report is not None and self.report.is_file():
            self._show({"reported": True}, b"")
            while any(not visitor.has_report for visitor in self._visitors):
                await asyncio.sleep(0.02)
        await asyncio.gather(*(visitor.bid_farewell() for visitor in list(self._visitors)), return_exceptions=True)

    def _show(self, change: Change, jpeg: bytes) -> None:
        told = self.broadcast.take(change, jpeg)  # once, not for each visitor: a story may be long
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
        self._server.count_watchers()

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
