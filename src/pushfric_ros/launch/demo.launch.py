"""The whole graph on a simulated cell."""


def generate_launch_description():
    try:
        from pushfric_ros.commands.launch_files import DEMO
        from pushfric_ros.graph.launch import launch_description
    except (ImportError, AttributeError, TypeError) as error:
        from pushfric_core.commands import dependencies

        dependencies.explain(error)
        raise
    return launch_description(DEMO)
