"""Points of the table that are clicked in a picture: what they give, and the server that takes them; without a browser."""

import asyncio
import json
import pathlib

import numpy as np
import pytest
from tornado.httpclient import AsyncHTTPClient

from pushfric_core.cell.node_settings import ViewConfig
from pushfric_core.page.clicked_points import ClickedPoints
from pushfric_core.page.server import PageServer
from pushfric_core.page.work_page import ADDRESSES, PNG
from pushfric_core.records import to_json
from pushfric_core.vision.camera import Camera, Lens

CAMERA = Camera.looking_down(640, 480, (0.2, 0.15), 1e-3, distortion=(-0.2, 0.08, 0.001, -0.0005, 0.0))
LENS = Lens(CAMERA.width, CAMERA.height, CAMERA.K, CAMERA.D)
PLACES = np.array(((0.0, 0.0), (0.4, 0.0), (0.4, 0.3), (0.0, 0.3), (0.2, 0.15)))
TARGET = pathlib.Path("camera.yaml")
TOKEN = "a-secret-word"


def clicked(places, pixels=None, untold=()):
    """The points' JSON; the places of `untold` are not typed yet."""
    pixels = CAMERA.project(places) if pixels is None else pixels
    rows = [[*pixel, *place] for pixel, place in zip(pixels.tolist(), np.asarray(places).tolist(), strict=True)]
    for index in untold:
        rows[index][2] = None
    return json.dumps(rows).encode()


def test_points_give_the_table_through_the_distorted_lens():
    points = ClickedPoints(LENS, TARGET, [])
    points.take(clicked(PLACES))
    assert points.problem == ""
    np.testing.assert_allclose(points.found.camera.unproject(CAMERA.project(PLACES)), PLACES, atol=1e-6)
    fit = json.loads(to_json(points.figures()))["fit"]
    assert len(fit["errors"]) == len(PLACES)
    assert max(fit["errors"]) < 1e-6
    assert fit["step"] == 0.1
    assert len(fit["lines"]) == 5 + 4
    np.testing.assert_allclose(fit["axes"], CAMERA.project([(0, 0), (0.1, 0), (0, 0.1)]), atol=1e-2)


@pytest.mark.parametrize(
    ("body", "problem"),
    [
        (b"[]", "at least 4 points"),
        (clicked(PLACES[:3]), "1 point more, spread over the picture"),
        (clicked(PLACES, untold=[1]), "where is point 2? Type its x and y"),
        (clicked(PLACES[[0, 1, 2, 0]]), "too few different points: expected at least 4, got 3"),
        (clicked(np.outer(np.arange(5), (0.08, 0.06))), "the points lie on a line or in one place"),
        (clicked(PLACES, np.outer(np.arange(1, 6), (90.0, 70.0))), "the points lie on a line or in one place"),
        (clicked(0.04 * PLACES), "the points are badly spread: an error of 1 px in them grows to"),
        (clicked(PLACES * (1, -1), CAMERA.project(PLACES)), "the table homography is mirrored"),
        (clicked([*PLACES, (0.25, 0.15)], CAMERA.project([*PLACES, (0.2, 0.05)])), "the worst is number 6"),
    ],
)
def test_points_that_give_no_table_are_refused_in_one_line(body, problem):
    points = ClickedPoints(LENS, TARGET, [])
    points.take(clicked(PLACES))
    points.take(body)
    assert points.found is None
    assert problem in points.problem
    assert "\n" not in points.problem
    assert points.figures()["fit"] is None


@pytest.fixture
def asked():
    return []


@pytest.fixture
def server(asked):
    def answer(question):
        asked.append((question.what, question.body))
        question.answer(("image/png", b"\x89PNG") if question.what == PNG else {"done": True, "largest": np.float64(0.5)})

    # the address 0.0.0.0 needs the token, as if other machines asked
    server = PageServer(ViewConfig(host="0.0.0.0", port=0, token=TOKEN), "points.html", answer, *ADDRESSES)
    yield server
    server.close()


def fetched(server, what, **kwargs):
    url = server.url.replace("0.0.0.0", "127.0.0.1").partition("?")[0]
    return asyncio.run(_fetch(f"{url}{what}", **kwargs))


async def _fetch(url, **kwargs):
    return await AsyncHTTPClient().fetch(url, raise_error=False, **kwargs)


def test_the_page_asks_with_the_token(server, asked):
    shown = {"Authorization": f"Bearer {TOKEN}"}
    assert b"points.js" in fetched(server, "").body
    picture = fetched(server, PNG, headers=shown)
    assert (picture.headers["Content-Type"], picture.body) == ("image/png", b"\x89PNG")
    told = fetched(server, "work", method="POST", body=b"[]", headers=shown)
    assert json.loads(told.body) == {"done": True, "largest": 0.5}
    assert asked == [(PNG, b""), ("work", b"[]")]


@pytest.mark.parametrize(("what", "method"), [("state", "GET"), (PNG, "GET"), ("work", "POST"), ("save", "POST")])
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
    server = PageServer(ViewConfig(port=0), "points.html", asked.append, *ADDRESSES)
    try:
        assert fetched(server, "state", headers={"Host": "evil.example"}).code == 403
        for name in ("[::1", "::1]:80", "[]"):  # of no address
            assert fetched(server, "state", headers={"Host": name}).code == 403
        assert fetched(server, "state", headers={"Origin": "http://[::1"}).code == 403
        assert fetched(server, "", headers={"Host": "evil.example"}).code == 403
        assert fetched(server, "save").code == 405  # a picture on another site must not save
    finally:
        server.close()
    assert asked == []
    assert "Uncaught" not in caplog.text
