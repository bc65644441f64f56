"""The whole graph on a simulated cell."""

from pushfric_ros.commands.launch_files import DEMO
from pushfric_ros.graph.launch import launch_description


def generate_launch_description():
    return launch_description(DEMO)
