"""The command `jog`."""

from typing import Annotated

import typer

from pushfric_ros.commands.options import NamespaceOption
from pushfric_ros.graph.graph import COMMAND_LINE, NAMESPACE, enclave
from pushfric_ros.node_kit.person import Person

app = typer.Typer(add_completion=False)


@app.command()
def jog(
    distance: Annotated[
        float, typer.Argument(help="Distance along the stroke [mm]; negative, after --: back, as in jog -- -5.")
    ],
    speed: Annotated[float, typer.Option(help="Speed [mm/s].", min=0.1, max=1000.0)] = 10.0,
    namespace: NamespaceOption = NAMESPACE,
) -> None:
    with Person(namespace, enclave(namespace, COMMAND_LINE)) as person:
        print(person.jog(distance * 1e-3, speed * 1e-3))
