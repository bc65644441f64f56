"""The command `reset`."""

from pushfric_core.cell.node_settings import NAMESPACE
from pushfric_core.commands.application import Application
from pushfric_core.commands.cell_options import NamespaceOption
from pushfric_ros.node_kit.person import Person

app = Application()


@app.command()
def reset(namespace: NamespaceOption = NAMESPACE) -> None:
    with Person(namespace) as person:
        print(person.call("actuator/reset"))
