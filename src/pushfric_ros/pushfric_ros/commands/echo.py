"""The command `echo`."""

from pushfric_core.cell.node_settings import NAMESPACE
from pushfric_core.commands.application import Application
from pushfric_core.commands.cell_options import NamespaceOption
from pushfric_ros.node_kit.person import Person, line

app = Application()


@app.command()
def echo(namespace: NamespaceOption = NAMESPACE) -> None:
    with Person(namespace) as person:
        while True:
            print(line(person.state(new=True)), flush=True)
