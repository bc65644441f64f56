"""The command `stop`."""

from pushfric_core.cell.node_settings import NAMESPACE
from pushfric_core.commands.application import Application
from pushfric_core.commands.cell_options import NamespaceOption
from pushfric_ros.node_kit.reach import stays_on_this_machine
from pushfric_ros.node_kit.stop_button import press

app = Application()

HERE = 0.5
"""On this machine, who listens is found within this time [s]."""


@app.command()
def stop(namespace: NamespaceOption = NAMESPACE) -> None:
    if (answer := press(namespace)) is not None:
        print(answer)
        return
    from pushfric_ros.node_kit.person import Person  # imported late: the graph is for the cells of other machines

    with Person(namespace) as person:
        person.say_stop(HERE if stays_on_this_machine() else None)
        print(person.call("actuator/stop"))
