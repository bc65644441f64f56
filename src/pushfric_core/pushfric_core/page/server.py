"""Serves a page and what belongs to it, on this machine alone or to visitors who show a token; knows no ROS."""

import asyncio
import contextlib
import hmac
import logging
import pathlib
import threading
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple
from urllib.parse import urlsplit

from tornado.httpserver import HTTPServer
from tornado.netutil import bind_sockets
from tornado.web import Application, HTTPError, RequestHandler

from pushfric_core.cell.node_settings import VIEW_PORT, ViewConfig, is_loopback
from pushfric_core.errors import InvalidInput
from pushfric_core.page.story import RUN_PAGE
from pushfric_core.records import to_json

FOLDERS = (pathlib.Path(__file__).parent / "work", RUN_PAGE)
"""Folders of the pages' files."""

TYPES = {".html": "text/html", ".css": "text/css", ".js": "text/javascript", ".svg": "image/svg+xml"}

PING = 10.0
"""A visitor who has answered no ping for this long [s] counts as gone."""

LARGEST_REQUEST = 10_000
"""In bytes."""

FAREWELL = 10.0
"""How long visitors may take to receive the last answers [s]."""

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


class Request(NamedTuple):
    """Something that a page asks for."""

    what: str  # its address, such as work or exclude/3
    body: bytes
    answer: Callable[[Any], None]  # with a Reply, from any thread; only the first counts


Reply = tuple[str, bytes] | dict[str, Any]
"""A content's type and bytes, or what becomes JSON: `done`, whether it was done, `message`, and what the page shows."""


class PageServer:
    """Serves one page in a thread of its own, until `close`.

    Args:
        config: where to serve, and the token that a visitor must show.
        index: name of the file that is the page.
        on_request: called from the server's thread with each request.
        shown, done: the addresses of requests that change nothing (GET) and of others (POST), as regular expressions.
        routes: further addresses and their handlers, which get the argument `server`.
    Raises:
        InvalidInput: the server cannot listen there.
    """

    FREE_FOR_ALL = ""
    """The request that needs no token."""

    def __init__(
        self,
        config: ViewConfig,
        index: str,
        on_request: Callable[[Request], None],
        shown: str,
        done: str,
        routes: Sequence[tuple[str, type[RequestHandler]]] = (),
    ) -> None:
        self.index = index
        self._on_request = on_request
        self._routes = [*routes, (f"/({shown})", Shown), (f"/({done})", Done), (r"/([a-z.]*)", Page)]
        self.replying: set[asyncio.Future[None]] = set()
        self._local, self._host = config.is_local, config.host
        self._token = config.protected().token
        self._sockets = bound(config)
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

    def close(self) -> None:
        """Take leave of the visitors, and stop serving."""
        if self._thread.is_alive():
            asyncio.run_coroutine_threadsafe(self._end(), self._loop).result()
            self.call(self._loop.stop)
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
        try:
            name = urlsplit(f"//{host}").hostname or ""
        except ValueError:  # no address, as [::1
            return False
        return not self._local or name == self._host or is_loopback(name)

    def is_asked_from_here(self, host: str, origin: str | None) -> bool:
        """Whether a request to this host comes from a page of this server, or from no page."""
        try:
            return self.is_own(host) and (not origin or urlsplit(origin).netloc == host)
        except ValueError:  # the origin is no address
            return False

    async def reply(self, what: str, body: bytes) -> Reply:
        """Pass a request on, and wait for the answer."""
        answered: asyncio.Future[Reply] = self._loop.create_future()

        def settle(answer: Reply) -> None:
            if not answered.done():
                answered.set_result(answer)

        self._on_request(Request(what, body, lambda answer: self.call(settle, answer)))
        return await answered

    def call(self, function: Callable[..., object], *arguments: object) -> None:
        """Call a function in the server's thread; from any thread."""
        if not self._loop.is_closed():
            self._loop.call_soon_threadsafe(function, *arguments)

    async def bid_farewell(self) -> None:
        """Let the last answers arrive."""
        if self.replying:
            await asyncio.wait(self.replying, timeout=1.0)

    def _serve(self) -> None:
        asyncio.set_event_loop(self._loop)
        application = Application(
            [(address, handler, {"server": self}) for address, handler in self._routes],
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
        with contextlib.suppress(TimeoutError):
            await asyncio.wait_for(self.bid_farewell(), FAREWELL)
        self._http.stop()


class _Served(RequestHandler):
    """The common part of every answer of the server."""

    def initialize(self, server: PageServer) -> None:
        self.server = server

    def set_default_headers(self) -> None:
        """Allow nothing from other sites, and no use inside other pages."""
        for name, value in HEADERS.items():
            self.set_header(name, value)


class Page(_Served):
    """The files of the page, served without a token: they hold nothing secret, and a stop button must always appear."""

    def get(self, name: str) -> None:
        """A file of a page."""
        if not self.server.is_own(self.request.host):
            raise HTTPError(403)
        name = name or self.server.index
        path = next((folder / name for folder in FOLDERS if (folder / name).is_file()), None)
        if path is None or path.suffix not in TYPES or path.parent not in FOLDERS:
            raise HTTPError(404)
        self.set_header("Content-Type", f"{TYPES[path.suffix]}; charset=utf-8")
        self.write(path.read_bytes())

    head = get


class _Asked(_Served):
    """Something that a visitor asks for; an error is answered as `{"done": false, "message": ...}`."""

    async def answer(self, what: str) -> None:
        """Answer, unless the page of another site asks, or somebody without the token for what needs it."""
        if not self.server.is_asked_from_here(self.request.host, self.request.headers.get("Origin")):
            raise HTTPError(403, "asked by the page of another site")
        shown = self.request.headers.get("Authorization", "").removeprefix("Bearer ") or self.get_query_argument("token", "")
        if what != self.server.FREE_FOR_ALL and not self.server.allows(shown):
            raise HTTPError(401, "the token is missing or wrong")
        over = asyncio.get_running_loop().create_future()
        self.server.replying.add(over)
        try:
            reply = await self.server.reply(what, self.request.body)
            kind, content = reply if isinstance(reply, tuple) else ("application/json", to_json(reply).encode())
            self.set_header("Content-Type", kind)
            await self.finish(content)
        finally:
            self.server.replying.discard(over)
            over.set_result(None)

    def write_error(self, status_code: int, **kwargs: Any) -> None:
        """Write the reason, in the form of an answer."""
        error = kwargs.get("exc_info", (None, None))[1]
        why = getattr(error, "log_message", None) or self._reason
        self.finish({"done": False, "message": why})


class Shown(_Asked):
    """A request that changes nothing."""

    get = head = _Asked.answer


class Done(_Asked):
    """A request to change something."""

    post = _Asked.answer


def bound(config: ViewConfig) -> list[Any]:
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
        raise InvalidInput(f"the page cannot be served at {where}: {why}; choose another port") from error
