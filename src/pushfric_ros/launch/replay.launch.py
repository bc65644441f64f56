"""A bag played into a live estimator."""

from pushfric_ros.commands.launch_files import REPLAY
from pushfric_ros.graph.launch import launch_description


def generate_launch_description():
    return launch_description(REPLAY)
