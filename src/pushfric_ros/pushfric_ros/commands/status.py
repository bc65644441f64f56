"""The command `status`."""

import sys

from pushfric_core.cell.node_settings import NAMESPACE
from pushfric_core.commands.application import Application
from pushfric_core.commands.cell_options import NamespaceOption
from pushfric_msgs.msg import PusherState
from pushfric_ros.node_kit.person import Person, line

app = Application()


@app.command()
def status(namespace: NamespaceOption = NAMESPACE) -> None:
    """Exit code 1: nothing can move now."""
    with Person(namespace) as person:
        print(line(person.state()))
        for name, text in person.health().items():
            print(f"{name}: {text}")
        if person.state().mode not in (PusherState.MODE_IDLE, PusherState.MODE_RUNNING):
            sys.exit(1)
