"""Serves the page of the live view, its story and its pictures, and takes the requests of visitors; knows no ROS.

The server works in a thread of its own. A slow visitor gets fewer, later changes, and delays nobody: each visitor has one
parcel of changes on the way and one that waits, in which later values of a key replace earlier ones.
"""

import asyncio
import hmac
import json
import logging
import pathlib
import threading
from collections.abc import Awaitable, Callable
from typing import Any, NamedTuple
from urllib.parse import urlsplit

from tornado.httpserver import HTTPServer
from tornado.netutil import bind_sockets
from tornado.web import Application, HTTPError, RequestHandler
from tornado.websocket import WebSocketClosedError, WebSocketHandler

from pushfric_core.errors import InvalidInput
from pushfric_ros.files.node_settings import VIEW_PORT, ViewConfig, is_loopback
from pushfric_ros.report.report import to_json
from pushfric_ros.view.story import Change

PAGE = pathlib.Path(__file__).parent / "page"
TYPES = {".html": "text/html", ".css": "text/css", ".js": "text/javascript", ".svg": "image/svg+xml"}

ACTIONS = ("stop", "reset", "next", "exclude", "keep")
"""What a visitor may ask for."""

FREE_FOR_ALL = "stop"
"""The action that needs no token."""

ANSWER_WITHIN = 15.0
"""If nobody answers within this time [s], the visitor is told so."""

PING = 10.0
"""A visitor who has answered no ping for this long [s] counts as gone."""

LARGEST_REQUEST = 10_000
"""In bytes."""

WITHOUT_TOKEN, RUN_ENDED = 4001, 1001
"""WebSocket status codes that say why a visitor's connection is closed."""

POLICY = (
    "default-src 'self'; img-src 'self' blob:; frame-ancestors 'none'; base-uri 'none'; "
    "script-src 'self' 'unsafe-eval'"  # scripts that drive a browser wait for conditions in this way
)
HEADERS = {
    "Cache-Control": "no-store",
    "Content-Security-Policy": POLICY,
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
}


class Answer(NamedTuple):
    """The answer to a visitor's request."""

    done: bool
    message: str


class Request(NamedTuple):
    """Something that a visitor asks for."""

    action: str  # one of ACTIONS
    push: int | None  # to exclude or keep
    answer: Callable[[Answer], None]  # from any thread; only the first answer counts


class Server:
    """The server of one run, which serves until `close`.

    Args:
        config: where to serve, and the token that a visitor must show.
        on_request: called from the server's thread with each request.
        on_looking: called from the server's thread with whether anybody looks, whenever that changes.
    Raises:
        InvalidInput: the server cannot listen there.
    """

    def __init__(self, config: ViewConfig, on_request: Callable[[Request], None], on_looking: Callable[[bool], None]) -> None:
        self._on_request, self._on_looking = on_request, on_looking
        self._story: Change = {}
        self._visitors: set[Visitor] = set()
        self._looking = False
        self._local, self._host = config.is_local, config.host
        self._token = config.protected().token
        self._sockets = _bound(config)
        self._port = self._sockets[0].getsockname()[1]
        # otherwise the library would report each malformed request of a port scanner to the operator
        for name in ("tornado.access", "tornado.general"):
            logging.getLogger(name).setLevel(logging.CRITICAL)
        self._loop = asyncio.new_event_loop()
        self._http: HTTPServer | None = None
        self._thread = threading.Thread(target=self._serve, name="view", daemon=True)
        self._thread.start()

    @property
    def url(self) -> str:
        """The address of the page, with the token if it needs one."""
        host = f"[{self._host}]" if ":" in self._host else self._host
        return f"http://{host}:{self._port}/" + (f"?token={self._token}" if self._token else "")

    def show(self, change: Change) -> None:
        """Send a change of the story to the visitors; from any thread."""
        self._call(self._show, change)

    def picture(self, jpeg: bytes) -> None:
        """Show the newest picture to those who look; from any thread."""
        self._call(self._picture, jpeg)

    def close(self) -> None:
        """Tell the visitors that the run has ended, and stop serving."""
        if self._thread.is_alive():
            asyncio.run_coroutine_threadsafe(self._end(), self._loop).result(2.0)
            self._call(self._loop.stop)
            self._thread.join()
        self._loop.close()

    def allows(self, token: str | None) -> bool:
        """Whether this is the right token, or none is needed."""
        return not self._token or hmac.compare_digest((token or "").encode(), self._token.encode())

    def is_own(self, host: str) -> bool:
        """Whether the name in a request's Host header is this server's.

        On the loopback, another site's name that leads here is refused: the site's page could otherwise read and steer the cell
        through the browser of its visitor. On other addresses, the token protects the server.
        """
        name = urlsplit(f"//{host}").hostname or ""
        return not self._local or name == self._host or is_loopback(name)

    def welcome(self, visitor: "Visitor") -> None:
        """Send everything so far to a new visitor."""
        self._visitors.add(visitor)
        visitor.tell(self._story)
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

    def ask(self, action: str, push: int | None) -> Awaitable[Answer]:
        """Pass a request on; the answer comes later."""
        answered: asyncio.Future[Answer] = self._loop.create_future()

        def settle(answer: Answer) -> None:
            if not answered.done():
                answered.set_result(answer)

        self._on_request(Request(action, push, lambda answer: self._call(settle, answer)))
        return asyncio.wait_for(answered, ANSWER_WITHIN)

    def _call(self, function: Callable[..., object], *arguments: object) -> None:
        if not self._loop.is_closed():
            self._loop.call_soon_threadsafe(function, *arguments)

    def _serve(self) -> None:
        asyncio.set_event_loop(self._loop)
        for_all = {"server": self}
        application = Application(
            [
                (r"/live", Visitor, for_all),
                (r"/(stop|reset|next)", Action, for_all),
                (r"/(exclude|keep)/(-?\d{1,10})", Action, for_all),
                (r"/([a-z.]*)", Page, for_all),
            ],
            log_function=lambda _: None,
            websocket_ping_interval=PING,
            websocket_ping_timeout=PING,
            websocket_max_message_size=LARGEST_REQUEST,
        )
        self._http = HTTPServer(application, max_body_size=LARGEST_REQUEST, max_header_size=LARGEST_REQUEST)
        self._http.add_sockets(self._sockets)
        self._loop.run_forever()

    async def _end(self) -> None:
        assert self._http is not None
        self._http.stop()
        await asyncio.gather(*(visitor.bid_farewell() for visitor in list(self._visitors)), return_exceptions=True)

    def _show(self, change: Change) -> None:
        self._story |= change
        for key in [key for key, value in change.items() if value is None and key != "estimate"]:
            del self._story[key]
        for visitor in self._visitors:
            visitor.tell(change)

    def _picture(self, jpeg: bytes) -> None:
        for visitor in self._visitors:
            visitor.show(jpeg)


class Visitor(WebSocketHandler):
    """One open page. It gets `{"all": story}` first, then `{"some": change}`, and JPEG pictures as binary messages."""

    def initialize(self, server: Server) -> None:
        self._server = server
        self.looks = True
        self._whole = True  # the first parcel is the whole story
        self._parcel: Change = {}
        self._jpeg: bytes | None = None
        self._news = asyncio.Event()
        self._sending: asyncio.Task[None] | None = None

    def check_origin(self, origin: str) -> bool:
        """Accept only pages of this server: those of other sites must not read the story."""
        return super().check_origin(origin) and self._server.is_own(self.request.host)

    def open(self, *_: str, **__: str) -> None:
        """Refuse a visitor without the right token; the page then says so."""
        if not self._server.allows(self.get_query_argument("token", None)):
            self.close(WITHOUT_TOKEN, "the token is missing or wrong")
            return
        self._sending = asyncio.create_task(self._send())
        self._server.welcome(self)

    def on_message(self, message: str | bytes) -> None:
        """A page says whether it is seen: one in the background needs no pictures."""
        try:
            self.looks = bool(json.loads(message)["looks"])
        except (ValueError, TypeError, KeyError, RecursionError):
            self.close(1003, "expected whether the page is looked at")
            return
        self._server.look()

    def on_close(self) -> None:
        """Forget the visitor, who no longer looks."""
        if self._sending is not None:
            self._sending.cancel()
            self._server.leave(self)

    def tell(self, change: Change) -> None:
        """Put a change into the parcel that waits."""
        self._parcel |= change
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
                    await self.write_message(to_json({kind: parcel}))
                if jpeg is not None:
                    await self.write_message(jpeg, binary=True)
        except WebSocketClosedError:
            pass  # on_close follows


class Action(RequestHandler):
    """Visitors' requests, each a POST; the answer is `{"done": ..., "message": ...}`."""

    def initialize(self, server: Server) -> None:
        self._server = server

    async def post(self, action: str, push: str | None = None) -> None:
        """Carry out a request, unless it comes from the page of another site or without the token."""
        origin = self.request.headers.get("Origin")
        if not self._server.is_own(self.request.host) or (origin and urlsplit(origin).netloc != self.request.host):
            raise HTTPError(403, "asked by the page of another site")
        shown = self.request.headers.get("Authorization", "").removeprefix("Bearer ")
        shown = shown or self.get_query_argument("token", "")
        if action != FREE_FOR_ALL and not self._server.allows(shown):
            raise HTTPError(401, "the token is missing or wrong")
        try:
            answer = await self._server.ask(action, None if push is None else int(push))
        except TimeoutError:
            answer = Answer(False, f"nobody answered within {ANSWER_WITHIN:g} s")
        self.write(answer._asdict())

    def write_error(self, status_code: int, **kwargs: Any) -> None:
        """Write the reason, in the form of an answer."""
        error = kwargs.get("exc_info", (None, None))[1]
        why = getattr(error, "log_message", None) or self._reason
        self.finish(Answer(False, why)._asdict())

    def set_default_headers(self) -> None:
        """Set the headers of the page."""
        for name, value in HEADERS.items():
            self.set_header(name, value)


class Page(RequestHandler):
    """The files of the page, served without a token: they hold nothing secret, and the stop button must always appear."""

    def initialize(self, server: Server) -> None:
        self._server = server

    def set_default_headers(self) -> None:
        """Allow nothing from other sites, and no use inside other pages."""
        for name, value in HEADERS.items():
            self.set_header(name, value)

    def get(self, name: str) -> None:
        """One of the files in `page`."""
        if not self._server.is_own(self.request.host):
            raise HTTPError(403)
        path = PAGE / (name or "index.html")
        if path.suffix not in TYPES or path.parent != PAGE or not path.is_file():
            raise HTTPError(404)
        self.set_header("Content-Type", f"{TYPES[path.suffix]}; charset=utf-8")
        self.write(path.read_bytes())


def _bound(config: ViewConfig) -> list[Any]:
    """Sockets that listen where the config says; at a free port if the config names none and the usual one is taken."""
    try:
        if config.port:
            return bind_sockets(config.port, config.host)
        try:
            return bind_sockets(VIEW_PORT, config.host)
        except OSError:
            return bind_sockets(0, config.host)
    except (OSError, UnicodeError) as error:
        where = f"{config.host}:{config.port or VIEW_PORT}"
        why = getattr(error, "strerror", None) or str(error)
        raise InvalidInput(f"the view cannot be served at {where}: {why}; choose another with --view HOST:PORT") from error
