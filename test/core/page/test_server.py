"""The server of a page: who may ask it; without a browser."""

import asyncio
import contextlib
import json

import numpy as np
import pytest
from tornado.httpclient import AsyncHTTPClient

from pushfric_core.cell.node_settings import ViewConfig
from pushfric_core.page.drawn_object import ADDRESSES, PICTURE
from pushfric_core.page.server import PageServer

TOKEN = "a-secret-word"


@pytest.fixture
def asked():
    return []


@pytest.fixture
def server(asked):
    def answer(question):
        asked.append((question.what, question.body))
        question.answer(("image/png", b"\x89PNG") if question.what == PICTURE else {"done": True, "largest": np.float64(0.5)})

    # the address 0.0.0.0 needs the token, as if other machines asked
    server = PageServer(ViewConfig(host="0.0.0.0", port=0, token=TOKEN), "drawing.html", answer, *ADDRESSES)
    yield server
    server.close()


def fetched(server, what, **kwargs):
    url = server.url.replace("0.0.0.0", "127.0.0.1").partition("?")[0]
    return asyncio.run(_fetch(f"{url}{what}", **kwargs))


async def _fetch(url, **kwargs):
    return await AsyncHTTPClient().fetch(url, raise_error=False, **kwargs)


def test_the_page_asks_with_the_token(server, asked):
    shown = {"Authorization": f"Bearer {TOKEN}"}
    assert b"drawing.js" in fetched(server, "").body
    heads = [fetched(server, what, method="HEAD", headers=shown) for what in ("", "state")]
    assert [(head.code, head.body, int(head.headers["Content-Length"]) > 0) for head in heads] == [(200, b"", True)] * 2
    asked.clear()
    picture = fetched(server, PICTURE, headers=shown)
    assert (picture.headers["Content-Type"], picture.body) == ("image/png", b"\x89PNG")
    told = fetched(server, "work", method="POST", body=b"[]", headers=shown)
    assert json.loads(told.body) == {"done": True, "largest": 0.5}
    assert asked == [(PICTURE, b""), ("work", b"[]")]


@pytest.mark.parametrize(("what", "method"), [("state", "GET"), (PICTURE, "GET"), ("work", "POST"), ("save", "POST")])
@pytest.mark.parametrize(
    ("headers", "code"),
    [({}, 401), ({"Authorization": "Bearer x"}, 401), ({"Authorization": f"Bearer {TOKEN}", "Origin": "http://evil"}, 403)],
)
def test_strangers_are_refused(server, asked, what, method, headers, code):
    answer = fetched(server, what, method=method, body=b"[]" if method == "POST" else None, headers=headers)
    assert answer.code == code
    assert json.loads(answer.body)["done"] is False
    assert asked == []


def test_another_sites_name_for_this_machine_is_refused(asked, caplog):
    with contextlib.closing(PageServer(ViewConfig(port=0), "drawing.html", asked.append, *ADDRESSES)) as server:
        assert fetched(server, "state", headers={"Host": "evil.example"}).code == 403
        for name in ("[::1", "::1]:80", "[]"):  # of no address
            assert fetched(server, "state", headers={"Host": name}).code == 403
        assert fetched(server, "state", headers={"Origin": "http://[::1"}).code == 403
        assert fetched(server, "", headers={"Host": "evil.example"}).code == 403
        assert fetched(server, "save").code == 405  # a picture on another site must not save
    assert asked == []
    assert "Uncaught" not in caplog.text
