"""Pictures of the tip at known stroke positions: the pusher goes there slowly, and rests for each picture."""

import contextlib
import os
import time
from collections.abc import Callable, Iterator, Sequence

import numpy as np

from pushfric_core.cell.cell_file import CellFile
from pushfric_core.errors import InvalidInput, PushfricError
from pushfric_core.vision.camera import Image
from pushfric_core.vision.frame_source import Frames
from pushfric_msgs.msg import PusherState
from pushfric_ros.graph.graph import pusher_alone
from pushfric_ros.graph.supervisor import Supervisor
from pushfric_ros.node_kit import network
from pushfric_ros.node_kit.person import NoAnswer, Person
from pushfric_ros.node_kit.qos import RELIABLE

STALE, AVERAGED = 3, 8
"""After a motion, the first number of frames may still show it; then the mean of the second number of frames is taken."""
READY = 30.0
"""How long the pusher may take to be ready [s]; one that homes takes as long as it needs."""
HERE, ARRIVED = 1e-5, 2e-4
"""A pusher this near to where it is wanted need not move, or has arrived [m]."""


class NotMeasured(PushfricError):
    """The pusher cannot be moved as a measurement needs it."""


def along_the_stroke(
    cell: CellFile, source: Frames, positions: Sequence[float], speed: float, say: Callable[[str], None]
) -> tuple[list[float], list[Image]]:
    """Each position at which the pusher rested [m], with a picture of the tip; at the end it is back at the first.

    It moves through the cell's actuator, with all that this node watches over. Ctrl-C stops it.

    Args:
        cell: with a pusher.
        source: a camera, not opened yet.
        positions: along the stroke [m].
        speed: between the positions [m/s].
        say: called with a line for each picture, and with each line that the actuator prints.
    Raises:
        NotMeasured: the pusher is not ready, or the actuator ends.
        NoAnswer: a motion did not arrive.
        InvalidInput: no frames come.
    """
    os.environ.update(network.asked_for(cell.discovery))  # this process looks for others where the nodes do
    places: list[float] = []
    images: list[Image] = []
    # the source first: the first node of a process decides whether it can take images
    with source, _supervised(cell, lambda name, line: say(f"{name}: {line}")) as (person, start):
        here = start
        for position in positions:
            here = _go(person, here, position, speed)
            places.append(here)
            images.append(_still(source))
            say(f"picture at {1e3 * here:.1f} mm")
        _go(person, here, positions[0], speed)
    return places, images


@contextlib.contextmanager
def _supervised(cell: CellFile, say: Callable[[str, str], None]) -> Iterator[tuple[Person, float]]:
    """A person at the cell's actuator, which is ready and is watched whenever they wait; and where the pusher rests [m]."""
    with (
        Supervisor(pusher_alone(cell), cell.namespace, say) as supervisor,
        Person(cell.namespace) as person,
    ):

        def watch(_: PusherState) -> None:
            if (ended := supervisor.poll()) is not None:
                raise NotMeasured(ended.reason)

        with person.hearing(PusherState, "pusher_state", RELIABLE, watch):
            deadline = time.monotonic() + READY
            while True:
                watch(PusherState())
                with contextlib.suppress(NoAnswer):  # nothing is published before the controller answers
                    state = person.state(new=True)
                    if state.mode == PusherState.MODE_IDLE:
                        break
                    if state.mode == PusherState.MODE_HOMING:
                        deadline = time.monotonic() + READY
                if time.monotonic() > deadline:
                    raise NotMeasured(f"the pusher is not ready: {person.health()['message']}; ./pushfric doctor says more")
            yield person, state.position


def _go(person: Person, here: float, position: float, speed: float) -> float:
    """Move from where the pusher rests; returns where it rests then, as the controller rounds it [m]."""
    if abs(position - here) < HERE:
        return here
    person.jog(position - here, speed)
    deadline = time.monotonic() + READY
    while True:
        state = person.state(new=True)  # the first ones may have been sent during the motion
        if state.mode == PusherState.MODE_IDLE and abs(state.position - position) < ARRIVED:
            return float(state.position)
        if time.monotonic() > deadline:
            raise NotMeasured(f"the pusher rests at {1e3 * state.position:.2f} mm, was sent to {1e3 * position:.2f} mm")


def _still(source: Frames) -> Image:
    """The mean of some frames of a camera, from now on."""
    source.forget()
    taken = [frame for _, frame in zip(range(STALE + AVERAGED), source, strict=False)]
    if len(taken) < STALE + AVERAGED:
        raise InvalidInput(f"{source.name} has ended")
    return np.asarray(np.rint(np.mean(taken[STALE:], axis=0)), dtype=np.uint8)
