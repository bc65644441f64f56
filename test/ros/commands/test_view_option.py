"""The option --view of run, demo and replay."""

import socket

import pytest
import typer.main

from pushfric_core.cell.node_settings import ViewConfig
from pushfric_core.commands.application import AUTO_VIEW
from pushfric_core.commands.cell_options import view_at, view_to_serve
from pushfric_core.errors import InvalidInput
from pushfric_ros.commands import replay, run

CELL = ViewConfig(host="10.0.0.5", port=9000, token="a-secret-word")


@pytest.mark.parametrize(
    ("address", "settings", "expected"),
    [
        ("", CELL, None),
        (AUTO_VIEW, CELL, CELL),
        (AUTO_VIEW, ViewConfig(), ViewConfig()),
        ("8000", ViewConfig(), ViewConfig(port=8000)),
        ("8000", CELL, ViewConfig("10.0.0.5", 8000, "a-secret-word")),
        ("[::1]:8000", ViewConfig(), ViewConfig("::1", 8000)),
        ("localhost:0", ViewConfig(), ViewConfig("localhost", 0)),
        ("0.0.0.0:8000", CELL, ViewConfig("0.0.0.0", 8000, "a-secret-word")),
    ],
)
def test_an_address_stands_for_settings(address, settings, expected):
    assert view_at(address, settings) == expected


def test_an_address_that_others_reach_gets_a_token():
    tokens = {view_at("0.0.0.0:8000", ViewConfig()).token for _ in range(3)}
    assert len(tokens) == 3
    assert min(map(len, tokens)) >= 12
    assert view_at(AUTO_VIEW, ViewConfig(host="10.0.0.5")).token


@pytest.mark.parametrize("address", ["yes", "1.2.3.4", "http://robot:80", "robot:", ":80", "8000 "])
def test_what_is_no_address_is_refused(address):
    with pytest.raises(InvalidInput, match=r"^--view must be a port or HOST:PORT, got "):
        view_at(address, CELL)


def test_a_port_that_is_taken_is_named_before_anything_is_made():
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        with pytest.raises(InvalidInput, match=f"^the page cannot be served at 127.0.0.1:{port}: Address already in use"):
            view_to_serve(str(port), ViewConfig())
    assert view_to_serve(str(port), ViewConfig()).port == port


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (["x", "--view"], AUTO_VIEW),
        (["--view", "x"], AUTO_VIEW),
        (["--view", "8000", "x"], "8000"),
        (["x", "--view", "0.0.0.0:80"], "0.0.0.0:80"),
        (["x", "--view=8000"], "8000"),
        (["--view", "--headless", "x"], AUTO_VIEW),
        (["x"], ""),
    ],
)
@pytest.mark.parametrize("command", [run, replay])
def test_the_option_may_stand_alone_anywhere(command, arguments, expected):
    context = typer.main.get_command(command.app).make_context("command", arguments)
    assert context.params["view"] == expected
    assert str(context.params["cell" if command is run else "bag"]) == "x"
