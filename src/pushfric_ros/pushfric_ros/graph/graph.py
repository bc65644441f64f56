"""The node graph, defined once: the supervisor and the launch files start from here."""

import pathlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from pushfric_core.bags.run_record import KEYFRAMES
from pushfric_core.cell.cell_file import CellFile
from pushfric_core.cell.node_settings import NAMESPACE, REPORT_FILE, CameraConfig, Images, KnownTopic, PlannerConfig, ViewConfig
from pushfric_core.errors import InvalidInput, blaming
from pushfric_core.files import estimator_settings
from pushfric_core.files.estimator_settings import EstimatorSettings
from pushfric_core.files.object_file import PRIOR_FILE, load_object
from pushfric_core.plugins import SIMULATIONS, installed
from pushfric_core.pushers.serial_config import GrblConfig
from pushfric_core.settings import merged, plain
from pushfric_core.vision.camera import Camera, save_camera
from pushfric_core.vision.tracker_settings import ContourConfig
from pushfric_ros.node_kit import network

if TYPE_CHECKING:  # only a replay reads bags
    from pushfric_core.bags.recorded import ObservationSource

PACKAGE = "pushfric_ros"

CLOCK = "/clock"

VIEW = "view"
"""The node that shows a run to browsers."""

LEAST_TIMEOUT = 10.0
"""Least time after which a simulated object counts as lost, and a node or the controller as silent, in wall time [s]."""


@dataclass(frozen=True)
class NodeSpec:
    """A node of the graph."""

    name: str
    parameters: Mapping[str, Any] = field(default_factory=dict)
    remappings: Mapping[str, str] = field(default_factory=dict)  # full names of topics -> their names instead
    respawn: bool = False  # start the node again when it dies; only for nodes that lose nothing by that
    ends_run: bool = False  # the run ends when this node has done its work
    environment: Mapping[str, str] = field(default_factory=dict)  # variables in addition to those of the starting process

    @property
    def executable(self) -> str:
        return f"{self.name}_node"

    def given(self, **parameters: Any) -> "NodeSpec":
        """The same node with more parameters, or others."""
        return replace(self, parameters={**self.parameters, **parameters})


class Launchable(NamedTuple):
    """A graph that `ros2 launch` can start."""

    arguments: Mapping[str, tuple[str | None, str]]  # name -> (default, description); without a default it must be given
    graph: Callable[[Mapping[str, str], pathlib.Path], tuple[str, Sequence[NodeSpec]]]
    """From the values of the arguments, and a folder for files of the run, the namespace and the nodes."""
    found: Callable[[Mapping[str, str], str], Sequence[str]] = lambda values, namespace: ()
    """From these values and the namespace, once all nodes of a finished run have ended: in which ways the run has failed."""


TOPICS = (
    KnownTopic("object_pose", "geometry_msgs/msg/PoseWithCovarianceStamped", "reliable"),
    KnownTopic("pusher_state", "pushfric_msgs/msg/PusherState", "reliable"),
    KnownTopic("pusher_fault", "std_msgs/msg/String", "latched"),
    KnownTopic("placement", "geometry_msgs/msg/PoseStamped", "latched"),
    KnownTopic("plan_progress", "pushfric_msgs/msg/PlanProgress", "latched"),
    KnownTopic("observation", "pushfric_msgs/msg/Observation", "reliable"),
    KnownTopic("support_friction", "pushfric_msgs/msg/SupportFriction", "latched"),
    KnownTopic("center_of_friction", "geometry_msgs/msg/PointStamped", "latched"),
    KnownTopic("contact_friction", "pushfric_msgs/msg/ContactFriction", "latched"),
    KnownTopic("friction_estimate", "pushfric_msgs/msg/FrictionEstimate", "latched"),
    KnownTopic(estimator_settings.START_TOPIC, "pushfric_msgs/msg/EstimationStart", "latched"),
    KnownTopic("center_of_friction_region", "pushfric_msgs/msg/CenterOfFrictionRegion", "latched"),
    KnownTopic("recognition", "pushfric_msgs/msg/Recognition", "latched"),
    KnownTopic(estimator_settings.TOPIC, "std_msgs/msg/String", "latched"),
)
"""The topics that a cell records: all except images, friction models, which follow from the observations, and heartbeats, which
are 80 messages a second that say that nothing hangs.

A missing heartbeat leads to a fault, which is recorded.
"""

WRENCH = KnownTopic("wrench", "geometry_msgs/msg/WrenchStamped", "sensor_data")
"""Recorded as well if the estimate uses measured forces."""

IMAGES = KnownTopic(KEYFRAMES, "sensor_msgs/msg/CompressedImage", "reliable")
"""Recorded as well unless the cell's file says that no images are kept."""


def cell(file: CellFile, bag: str, start: int = 1) -> list[NodeSpec]:
    """The nodes of a cell that carries out its push plan and records it.

    Args:
        file: the cell.
        bag: folder of the bag to record.
        start: number of the push of the plan to begin with.
    Raises:
        InvalidInput: the file names a topic that is recorded anyway.
    """
    topics = [*TOPICS, *[WRENCH] * file.estimator.with_forces]
    pictured = file.camera is not None and file.images.images is not Images.OFF
    topics += [IMAGES] * pictured
    with blaming("recorder"):
        recorder = replace(file.recorder, topics=(*(" ".join(topic) for topic in topics), *file.recorder.topics))
    frames = plain(file.frames)
    estimation = {"object": file.object, "bag": bag, **frames, **plain(file.model), **file.estimator.parameters()}
    calibration = file.camera.calibration if file.camera is not None and pictured else ""
    recorded = {"bag": bag, "object": file.object, "model": file.model.model, "calibration": calibration}
    specs = [
        NodeSpec("recorder", {**recorded, **plain(recorder)}),
        NodeSpec("estimator", estimation, respawn=True),  # a new estimator goes on from the bag
        _seer(file, frames),
        *_movers(file, frames, bag, start),
    ]
    reached = network.asked_for(file.discovery)
    return [replace(spec, environment=reached) for spec in specs]


def _seer(file: CellFile, frames: Mapping[str, Any]) -> NodeSpec:
    """The node that finds the object."""
    common = {**frames, "heard_by": ["estimator", "recorder"]}
    if file.camera is None:
        return NodeSpec("pose_source", {**common, **merged(file.poses)}, respawn=True)
    seen = {**plain(file.camera), **plain(file.tracker), **plain(file.images)}
    return NodeSpec("tracker", {"object": file.object, **common, **seen}, respawn=True)


def _movers(file: CellFile, frames: Mapping[str, Any], bag: str, start: int) -> list[NodeSpec]:
    """The nodes that push; or the node that follows a robot moved by others, in which case the run has no end of its own."""
    if file.pusher is None:
        # a new one numbers the pushes on from the bag
        return [NodeSpec("tip_source", {"object": file.object, "bag": bag, **frames, **merged(file.tip)}, respawn=True)]
    watched = (_seer(file, frames).name, "estimator")
    pusher = replace(file.pusher, requires=file.pusher.requires or watched)
    leading = {"object": file.object, "start": start, "lifeless": pusher.requires_timeout}
    return [
        # a new actuator does not know where the pusher stands, unless it homes
        NodeSpec("actuator", {**frames, **plain(pusher), **plain(file.driver)}, respawn=file.pusher.home),
        NodeSpec("experiment", {**leading, **frames, **plain(file.plan)}, ends_run=True),
    ]


def pusher_alone(file: CellFile) -> list[NodeSpec]:
    """The node that moves the pusher of a cell, without those that a push needs.

    Raises:
        InvalidInput: the cell follows a robot that others move.
    """
    if file.pusher is None:
        raise InvalidInput("others move this cell's robot, expected the section pusher")
    parameters = {**plain(file.frames), **plain(replace(file.pusher, requires=())), **plain(file.driver)}
    return [NodeSpec("actuator", parameters, environment=network.asked_for(file.discovery))]


def simulated_cell(file: CellFile, bag: str, seed: int, speed: float, start: int = 1) -> list[NodeSpec]:
    """The nodes of a cell whose camera and serial port are simulated.

    Args:
        file: the cell, as `rendered` gives it; its port is where the simulated controller appears. Its axis and switches are
            those of the real controller, and do not count.
        bag: folder of the bag to record.
        seed: of the simulation.
        speed: of the simulated clock, as a multiple of real time.
        start: number of the push of the plan to begin with.
    """
    assert file.pusher is not None
    driver: Any = file.driver
    simulation = {"port_link": driver.port, "controller": file.pusher.driver, "poll_rate": file.pusher.poll_rate}
    simulation |= {"seed": seed, "speed": speed}
    # at a multiple of real time, a busy machine alone can make the object unseen and the controller silent
    late = LEAST_TIMEOUT * speed  # of simulated time, by the stamps of a busy machine
    plan = replace(
        file.plan,
        lost_object=max(file.plan.lost_object, LEAST_TIMEOUT),
        lost_result=max(file.plan.lost_result, 2 * LEAST_TIMEOUT),  # the actuator, which knows more, gives up first
        clock_tolerance=max(file.plan.clock_tolerance, late),
        follow_tolerance=max(file.plan.follow_tolerance, late * file.plan.speed),
    )
    changes = {"axis": "X", "real_time_factor": speed, "silence": max(getattr(driver, "silence", 0.0), LEAST_TIMEOUT)}
    driver = replace(driver, **{name: value for name, value in changes.items() if hasattr(driver, name)})
    slow = {name: max(getattr(file.pusher, name), LEAST_TIMEOUT) for name in ("owner_timeout", "requires_timeout")}
    # a simulated pusher does not outlive its run; it has no home switch, no force sensor and nobody with an enabling switch
    pusher = replace(file.pusher, memory="", home=False, max_force=0.0, enable_timeout=0.0, **slow)
    patient = replace(file, plan=plan, pusher=pusher, driver=driver)
    specs = [_simulation(file, simulation), *(spec.given(use_sim_time=True) for spec in cell(patient, bag, start))]
    return with_own_clock(specs, file.namespace)


def simulated_camera(file: CellFile, bag: str, start: int = 1) -> list[NodeSpec]:
    """The nodes of a cell with its own controller, in real time, whose camera, object and operator are simulated.

    Args:
        file: the cell, as `rendered` gives it.
        bag: folder of the bag to record.
        start: number of the push of the plan to begin with.
    """
    return [_simulation(file, {}), *cell(file, bag, start)]


def rendered(file: CellFile, folder: str, say: Callable[[str], None], own_pusher: bool = False) -> CellFile:
    """The same cell with a rendered camera and, unless its own pusher moves, a simulated controller.

    Args:
        file: the cell.
        folder: for the simulated controller's port, and the calibration of a camera that the cell does not have.
        say: called with a sentence for each part that has no simulation, and what takes its place.
        own_pusher: the cell's own pusher moves.
    Raises:
        InvalidInput: others move the cell's robot, so that there are no pushes to simulate.
    """
    if file.pusher is None:
        raise InvalidInput("others move this cell's robot, which cannot be simulated; expected the section pusher")
    camera, tracker, pusher, driver = file.camera, file.tracker, file.pusher, file.driver
    if camera is None:
        say("no simulation has the poses of other trackers: a rendered camera over the pushing line takes their place")
        at = np.add(pusher.line.origin, np.multiply(pusher.stroke, pusher.line.direction))
        size = float(max(load_object(file.object).outline.size))
        save_camera(
            Camera.looking_down(640, 480, (at[0], at[1]), max(0.3, 2.5 * size) / 480), pathlib.Path(folder, "camera.yaml")
        )
        camera, tracker = CameraConfig(source="topic", calibration=f"{folder}/camera.yaml"), ContourConfig()
    if not isinstance(tracker, ContourConfig):
        say(f"the rendered camera shows an outline, not what camera.tracker {camera.tracker} needs: contour takes its place")
        camera, tracker = replace(camera, tracker="contour"), ContourConfig()
    if not own_pusher:
        named: Any = driver
        port = f"{folder}/pusher"
        if pusher.driver not in installed(SIMULATIONS):
            say(f"pusher.driver {pusher.driver} has no simulation: a GRBL controller takes its place")
            pusher, driver = replace(pusher, driver="grbl"), GrblConfig(port=port)
        else:
            driver = replace(named, port=port)
    # the stamps of rendered images are exact
    camera, trajectory = replace(camera, source="topic", time_offset=0.0), replace(file.estimator.trajectory, pose_lag=0.0)
    estimator = replace(file.estimator, trajectory=trajectory)
    return replace(file, camera=camera, tracker=tracker, pusher=pusher, driver=driver, poses=(), estimator=estimator)


def _simulation(file: CellFile, parameters: Mapping[str, Any]) -> NodeSpec:
    assert file.camera is not None
    assert file.pusher is not None
    place = {"calibration": file.camera.calibration, "object_height": file.camera.object_height, "object": file.object}
    stage = {**plain(file.frames), **plain(file.pusher.stage), **plain(file.simulation)}
    return NodeSpec("simulated_cell", {**place, **parameters, **stage}, environment=network.asked_for(file.discovery))


def replay(
    bag: str,
    object_name: str,
    source: "ObservationSource",
    rate: float,
    settings: EstimatorSettings,
    paused: bool = False,
    partial: bool = False,
    shown: Sequence[str] = (),
) -> list[NodeSpec]:
    """The nodes that play a bag into a live estimator.

    Args:
        bag: path of the bag.
        object_name: name or file of the object.
        source: where the observations come from.
        rate: multiple of the recorded speed.
        settings: of the estimator.
        paused: the player waits until it is resumed.
        partial: play a damaged bag, too.
        shown: more topics to play, for which nobody waits.
    """
    from pushfric_core.bags.recorded import beside  # imported late: other runs read no bag

    topics = list(source.topics)
    playing = {"bag": bag, "partial": partial, "rate": rate, "topics": [*topics, *shown], "wait_for": topics, "paused": paused}
    player = NodeSpec("player", playing, ends_run=True)
    prior = beside(pathlib.Path(bag), PRIOR_FILE)  # the model that the recorded run went on from
    given = {"object": object_name, "source": source.kind, "model": str(prior or ""), **settings.parameters()}
    return with_own_clock([NodeSpec("estimator", given).given(use_sim_time=True), player], source.namespace)


def unattended(specs: Sequence[NodeSpec]) -> list[NodeSpec]:
    """The same nodes of a simulated cell; nobody is there to end an alarm of the pusher, so an alarm ends the run."""
    return [spec.given(attended=False) if spec.ends_run else spec for spec in specs]


def with_view(specs: Sequence[NodeSpec], object_name: str, config: ViewConfig, played: bool = False) -> list[NodeSpec]:
    """The same nodes, and one that shows the run to browsers; the run begins only when that node is ready.

    Args:
        specs: the nodes of a cell or of a replay.
        object_name: name or file of the object.
        config: where the view is served.
        played: the page teaches how to operate the cell.
    """
    reached = specs[0].environment
    bags = [spec.parameters["bag"] for spec in specs if spec.name == "recorder"]
    left = {"report": str(pathlib.Path(bags[0], REPORT_FILE))} if bags else {}
    view = NodeSpec(VIEW, {"object": object_name, "played": played, **left, **plain(config)}, respawn=True, environment=reached)
    return [*(spec.given(awaits=[*spec.parameters.get("awaits", []), VIEW]) if spec.ends_run else spec for spec in specs), view]


def with_planner(specs: Sequence[NodeSpec], config: PlannerConfig) -> list[NodeSpec]:
    """The same nodes, and one that answers planners; the run does not wait for it."""
    return [*specs, NodeSpec("planner", plain(config), respawn=True, environment=specs[0].environment)]


def with_parts(
    specs: Sequence[NodeSpec], object_name: str, view: ViewConfig | None, planner: PlannerConfig | None, played: bool = False
) -> list[NodeSpec]:
    """The same nodes, with a view and a planner if these are asked for."""
    shown = [*specs] if view is None else with_view(specs, object_name, view, played)
    return shown if planner is None else with_planner(shown, planner)


def with_own_clock(specs: Sequence[NodeSpec], namespace: str) -> list[NodeSpec]:
    """The same nodes, with the clock of their cell: /clock for the default name of a cell, as tools expect; its own for others.

    Otherwise two simulated cells in one ROS domain would set each other's time.
    """
    if namespace == NAMESPACE:
        return list(specs)
    return [replace(spec, remappings={CLOCK: f"{namespace}{CLOCK}", **spec.remappings}) for spec in specs]
