"""A bag played into a live estimator."""


def generate_launch_description():
    try:
        from pushfric_ros.commands.launch_files import REPLAY
        from pushfric_ros.graph.launch import launch_description
    except (ImportError, AttributeError, TypeError) as error:
        from pushfric_core.commands import dependencies

        dependencies.explain(error)
        raise
    return launch_description(REPLAY)
