"""A bag played into a live estimator."""

from pushfric_ros.commands import launched


def generate_launch_description():
    return launched("REPLAY")
