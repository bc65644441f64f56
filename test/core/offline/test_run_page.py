"""The page of a run: everything is in it, and the files that it offers are those that other commands read."""

import base64
import pathlib
import re

import pytest
from typer.testing import CliRunner

from pushfric_core.commands.cli import app
from pushfric_core.files.model_file import load_model
from pushfric_core.files.object_file import load_object
from pushfric_core.files.observation_file import read_observations

BAG = pathlib.Path(__file__).parents[3] / "bags/rubber_rect4"


@pytest.fixture(scope="module")
def page(tmp_path_factory) -> tuple[pathlib.Path, str]:
    file = tmp_path_factory.mktemp("handed_on") / "result.html"
    ended = CliRunner().invoke(app, ["report", str(BAG), "--html", str(file)])
    assert ended.exit_code == 0, ended.output
    return file, file.read_text()


def test_the_page_needs_nothing_else(page):
    _, text = page
    assert not any(outside in text for outside in ("<script", "<link", "src=", "@import", 'href="http'))
    for said in ("rubber_rect4", "The estimate may be used", "72 data points of 14 pushes", "@media print", "minimum_speed"):
        assert said in text
    assert text.count("<svg ") == 1
    (bag,) = re.findall(r'href="([^":]*)">recorded data', text)
    assert (page[0].parent / bag).resolve() == BAG.resolve()


def test_the_last_pushes_are_predicted_from_those_before(page):
    _, text = page
    section = text[text.index('id="predictions"') : text.index('id="pushes"')]
    assert "The last 4 pushes, predicted from the 10 before" in section
    rows = re.findall(r"<tr>(.*?)</tr>", section, re.DOTALL)[1:]
    numbers = [[float(number) for number in re.findall(r'<span class="">([0-9.]+)', row)] for row in rows]
    assert [row[0] for row in numbers] == [11, 12, 13, 14]
    assert all(median <= largest < 1.0 for _, _, median, largest in numbers)  # [degree], of a simulated object


def test_the_downloads_are_read_by_the_commands(page, tmp_path):
    _, text = page
    for name, content in re.findall(r'download="([^"]*)" href="data:[^;]*;base64,([^"]*)"', text):
        (tmp_path / name).write_bytes(base64.b64decode(content))
    model = load_object("rubber_rect4")
    assert len(read_observations(tmp_path / "observations.csv", model.outline)) == 72
    assert load_model(tmp_path / "model.yaml")[1].name == "rubber_rect4"
    assert "<svg" in (tmp_path / "figure.svg").read_text()
