"""The node graph as a ROS 2 launch description; needs launch and launch_ros, which are part of an installed ROS 2."""

import atexit
import contextlib
import os

from launch import LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction, Shutdown
from launch_ros.actions import Node

from pushfric_ros.graph.graph import PACKAGE, Launchable, NodeSpec, enclave
from pushfric_ros.graph.lock import lock
from pushfric_ros.graph.scratch import scratch_folder
from pushfric_ros.graph.supervisor import RESPAWN_DELAY
from pushfric_ros.node_kit.executable import PARENT


def launch_description(launchable: Launchable) -> LaunchDescription:
    """Declare the arguments, and launch the graph that they make; the cell's name is locked until the launch ends."""

    def nodes(context: LaunchContext) -> list[Node]:
        leaving = contextlib.ExitStack()
        atexit.register(leaving.close)  # at exit, because the launch ends after its processes
        folder = leaving.enter_context(scratch_folder())
        namespace, specs = launchable.graph(
            {name: context.launch_configurations[name] for name in launchable.arguments}, folder
        )
        leaving.enter_context(lock(namespace))
        return [_node(spec, namespace) for spec in specs]

    declared = [
        DeclareLaunchArgument(name, default_value=default, description=description)
        for name, (default, description) in launchable.arguments.items()
    ]
    return LaunchDescription([*declared, OpaqueFunction(function=nodes)])


def _node(spec: NodeSpec, namespace: str) -> Node:
    return Node(
        package=PACKAGE,
        executable=spec.executable,
        name=spec.name,
        namespace=namespace,
        parameters=[dict(spec.parameters)],
        remappings=list(spec.remappings.items()),
        additional_env={**spec.environment, PARENT: str(os.getpid())},
        ros_arguments=["--enclave", enclave(namespace, spec.name)],
        respawn=spec.respawn,
        respawn_delay=RESPAWN_DELAY,
        # the end of a node that is not started again ends the others, as under the supervisor
        on_exit=None if spec.respawn else [Shutdown(reason=f"{spec.name} has ended")],
        output="screen",
    )
