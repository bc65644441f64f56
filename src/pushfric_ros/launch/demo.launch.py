"""The whole graph on a simulated cell."""

from pushfric_ros.commands import launched


def generate_launch_description():
    return launched("DEMO")
