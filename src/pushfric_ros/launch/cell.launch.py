"""The real cell: carry out its push plan, estimate, record."""

from pushfric_ros.commands.launch_files import CELL
from pushfric_ros.graph.launch import launch_description


def generate_launch_description():
    return launch_description(CELL)
