"""The server of the live view with visitors who are slow, gone or strange; without ROS."""

import asyncio
import json
import types

import pytest
from tornado.httpclient import AsyncHTTPClient, HTTPClientError, HTTPRequest
from tornado.websocket import websocket_connect

from pushfric_core.cell.node_settings import ViewConfig
from pushfric_core.page import run_server
from pushfric_core.page.run_server import Server

PATIENCE = 60.0


@pytest.fixture
def told():
    """Keeps what the server tells its node."""
    return types.SimpleNamespace(looking=[], requests=[])


@pytest.fixture
def server(told):
    server = Server(ViewConfig(port=0), told.requests.append, told.looking.append)
    yield server
    server.close()


def live(server):
    return server.url.replace("http", "ws", 1) + "live"


async def read(socket):
    return await asyncio.wait_for(socket.read_message(), PATIENCE)


async def until(condition):
    async with asyncio.timeout(PATIENCE):
        while not condition():
            await asyncio.sleep(0.01)


def test_a_slow_visitor_gets_the_newest_of_each_and_not_all(server):
    count, picture = 300, bytes(1_000_000)

    async def visit():
        socket = await websocket_connect(live(server), max_message_size=10_000_000)
        assert json.loads(await read(socket)) == {"all": {"step": -1}}
        for step in range(count):
            server.picture(step.to_bytes(2, "big") + picture)
            server.show({"step": step})
        server.show({"last": True})
        steps, pictures, last = [], [], False
        while not (last and pictures and pictures[-1] == count - 1):
            message = await read(socket)
            if isinstance(message, bytes):
                pictures.append(int.from_bytes(message[:2], "big"))
            else:
                change = json.loads(message)["some"]
                steps += [change["step"]] if "step" in change else []
                last |= "last" in change
        assert steps[-1] == count - 1
        assert steps == sorted(steps)
        assert len(pictures) < count / 2
        socket.close()

    server.show({"step": -1})
    asyncio.run(visit())


@pytest.mark.parametrize("push", [-1, 2**31, 9_999_999_999])
def test_a_number_that_no_push_has_is_refused(server, told, push):
    async def visit():
        return await AsyncHTTPClient().fetch(f"{server.url}exclude/{push}", method="POST", body="", raise_error=False)

    answer = asyncio.run(visit())
    assert answer.code == 400
    assert "a push has a number in [0, 2147483648)" in json.loads(answer.body)["message"]
    assert told.requests == []


@pytest.mark.parametrize(
    "headers",
    [
        {"Origin": "http://[::1"},
        {"Origin": "http://evil.example"},
        {"Origin": "http://evil.example", "Host": "evil.example"},
        {"Origin": "http://evil.example", "Host": "evil.example", "Sec-Fetch-Site": "same-origin"},
        {"Host": "::1]:80"},
    ],
)
def test_the_page_of_another_site_is_shown_out(server, caplog, headers):
    async def visit():
        with pytest.raises(HTTPClientError, match="403"):
            await websocket_connect(HTTPRequest(live(server), headers=headers))

    asyncio.run(visit())
    assert "Uncaught" not in caplog.text


@pytest.mark.parametrize("said", ["", "[]", "{}", "looks", '"looks"', "[" * 5000, b"\xff", "x" * 20_000])
def test_a_visitor_who_says_something_else_is_shown_out(server, told, said):
    async def visit():
        server.show({"cell": "/cell"})
        socket = await websocket_connect(live(server))
        await read(socket)
        await socket.write_message(said, binary=isinstance(said, bytes))
        while await read(socket) is not None:
            pass
        await until(lambda: told.looking == [True, False])

    asyncio.run(visit())


def test_a_visitor_who_is_cut_off_no_longer_counts(server, told):
    async def visit():
        socket = await websocket_connect(live(server))
        await until(lambda: told.looking == [True])
        socket.protocol.stream.close()  # without closing the WebSocket
        await until(lambda: told.looking == [True, False])

    asyncio.run(visit())


def test_who_asks_is_told_when_nobody_answers(server, told, monkeypatch):
    monkeypatch.setattr(run_server, "ANSWER_WITHIN", 0.05)

    async def visit():
        answer = await AsyncHTTPClient().fetch(f"{server.url}stop", method="POST", body=b"")
        assert json.loads(answer.body) == {"done": False, "message": "nobody answered within 0.05 s"}

    asyncio.run(visit())
    (request,) = told.requests
    assert request.what == "stop"


def test_requests_that_are_none_are_refused(server, told):
    async def visit():
        for what, method in (
            ("", "POST"),
            ("exclude/x", "POST"),
            ("exclude/12345678901", "POST"),
            ("stop", "GET"),
            ("jog", "POST"),
        ):
            body = b"" if method == "POST" else None
            answer = await AsyncHTTPClient().fetch(f"{server.url}{what}", method=method, body=body, raise_error=False)
            assert answer.code in (404, 405), what
        large = await AsyncHTTPClient().fetch(f"{server.url}stop", method="POST", body=bytes(100_000), raise_error=False)
        assert large.code in (400, 413, 599)

    asyncio.run(visit())
    assert told.requests == []


def test_the_server_ends_when_its_visitors_have_the_report(told, tmp_path):
    report = tmp_path / "report.html"
    server = Server(ViewConfig(port=0), told.requests.append, told.looking.append, report)

    async def visit():
        socket = await websocket_connect(live(server))
        assert json.loads(await read(socket)) == {"all": {"step": 1}}
        with pytest.raises(HTTPClientError, match="404"):
            await AsyncHTTPClient().fetch(f"{server.url}report.html")
        report.write_text("<p>the result</p>")
        ended = asyncio.get_running_loop().run_in_executor(None, server.close)
        assert json.loads(await read(socket)) == {"some": {"reported": True}}
        answer = await AsyncHTTPClient().fetch(f"{server.url}report.html")
        assert (answer.headers["Content-Type"], answer.body) == ("text/plain; charset=utf-8", b"<p>the result</p>")
        assert not ended.done()
        await socket.write_message(json.dumps({"has_report": True}))
        assert await read(socket) is None
        assert socket.close_code == run_server.RUN_ENDED
        await ended

    server.show({"step": 1})
    asyncio.run(visit())
