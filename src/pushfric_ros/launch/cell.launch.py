"""The real cell: carry out its push plan, estimate, record."""

import pathlib

from pushfric_ros.files.cell_file import load_cell
from pushfric_ros.graph import graph
from pushfric_ros.graph.launch import launch_description

ARGUMENTS = {
    "cell": (None, "path of the cell's YAML file"),
    "bag": (None, "folder of the bag to record"),
    "start": ("1", "push of the plan to begin with"),
}


def cell(values, _):
    file = load_cell(pathlib.Path(values["cell"]))
    return file.namespace, graph.cell(file, values["bag"], int(values["start"]))


def generate_launch_description():
    return launch_description(ARGUMENTS, cell)
