"""The estimator node: poses and pusher states -> observations -> w, p_CF and mu_c after every data point."""

import dataclasses
import math
import pathlib
import time
from typing import TYPE_CHECKING, Any

from geometry_msgs.msg import PointStamped, PoseWithCovarianceStamped, WrenchStamped
from rclpy.clock import Clock, ClockType, JumpThreshold, TimeJump
from rclpy.duration import Duration
from rclpy.node import Node
from std_msgs.msg import String
from std_srvs.srv import Trigger
from visualization_msgs.msg import Marker, MarkerArray

from pushfric_core.errors import InvalidInput, PushfricError
from pushfric_core.estimate import Estimate
from pushfric_core.observation import Observation, check_planned_contact
from pushfric_core.planar import Array
from pushfric_core.prediction import FrictionModel, model_of, predict, stability
from pushfric_core.push_choice import next_pushes
from pushfric_core.recognition import Ranking, Recognizer
from pushfric_core.region import HalfPlanes, line_of_motion
from pushfric_core.sensed_force import SensedForce
from pushfric_core.trajectory import Trajectory
from pushfric_core.verdict import Verdict
from pushfric_core.wording import data_of
from pushfric_msgs.msg import (
    CenterOfFrictionRegion,
    ContactFriction,
    EstimationStart,
    EstimatorProgress,
    FrictionEstimate,
    LimitSurface,
    PusherState,
    Recognition,
    SupportFriction,
)
from pushfric_msgs.msg import (
    Observation as ObservationMsg,
)
from pushfric_msgs.srv import ExcludePush, PredictPush, SelectObject, StablePushes
from pushfric_ros.bags.contents import mcap_file
from pushfric_ros.files.estimator_settings import START_TOPIC, EstimatorSettings
from pushfric_ros.files.estimator_settings import TOPIC as SETTINGS_TOPIC
from pushfric_ros.files.model_file import check_name, make_model, prior, save_model
from pushfric_ros.files.node_settings import DataPointSource, EstimatorNodeConfig, FrameConfig, ModelConfig, ObjectConfig
from pushfric_ros.files.object_file import ObjectModel, load_object
from pushfric_ros.messages.conversions import (
    FrictionParts,
    estimate_to_msg,
    force_sample_from_msg,
    friction_to_msg,
    limit_surface_to_msg,
    nothing_known,
    observation_from_msg,
    observation_to_msg,
    pose_sample_from_msg,
    predictions_to_msg,
    pusher_sample_from_msg,
    pushes_from_msg,
    recognition_to_msg,
    region_to_msg,
    stability_to_msg,
    stamp_from_msg,
    stamp_to_msg,
    turns_from_msg,
)
from pushfric_ros.messages.frames import OBJECT
from pushfric_ros.messages.markers import estimate_to_markers, region_to_markers
from pushfric_ros.node_kit import executable
from pushfric_ros.node_kit.audience import Audience
from pushfric_ros.node_kit.diagnostics import Diagnostics, Health, Level, without_publisher
from pushfric_ros.node_kit.heartbeat import Heartbeat
from pushfric_ros.node_kit.parameters import declare
from pushfric_ros.node_kit.process import run_node
from pushfric_ros.node_kit.qos import LATCHED, RELIABLE, SENSOR_QUEUE
from pushfric_ros.node_kit.transforms import TransformBroadcaster, object_transform

if TYPE_CHECKING:
    from pushfric_ros.bags.handover import Handover

PROGRESS_PERIOD = 0.05
"""Time between reports of how far the estimator has come, in wall time [s]."""

HANDOVER_PERIOD = 0.2
"""While a restarted estimator catches up from the bag: time between two reads of the bag, in wall time [s]."""

ASKS_AGAIN = 2.0
"""A planner that has asked within this time [s] of wall time will ask again."""

MODEL_SHARE = 0.1
"""While data points come, making the model that answers planners takes at most this share of the wall time: it takes longer
than an estimate, and must not delay the next ones, however slow the machine is."""

QUIET = 0.5
"""The limit surface is published when the estimate has not changed for this long, in wall time [s]."""

RENEWED = 200
"""mu_c rests on all data points. It is renewed after one more data point for each this many, so that its cost does not grow: up
to 200 after each, then after every second, ...; and once the estimate has not changed for QUIET."""


class EstimatorNode(Node):
    """Publishes an estimate after every data point; late subscribers get the last one."""

    def __init__(self, **kwargs: Any) -> None:
        super().__init__("estimator", **kwargs)
        model, config = declare(self, ObjectConfig), declare(self, EstimatorNodeConfig)
        self._models = declare(self, ModelConfig)
        prefix = declare(self, FrameConfig).within(self.get_namespace())
        self._settings = EstimatorSettings.of(*[declare(self, part) for part in EstimatorSettings.PARTS])
        if self._models.save:
            check_name(pathlib.Path(self._models.save))
        self._initial, self._bag = model.object, config.bag
        self._asked = self._usable_until = -math.inf  # when a planner asked last; until when its model serves; steady clock [s]
        self._prior = prior(pathlib.Path(self._models.model), load_object(model.object)) if self._models.model else []
        self._handover, self._caught_up = self._interrupted(), False
        self._begin(model.object if self._handover is None else self._handover.start.object)
        self._estimator.estimate()  # loads the compiled solver now instead of with the first data point
        self._observations_out = self._told_to = None
        self._diagnostics = topics = Diagnostics(self, self._health, prefix)
        Heartbeat(self)
        if config.source is DataPointSource.OBSERVATIONS:
            topics.subscribe(ObservationMsg, "observation", self._on_observation, RELIABLE)
        else:
            self._observations_out = topics.advertise(ObservationMsg, "observation", RELIABLE)
            self._told_to = Audience(self, self._observations_out, ["recorder"])
            self._transforms = TransformBroadcaster(self, prefix)
            topics.subscribe(PoseWithCovarianceStamped, "object_pose", self._on_pose, RELIABLE)
            topics.subscribe(PusherState, "pusher_state", self._on_pusher_state, RELIABLE)
            if self._settings.with_forces:
                topics.subscribe(WrenchStamped, "wrench", self._on_wrench, SENSOR_QUEUE)
        self._support_friction_out = topics.advertise(SupportFriction, "support_friction", LATCHED)
        self._center_of_friction_out = topics.advertise(PointStamped, "center_of_friction", LATCHED)
        self._contact_friction_out = topics.advertise(ContactFriction, "contact_friction", LATCHED)
        self._estimate_out = topics.advertise(FrictionEstimate, "friction_estimate", LATCHED)
        self._recognition_out = topics.advertise(Recognition, "recognition", LATCHED)
        self._markers_out = topics.advertise(MarkerArray, "markers", LATCHED)
        self._region_out = topics.advertise(CenterOfFrictionRegion, "center_of_friction_region", LATCHED)
        self._settings_out = topics.advertise(String, SETTINGS_TOPIC, LATCHED)
        self._progress_out = topics.advertise(EstimatorProgress, "estimator_progress", LATCHED)
        self._told: tuple[int, int] | None = None  # what the last report said [ns]
        self.create_timer(PROGRESS_PERIOD, self._publish_progress, clock=Clock(clock_type=ClockType.STEADY_TIME))
        self._start_out = topics.advertise(EstimationStart, START_TOPIC, LATCHED)
        self._publish_start()
        if self._handover is None:
            self._publish_settings()
        else:
            self.get_logger().warning(f"goes on from {self._bag}")
            self._look = self.create_timer(HANDOVER_PERIOD, self._go_on, clock=Clock(clock_type=ClockType.STEADY_TIME))
        self._publish_all()
        self.create_service(Trigger, "~/reset", self._on_reset)
        self.create_service(SelectObject, "~/select_object", self._on_select_object)
        self.create_service(ExcludePush, "~/exclude_push", self._on_exclude_push)
        self.create_service(ExcludePush, "~/keep_push", self._on_keep_push)
        self.create_service(PredictPush, "~/predict_push", self._on_predict_push)
        self.create_service(StablePushes, "~/stable_pushes", self._on_stable_pushes)
        self._limit_surface_out = topics.advertise(LimitSurface, "limit_surface", LATCHED)
        self._drawn: Estimate | None = None  # whose limit surface was published
        self.create_timer(QUIET, self._publish_limit_surface, clock=Clock(clock_type=ClockType.STEADY_TIME))
        # time that runs backwards means another run of the cell or a bag, whose data must not be mixed with earlier data
        backwards = JumpThreshold(min_forward=None, min_backward=Duration(nanoseconds=-1), on_clock_change=False)
        self._jump = self.get_clock().create_jump_callback(backwards, post_callback=self._on_clock_jump)

    def destroy_node(self) -> None:
        """Write the model that is to be kept, and destroy the node.

        The model of another object than this one never takes the place of the one that the estimate went on from.

        Raises:
            InvalidInput: the model cannot be written.
        """
        try:
            other = self._chosen != self._initial and self._models.save == self._models.model
            if self._models.save and other:
                self.get_logger().warning(f"{self._models.save} stays as it was: it is not the model of {self._object.name}")
            elif self._models.save and self._estimate is not None and self._estimate.contradiction is None:
                made_from = self._bag or self.get_fully_qualified_name()
                settings = self._settings.without(self._excluded)
                model = make_model(self._object, self._estimate, self._estimator.observations, made_from, settings)
                save_model(model, pathlib.Path(self._models.save))
        finally:
            super().destroy_node()

    def _interrupted(self) -> "Handover | None":
        """What an estimator that died in this run has left behind; None if this is the run's first estimator."""
        if not self._bag or not mcap_file(pathlib.Path(self._bag)).exists():
            return None
        from pushfric_ros.bags.handover import Handover  # imported late: few estimators need to read bags

        inputs = ("object_pose", "pusher_state", *["wrench"] * self._settings.with_forces)
        try:
            handover = Handover(pathlib.Path(self._bag), self.get_namespace(), inputs)
        except (OSError, ValueError) as error:
            raise InvalidInput(f"{self._bag}: the estimate cannot go on from it: {error}") from error
        return None if handover.start is None else handover

    def _go_on(self) -> None:
        """Take the messages of the bag; once it holds all earlier ones, take those that came by topic meanwhile."""
        assert self._handover is not None
        if self._told_to is not None and self._told_to.missing:
            return
        try:
            found = self._handover.read_on()
        except (OSError, ValueError) as error:
            raise InvalidInput(f"{self._bag}: the estimate cannot go on from it: {error}") from error
        before = self._estimate
        if found is None:
            return
        if not self._caught_up:  # with the earlier estimator, whose last messages are known only now
            self._caught_up = True
            self._begin(self._handover.start.object)
            self._publish_settings()
            self._publish_start()
        for topic, msg, _ in found:
            self._take_input(topic, msg)
        held = self._handover.held
        for topic, msg, _ in held or ():
            self._take_input(topic, msg)
        if self._estimate is not before:
            self._publish_all()
        if held is not None:
            self._look.cancel()
            self._handover = None
            known = "no data points" if self._estimate is None else data_of(self._estimate.data_points, self._estimate.pushes)
            self.get_logger().warning(f"has gone on from the bag with {known}; the topics lead from here")

    def _begin(self, chosen: str) -> None:
        """Start a new estimate of an object, given by its name or file."""
        self._select(load_object(chosen))
        self._chosen = chosen
        for observation in self._prior if chosen == self._initial else ():
            if observation.push_id not in self._excluded:
                self._learn(observation)

    def _select(self, model: ObjectModel) -> None:
        settings = self._settings
        self._object = model
        last = self._handover.settings if self._handover is not None else None
        self._excluded = set(settings.excluded if last is None else last.excluded)
        self._ranking: Ranking | None = None
        self._trajectory = Trajectory(model.outline, settings.trajectory)
        self._sensed_force = SensedForce() if self._settings.with_forces else None
        self._estimator = settings.new_estimator(model.support_points)
        self._recognizer = Recognizer(model.hypotheses, settings.estimator) if model.hypotheses else None
        self._half_planes = HalfPlanes(model.outline, settings.region.region_margin)
        self._left_out: set[int] = set()  # pushes that the region does not use
        self._estimate: Estimate | None = None
        self._mu_c: FrictionParts | None = None  # what was last said of mu_c
        self._model: tuple[Estimate, FrictionModel] | None = None  # the last estimate that was asked to predict
        self._before: Estimate | None = None  # the estimate a moment ago
        self._verdict = Verdict()
        self._problem: str | None = None
        self._refused = 0

    def _on_pose(self, msg: PoseWithCovarianceStamped) -> None:
        self._on_input("object_pose", msg)

    def _on_pusher_state(self, msg: PusherState) -> None:
        self._on_input("pusher_state", msg)

    def _on_wrench(self, msg: WrenchStamped) -> None:
        self._on_input("wrench", msg)

    def _on_input(self, topic: str, msg: Any) -> None:
        if self._handover is not None:
            self._handover.hold(topic, msg)
        elif self._take_input(topic, msg) and topic == "object_pose":
            self._transforms.broadcast(object_transform(msg))

    def _take_input(self, topic: str, msg: Any) -> bool:
        """Make data points from a message of a topic or of the bag; return whether the message was valid."""
        try:
            if topic == "wrench":
                assert self._sensed_force is not None
                self._take(self._sensed_force.add_force(force_sample_from_msg(msg)))
            elif topic == "object_pose":
                self._take_observed(self._trajectory.add_pose(pose_sample_from_msg(msg)))
            else:
                self._take_observed(self._trajectory.add_pusher(pusher_sample_from_msg(msg)))
        except ValueError as error:
            self._refuse(topic, error)
            return False
        return True

    def _on_observation(self, msg: ObservationMsg) -> None:
        try:
            observation = observation_from_msg(msg)
            observation.check_contact(self._object.outline)
        except (ValueError, PushfricError) as error:
            self._refuse("observation", error)
        else:
            self._take([observation])

    def _take_observed(self, observations: list[Observation]) -> None:
        """Take the data points that were made here, with their forces if these are needed."""
        if self._sensed_force is None:
            self._take(observations)
            return
        for observation in observations:
            self._take(self._sensed_force.add_observation(observation))

    def _take(self, observations: list[Observation]) -> None:
        for observation in observations:
            if self._handover is None or (observation.push_id, observation.stamp) not in self._handover.told:
                self._tell(observation)
            if observation.push_id in self._excluded:
                continue
            if self._handover is not None:
                self._learn(observation)
                continue
            if not self._add(observation):
                continue
            assert self._estimate is not None
            msg = self._publish(self._estimate, at_rest=False)
            self._narrow(observation)
            self._publish_region()
            self._draw(msg)
            if self._recognize(observation):
                self._publish_ranking()
        usable = self._handover is None and self._estimate is not None and self._estimate.contradiction is None
        if usable and time.monotonic() < self._asked + ASKS_AGAIN and self._outdated():
            self._make_model()  # after the estimate is out, and before the question

    def _tell(self, observation: Observation) -> None:
        """Publish a data point that was made here."""
        if self._observations_out is not None:
            self._observations_out.publish(observation_to_msg(observation, self._object.name))

    def _learn(self, observation: Observation) -> None:
        """Take a data point without publishing anything."""
        if self._add(observation):
            self._narrow(observation)
            self._recognize(observation)

    def _add(self, observation: Observation) -> bool:
        """Estimate again, with one more data point; return whether it could be used."""
        try:
            self._estimate = self._estimator.take(observation)
        except PushfricError as error:
            self._refuse("observation", error)
            return False
        return True

    def _recognize(self, observation: Observation) -> bool:
        """Rank again; return whether the ranking is a new one."""
        if self._recognizer is None:
            return False
        try:
            self._ranking = self._recognizer.add(observation)
        except PushfricError as error:
            self._refuse("observation, for recognition,", error)
            return False
        return True

    def _publish_ranking(self) -> None:
        ranking = self._ranking
        self._recognition_out.publish(
            Recognition() if ranking is None or not ranking.data_points else recognition_to_msg(ranking)
        )

    def _publish_all(self) -> None:
        """Publish all that is known."""
        self._publish_region()
        if self._estimate is not None:
            self._draw(self._publish(self._estimate))
        if self._ranking is not None:
            self._publish_ranking()

    def _narrow(self, observation: Observation) -> None:
        """Narrow the region down with one more data point; start over if the pushes that are left out have changed."""
        rejected = {one.push_id for one in self._estimator.rejected}
        if rejected != self._left_out:
            self._narrow_again()
        elif observation.push_id not in rejected:
            self._cut(observation)

    def _cut(self, observation: Observation) -> None:
        try:
            self._half_planes.add(line_of_motion(observation))
        except PushfricError as error:
            self._refuse("observation, for the region of p_CF,", error)

    def _narrow_again(self) -> None:
        """The region from the pushes that are not left out."""
        self._left_out = {one.push_id for one in self._estimator.rejected}
        self._half_planes = HalfPlanes(self._object.outline, self._settings.region.region_margin)
        for observation in self._estimator.observations:
            self._cut(observation)

    def _publish_region(self) -> None:
        stamp = self._estimate.stamp if self._estimate is not None else 0
        pushes = next_pushes(self._half_planes)
        self._region = region_to_msg(self._half_planes.region(), pushes, stamp, self._object.name)
        self._region_out.publish(self._region)

    def _publish(self, estimate: Estimate, at_rest: bool = True) -> FrictionEstimate:
        """Publish the estimate first, and then what planners do not wait for.

        Args:
            estimate: the present one.
            at_rest: no data point followed it at once.
        """
        contradiction = estimate.contradiction
        if contradiction is not None and self._problem is None:
            self.get_logger().error(contradiction)
        self._problem = contradiction
        self._verdict = self._estimator.verdict(estimate)
        friction = self._mu_c
        if friction is None or at_rest or friction_is_due(estimate.data_points, friction.data_points):
            slipping = self._settings.slipping
            slips = [observation.push_id in slipping for observation in self._estimator.observations] if slipping else ()
            friction = self._mu_c = friction_to_msg(estimate, self._object.name, slips)
        msg = estimate_to_msg(estimate, self._object.name, verdict=self._verdict, friction=friction)
        self._estimate_out.publish(msg)
        # w, p_CF and mu_c have no status of their own
        self._publish_parts(msg if contradiction is None else nothing_known(self._object.name))
        return msg

    def _draw(self, msg: FrictionEstimate) -> None:
        if msg.status in (msg.STATUS_NO_DATA, msg.STATUS_INFEASIBLE):
            self._markers_out.publish(MarkerArray(markers=[Marker(action=Marker.DELETEALL)]))
            return
        assert self._estimator.newest is not None
        markers = estimate_to_markers(msg, self._object.outline, self._estimator.newest)
        markers.markers += region_to_markers(self._region, self._object.outline)
        self._markers_out.publish(markers)

    def _publish_parts(self, msg: FrictionEstimate) -> None:
        self._support_friction_out.publish(msg.support_friction)
        self._center_of_friction_out.publish(PointStamped(header=msg.header, point=msg.center_of_friction))
        self._contact_friction_out.publish(msg.contact_friction)

    def _take_back(self) -> None:
        """Publish that nothing is known: without data points, nothing that was published before is valid any longer."""
        msg = nothing_known(self._object.name)
        self._estimate_out.publish(msg)
        self._publish_parts(msg)
        self._draw(msg)
        self._recognition_out.publish(Recognition())

    def _publish_settings(self) -> None:
        self._settings_out.publish(String(data=self._settings.without(self._excluded).to_text()))

    def _publish_start(self) -> None:
        msg = EstimationStart(object=self._chosen)
        msg.header.stamp, msg.header.frame_id = self.get_clock().now().to_msg(), OBJECT
        if self._handover is not None:
            msg.header.stamp = stamp_to_msg(stamp_from_msg(self._handover.start.header.stamp))
            msg.continuation = self._handover.continuation
        self._start_out.publish(msg)

    def _start_afresh(self, chosen: str) -> None:
        load_object(chosen)  # what cannot be loaded changes nothing
        if self._handover is not None:  # the rest of the bag no longer counts
            self._look.cancel()
            self._handover = None
        self._begin(chosen)
        self._publish_settings()
        self._publish_start()
        if self._estimate is None:
            self._take_back()
        self._publish_all()

    def _refuse(self, what: str, error: Exception) -> None:
        """Log once, not at camera rate, that input was refused; the estimate stays as it was."""
        self._refused += 1
        if self._problem is None:
            self.get_logger().error(f"{what} refused: {error}")
        self._problem = str(error)

    def _on_reset(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        self._start_afresh(self._chosen)
        response.success, response.message = True, f"estimation of {self._object.name} starts again"
        return response

    def _on_select_object(self, request: SelectObject.Request, response: SelectObject.Response) -> SelectObject.Response:
        try:
            self._start_afresh(request.object)
        except InvalidInput as error:
            response.message = str(error)
        else:
            response.success, response.message = True, f"estimation of {self._object.name} starts"
            if self._prior:
                model, of = self._models.model, load_object(self._initial).name
                used = "goes on from" if self._chosen == self._initial else f"does not use the model of {of},"
                response.message += f"; it {used} {model}"
                self.get_logger().warning(response.message)
        return response

    def _on_exclude_push(self, request: ExcludePush.Request, response: ExcludePush.Response) -> ExcludePush.Response:
        try:
            estimate = self._estimator.exclude(request.push_id)
        except ValueError as error:
            response.message = str(error)
            return response
        self._model = None
        self._excluded.add(request.push_id)  # also its data points that are still to come
        self._publish_settings()
        response.success = True
        response.message = f"left: {data_of(estimate.data_points, estimate.pushes)}"
        self._estimate = estimate if estimate.data_points else None
        self._narrow_again()
        self._publish_region()
        if self._estimate is None:
            self._take_back()
        else:
            self._draw(self._publish(self._estimate))
        # recognition may have refused all data points of that push
        if self._recognizer is not None and any(o.push_id == request.push_id for o in self._recognizer.observations):
            self._ranking = self._recognizer.exclude(request.push_id)
            self._publish_ranking()
        return response

    def _on_keep_push(self, request: ExcludePush.Request, response: ExcludePush.Response) -> ExcludePush.Response:
        estimate = self._estimator.keep(request.push_id)
        self._model = None
        kept = tuple(sorted({*self._settings.kept, request.push_id}))
        self._settings = dataclasses.replace(self._settings, kept=kept)
        self._publish_settings()
        response.success = True
        response.message = f"kept: {data_of(estimate.data_points, estimate.pushes)} are in"
        if estimate.data_points:
            self._estimate = estimate
            self._narrow_again()
            self._publish_region()
            self._draw(self._publish(estimate))
        return response

    def _make_model(self) -> tuple[Estimate, FrictionModel]:
        """The last estimate, and the model that predicts from it.

        Raises:
            ValueError: there is no estimate to predict from.
        """
        estimate = self._estimate
        if estimate is None:
            raise ValueError("there is no estimate yet; push the object first")
        if estimate.contradiction is not None:
            raise ValueError(estimate.contradiction)
        if self._model is None or self._model[0] is not estimate:
            begin = time.monotonic()
            self._model = estimate, model_of(estimate, self._estimator.observations)
            self._usable_until = time.monotonic() + (time.monotonic() - begin) / MODEL_SHARE
        return self._model

    def _outdated(self) -> bool:
        """Whether the model is not to be used any longer: there is no estimate, or one that has come since, some time ago."""
        estimate = self._estimate
        if self._model is None or estimate is None or estimate.contradiction is not None:
            return True
        return self._model[0] is not estimate and time.monotonic() >= self._usable_until

    def _on_predict_push(self, request: PredictPush.Request, response: PredictPush.Response) -> PredictPush.Response:
        try:
            pushes = pushes_from_msg(request)
            return predictions_to_msg(predict(self._asked_for(*pushes[:2]), *pushes), response)
        except (ValueError, PushfricError) as error:
            response.message = str(error)
            return response

    def _on_stable_pushes(self, request: StablePushes.Request, response: StablePushes.Response) -> StablePushes.Response:
        try:
            turns = turns_from_msg(request)
            return stability_to_msg(stability(self._asked_for(*turns[:2]), *turns), response)
        except (ValueError, PushfricError) as error:
            response.message = str(error)
            return response

    def _asked_for(self, points: Array, normals: Array) -> FrictionModel:
        """What answers a planner that asks about contacts (k, 2) [m] with these normals (k, 2).

        Raises:
            ValueError: there is no estimate to predict from, or a contact is not one.
        """
        self._asked = time.monotonic()
        self._check_contacts(points, normals)
        model = self._make_model() if self._model is None or self._outdated() else self._model
        return model[1]

    def _check_contacts(self, points: Array, normals: Array) -> None:
        """Refuse contacts that are not on the object, or whose normals are wrong. Raises ValueError."""
        for number, (point, normal) in enumerate(zip(points.tolist(), normals.tolist(), strict=True)):
            try:
                check_planned_contact(self._object.outline, point, normal)
            except ValueError as error:
                raise ValueError(f"contact {number}: {error}") from error

    def _publish_limit_surface(self) -> None:
        """Publish what takes longer than a data point may wait, for an estimate that has lasted a while."""
        settled, self._before = self._before is self._estimate, self._estimate
        if not settled or self._drawn is self._estimate:
            return
        self._drawn = self._estimate
        if self._mu_c is not None and self._estimate is not None and self._mu_c.data_points != self._estimate.data_points:
            self._publish(self._estimate)
        try:
            msg = limit_surface_to_msg(*self._make_model(), self._object.name)
        except (ValueError, PushfricError):  # there is no estimate any longer, or it has no limit surface
            msg = LimitSurface(object=self._object.name)
        self._limit_surface_out.publish(msg)

    def _on_clock_jump(self, jump: TimeJump) -> None:
        self.get_logger().warning(f"the clock jumped back by {-jump.delta.nanoseconds / 1e9:.3f} s: estimation starts again")
        self._start_afresh(self._chosen)

    def _publish_progress(self) -> None:
        """Publish the time up to which all poses have become data points, if it has changed."""
        settled, waiting = self._trajectory.settled, None
        if self._sensed_force is not None:
            waiting = self._sensed_force.waiting_since
        settled = max(0, settled if waiting is None else min(settled, waiting - 1))
        newest = self._estimate.stamp if self._estimate is not None else 0
        if (settled, newest) != self._told:
            self._told = settled, newest
            msg = EstimatorProgress(settled_until=stamp_to_msg(settled))
            msg.header.stamp, msg.header.frame_id = stamp_to_msg(newest), OBJECT
            self._progress_out.publish(msg)

    def _health(self) -> Health:
        values = {"object": self._object.name, "refused": self._refused, "data points": 0}
        if self._estimate is not None:
            solution = self._estimate.solution
            values |= {
                "data points": self._estimate.data_points,
                "fit error": solution.objective,
                "fit error per data point": solution.objective / self._estimate.data_points,
                "gap": solution.gap,
                "status": self._estimate.status.value,
            }
        if self._sensed_force is not None:
            values["data points without their force yet"] = self._sensed_force.waiting
        if self._handover is not None:
            return Health(Level.WARN, f"goes on from {self._bag}", values)
        if silent := without_publisher(self):
            return Health(Level.WARN, f"no publisher of {', '.join(silent)}", values)
        if self._problem is not None:
            return Health(Level.ERROR, self._problem, values)
        if self._trajectory.contradiction is not None:
            return Health(Level.WARN, self._trajectory.contradiction, values)
        if not self._verdict.use:
            return Health(Level.WARN, "; ".join(self._verdict.reasons), values)
        if self._verdict.rejected:
            words = "; ".join(f"push {one.push_id} is left out: {one.reason}" for one in self._verdict.rejected)
            return Health(Level.OK, words, values)
        return Health(Level.OK, "estimating" if self._estimate else "waiting for data points", values)


def friction_is_due(data_points: int, said_of: int) -> bool:
    """Whether mu_c, which rests on the first number of data points, must be renewed for the second."""
    return not 0 <= data_points - said_of <= data_points // RENEWED


def main() -> None:
    run_node(EstimatorNode)


if __name__ == "__main__":
    executable.main()
