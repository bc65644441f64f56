"""The commands `reset`, `status`, `echo` and `jog`, for the pusher of a running cell."""

import sys
from typing import Annotated

import typer

from pushfric_core.cell.node_settings import NAMESPACE
from pushfric_core.commands.application import Application, in_range
from pushfric_core.commands.cell_options import FASTEST_STROKE, LONGEST_STROKE, NamespaceOption
from pushfric_msgs.msg import PusherState
from pushfric_ros.node_kit.person import Person, line

app = Application()


@app.command()
def reset(namespace: NamespaceOption = NAMESPACE) -> None:
    with Person(namespace) as person:
        print(person.call("actuator/reset"))


@app.command()
def status(namespace: NamespaceOption = NAMESPACE) -> None:
    """Exit code 1: nothing can move now."""
    with Person(namespace) as person:
        print(line(person.state()))
        for name, text in person.health().items():
            print(f"{name}: {text}")
        if person.state().mode not in (PusherState.MODE_IDLE, PusherState.MODE_RUNNING):
            sys.exit(1)


@app.command()
def echo(namespace: NamespaceOption = NAMESPACE) -> None:
    with Person(namespace) as person:
        while True:
            print(line(person.state(new=True)), flush=True)


@app.command()
def jog(
    distance: Annotated[
        float,
        typer.Argument(
            help="Distance along the stroke [m]; negative, after --: back, as in jog -- -0.005.",
            **in_range(-LONGEST_STROKE, LONGEST_STROKE, "m"),
        ),
    ],
    speed: Annotated[float, typer.Option(help="Speed [m/s].", **in_range(0.0001, FASTEST_STROKE, "m/s"))] = 0.01,
    namespace: NamespaceOption = NAMESPACE,
) -> None:
    with Person(namespace) as person:
        print(person.jog(distance, speed))
