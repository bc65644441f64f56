"""The real cell: carry out its push plan, estimate, record."""

from pushfric_ros.commands import launched


def generate_launch_description():
    return launched("CELL")
