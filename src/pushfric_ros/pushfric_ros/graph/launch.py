"""The node graph as a ROS 2 launch description; needs launch and launch_ros, which come with an installed ROS 2."""

from collections.abc import Callable, Mapping, Sequence

from launch import LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction, Shutdown
from launch_ros.actions import Node

from pushfric_ros.graph.graph import PACKAGE, NodeSpec
from pushfric_ros.graph.supervisor import RESPAWN_DELAY


def launch_description(
    arguments: Mapping[str, tuple[str | None, str]], graph: Callable[[Mapping[str, str]], tuple[str, Sequence[NodeSpec]]]
) -> LaunchDescription:
    """Declare the arguments, and launch the graph that they make.

    Args:
        arguments: name -> (default, description); a default of None makes the argument obligatory.
        graph: gets the values and returns the namespace and the nodes.
    """

    def nodes(context: LaunchContext) -> list[Node]:
        namespace, specs = graph({name: context.launch_configurations[name] for name in arguments})
        return [_node(spec, namespace) for spec in specs]

    declared = [
        DeclareLaunchArgument(name, default_value=default, description=description)
        for name, (default, description) in arguments.items()
    ]
    return LaunchDescription([*declared, OpaqueFunction(function=nodes)])


def _node(spec: NodeSpec, namespace: str) -> Node:
    return Node(
        package=PACKAGE,
        executable=spec.executable,
        name=spec.name,
        namespace=namespace,
        parameters=[dict(spec.parameters)],
        respawn=spec.respawn,
        respawn_delay=RESPAWN_DELAY,
        # a node that may not die alone takes the others with it, as under the supervisor
        on_exit=None if spec.respawn else [Shutdown(reason=f"{spec.name} has ended")],
        output="screen",
    )
