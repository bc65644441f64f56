"""The page of a run: everything is in it, and the files that it offers are those that other commands read."""

import asyncio
import base64
import functools
import http.client
import io
import json
import math
import operator
import pathlib
import re
import signal
import subprocess

import numpy as np
import pytest
from calls import PROGRAM, killed_at_the_end, printed
from PIL import Image
from tornado.websocket import websocket_connect

from pushfric_core.bags.bag import Bag
from pushfric_core.offline.estimation import Choices, estimate_from
from pushfric_core.page.report import in_one_file, report
from pushfric_core.page.story import Broadcast

BAG = pathlib.Path(__file__).parents[3] / "bags/rubber_rect4"


@pytest.fixture(scope="module")
def page(tmp_path_factory) -> tuple[pathlib.Path, str]:
    file = tmp_path_factory.mktemp("handed_on") / "result.html"
    printed("report", BAG, "--html", file)
    return file, file.read_text()


def told(text: str) -> dict:
    """The story in a page."""
    (story,) = re.findall(r'<script type="application/json" id="story">(.*?)</script>', text, re.DOTALL)
    return json.loads(story)


def test_the_page_needs_nothing_else(page):
    _, text = page
    outside = re.sub(r'(?:src|href)="data:|"src": ?"data:', "", text)
    assert not any(loaded in outside for loaded in ("<script src", 'src="', "@import", 'href="http', "import {", "export "))
    for said in ("rubber_rect4", "@media print", "minimum_speed"):
        assert said in text
    assert (page[0].parent / told(text)["data"]).resolve() == BAG.resolve()


def test_pictures_are_made_small_and_what_is_none_is_kept():
    picture, told_so_far = io.BytesIO(), Broadcast()
    noise = np.random.default_rng(1).integers(0, 255, (48, 64, 3), np.uint8)
    Image.fromarray(noise).save(picture, "JPEG", quality=95)
    for number, content in enumerate((picture.getvalue(), b"no picture")):
        told_so_far.take({f"picture/{number}": {"t": 0.0, "at": 0}}, content)
    story = told(in_one_file(told_so_far))
    small, kept = (base64.b64decode(story[f"src/picture/{number}"].partition(",")[2]) for number in range(2))
    assert len(small) < len(picture.getvalue()) / 2
    assert Image.open(io.BytesIO(small)).size == (64, 48)
    assert kept == b"no picture"


def test_the_last_pushes_are_predicted_from_those_before(page):
    _, text = page
    section = told(text)["tables"]["predictions"]
    assert "The last 4 pushes, predicted from the 10 before" in section["text"]
    numbers = [[float(number) for number in row] for row in section["rows"]]
    assert [row[0] for row in numbers] == [11, 12, 13, 14]
    assert all(median < 1.0 for _, _, median, _, _ in numbers)  # [degree], of a simulated object
    count, within = (sum(row[column] for row in numbers) for column in (1, 4))
    assert 0.8 * count <= within <= count


def test_a_repeated_push_has_the_number_that_the_list_of_pushes_gives_it(monkeypatch, tmp_path):
    read = Bag.deserialize

    def of_a_shorter_plan(bag, message):
        msg = read(bag, message)
        if message.topic == "/cell/plan_progress":
            msg.count = 12
            msg.placement.position.x = math.nan if msg.completed == 3 else 0.0
        return msg

    monkeypatch.setattr(Bag, "deserialize", of_a_shorter_plan)
    text = report(estimate_from(BAG, Choices(), print, whole_course=True), tmp_path / "report.html")
    assert [row[0] for row in told(text)["tables"]["predictions"]["rows"]] == ["11", "12", "1 (again)", "2 (again)"]
    assert "a message of plan_progress is left out: a pose must be finite" in told(text)["doubts"][-1]


def test_without_a_plan_a_push_has_its_id(page, tmp_path):
    file = tmp_path / "data.csv"
    file.write_text(told(page[1])["files"]["observations.csv"])
    text = report(estimate_from(file, Choices("rubber_rect4"), print, whole_course=True), tmp_path / "report.html")
    assert [row[0] for row in told(text)["tables"]["predictions"]["rows"]] == ["10", "11", "12", "13"]


def test_an_estimate_comes_with_the_first_observation_that_is_read():
    def stop(model, observation, estimate):
        raise StopIteration(model.name, observation.push_id, estimate.data_points)

    with pytest.raises(StopIteration) as stopped:
        estimate_from(BAG, Choices(), print, whole_course=True, on_estimate=stop)
    assert stopped.value.args == ("rubber_rect4", 0, 1)


def test_the_page_holds_every_moment_of_the_run(page):
    story = told(page[1])
    moments = [story[f"moment/{seen}"] for seen in range(72)]
    assert [moment["after"]["data_points"] for moment in moments] == list(range(1, 73))
    assert [moment["predicted"] is None for moment in moments] == [moment["push"] == 0 for moment in moments]
    assert moments[-1]["off"] < 1.0  # [degree], of a simulated object
    assert story["estimate"]["data_points"] == 72
    assert story["estimate"]["belief"]["verdict"]["use"]
    assert len(story["support/rubber_rect4"]) == len(moments[0]["after"]["w"])
    assert story["plan"]["phase"] == "finished"


def test_view_serves_the_page_on_this_machine_alone():
    """Without waiting for what takes long: pushes, then estimates, then what only the end tells."""

    async def shown(url: str) -> list[dict]:
        socket = await websocket_connect(f"{url.replace('http', 'ws')}live")
        parcels = []
        while not (parcels and parcels[-1].get("reported")):
            (parcel,) = json.loads(await asyncio.wait_for(socket.read_message(), 60)).values()
            parcels.append(parcel)
        return parcels

    with killed_at_the_end([*PROGRAM, "view", str(BAG), "--port", "0"], stderr=subprocess.PIPE, text=True) as view:
        url = next(line.split()[1] for line in view.stderr if line.startswith("view: "))

        def answer(host: str, page: str = "/", status: int = http.HTTPStatus.OK) -> str:
            asked = http.client.HTTPConnection(url.split("/")[2], timeout=60)
            asked.request("GET", page, headers={"Host": host} if host else {})
            answered = asked.getresponse()
            assert answered.status == status
            return answered.read().decode()

        assert "Waiting for the run" in answer("localhost")
        parcels = asyncio.run(shown(url))
        assert parcels[0]["recorded"]
        whole = told(answer("", "/report.html"))
        story = functools.reduce(operator.or_, parcels)
        assert story.pop("reading", None) is None
        assert {key: story.get(key) for key in whole if "picture" not in key} == {
            key: value for key, value in whole.items() if "picture" not in key
        }
        for page in ("/", "/report.html"):
            assert str(BAG) not in answer("elsewhere.example", page, http.HTTPStatus.FORBIDDEN)
        view.send_signal(signal.SIGINT)
        assert view.wait(60) == 130
