"""The whole graph on a simulated cell."""

from pushfric_ros.commands.demo import SPEED, demo_cell
from pushfric_ros.graph import graph
from pushfric_ros.graph.launch import launch_description

ARGUMENTS = {
    "bag": (None, "folder of the bag to record"),
    "object": ("rubber_rect4", "an object of Table 1"),
    "seed": ("0", "of the camera's noise and the operator's hand"),
    "speed": (str(SPEED), "multiple of real time"),
    "namespace": (graph.NAMESPACE, "of the cell"),
}


def demo(values, folder):
    cell = demo_cell(values["object"], folder).model_copy(update={"namespace": values["namespace"]})
    return cell.namespace, graph.simulated_cell(cell, values["bag"], int(values["seed"]), float(values["speed"]))


def generate_launch_description():
    return launch_description(ARGUMENTS, demo)
