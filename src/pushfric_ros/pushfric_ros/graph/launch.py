"""The node graph as a ROS 2 launch description; needs launch and launch_ros, which are part of an installed ROS 2."""

import atexit
import contextlib
import os
from collections.abc import Callable, Mapping, Sequence

from launch import LaunchContext, LaunchDescription, LaunchDescriptionEntity
from launch.actions import DeclareLaunchArgument, OpaqueFunction, RegisterEventHandler, Shutdown
from launch.event_handlers import OnProcessExit, OnProcessStart, OnShutdown
from launch.events import Shutdown as ShutdownEvent
from launch.events.process import ProcessExited, ProcessStarted
from launch_ros.actions import Node

from pushfric_core.errors import PushfricError
from pushfric_ros.graph.fork_server import describe
from pushfric_ros.graph.graph import PACKAGE, Launchable, NodeSpec
from pushfric_ros.graph.supervisor import RESPAWN_DELAY, Ended, Restarts, scratch_folder
from pushfric_ros.node_kit.executable import PARENT
from pushfric_ros.node_kit.lock import lock
from pushfric_ros.node_kit.visit import enclave


def launch_description(launchable: Launchable) -> LaunchDescription:
    """Declare the arguments, and launch the graph that they make; the cell's name is locked until the launch ends."""

    def nodes(context: LaunchContext) -> list[LaunchDescriptionEntity]:
        leaving = contextlib.ExitStack()
        atexit.register(leaving.close)  # at exit, because the launch ends after its processes
        folder = leaving.enter_context(scratch_folder())
        values = {name: context.launch_configurations[name] for name in launchable.arguments}
        namespace, specs = launchable.graph(values, folder)
        leaving.enter_context(lock(namespace))
        course = _Course({_node(spec, namespace): spec for spec in specs}, lambda: launchable.found(values, namespace))
        return [*map(RegisterEventHandler, course.handlers), *course.nodes]

    declared = [
        DeclareLaunchArgument(name, default_value=default, description=description)
        for name, (default, description) in launchable.arguments.items()
    ]
    return LaunchDescription([*declared, OpaqueFunction(function=nodes)])


class RunFailed(PushfricError):
    """A run has failed; an exception is the only way for a launch description to make `ros2 launch` end with 1."""


class _Course:
    """How a run goes: the end of a node ends the others, as under the supervisor, and a run that failed says so."""

    def __init__(self, nodes: Mapping[Node, NodeSpec], found: Callable[[], Sequence[str]]) -> None:
        self.nodes, self._found = nodes, found
        self._running: set[Node] = set()
        self._restarts = Restarts()
        self._ended: Ended | None = None
        self.handlers = (
            OnProcessStart(on_start=self._on_start),
            OnProcessExit(on_exit=self._on_exit),
            OnShutdown(on_shutdown=self._on_shutdown),
        )

    def _on_start(self, event: ProcessStarted, _: LaunchContext) -> None:
        if event.action in self.nodes:
            self._running.add(event.action)

    def _on_shutdown(self, event: ShutdownEvent, _: LaunchContext) -> None:
        if self._ended is None:  # by Ctrl-C, or by something else that was launched
            self._ended = Ended(130, event.reason)

    def _on_exit(self, event: ProcessExited, _: LaunchContext) -> list[Shutdown] | None:
        """Raises RunFailed with the end of the last node."""
        spec, code = self.nodes.get(event.action), event.returncode
        if spec is None:
            return None
        self._running.discard(event.action)
        shutdown = []
        if self._ended is None:
            self._ended = self._restarts.after(spec, code)
            if self._ended is None:
                return None
            shutdown = [Shutdown(reason=self._ended.reason)]
        elif self._ended.code == 0 and code > 0:
            self._ended = Ended(code, f"{spec.name} {describe(code)}")
        if not self._running and self._ended.code != 130:
            found = self._found() if self._ended.code == 0 else [self._ended.reason]
            if found:
                raise RunFailed("; ".join(found))
        return shutdown


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
        output="screen",
    )
