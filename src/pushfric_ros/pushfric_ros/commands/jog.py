"""The command `jog`."""

from typing import Annotated

import typer

from pushfric_core.cell.node_settings import NAMESPACE
from pushfric_core.commands.application import Application
from pushfric_core.commands.cell_options import FASTEST_STROKE, LONGEST_STROKE, NamespaceOption
from pushfric_core.commands.options import in_range
from pushfric_ros.node_kit.person import Person

app = Application()


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
