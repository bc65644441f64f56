"""The estimator node: poses and pusher states -> observations -> w, p_CF and mu_c after every observation."""

import dataclasses
import pathlib
import time
from collections import Counter
from collections.abc import Generator
from functools import partial
from typing import TYPE_CHECKING, Any

from geometry_msgs.msg import PoseWithCovarianceStamped, WrenchStamped
from rclpy.clock import Clock, ClockType, JumpThreshold, TimeJump
from rclpy.duration import Duration
from rclpy.node import Node
from std_msgs.msg import String
from std_srvs.srv import Trigger

from pushfric_core.bags.contents import mcap_file
from pushfric_core.bags.run_record import PLAN, PlanRecord
from pushfric_core.bags.samples import (
    force_sample_from_msg,
    observation_from_msg,
    pose_sample_from_msg,
    pusher_sample_from_msg,
    stamp_from_msg,
)
from pushfric_core.belief.symptoms import tip_stays_away
from pushfric_core.cell.node_settings import EstimatorInput, EstimatorNodeConfig, FrameConfig, ModelConfig, ObjectConfig
from pushfric_core.errors import InvalidInput, PushfricError
from pushfric_core.estimation.estimate import Estimate
from pushfric_core.estimation.online_estimation import OnlineEstimation
from pushfric_core.estimation.recognition import Recognizer
from pushfric_core.estimation.verdict import Verdict
from pushfric_core.files.estimator_settings import START_TOPIC, EstimatorSettings
from pushfric_core.files.estimator_settings import TOPIC as SETTINGS_TOPIC
from pushfric_core.files.model_file import check_name, make_model, prior, save_model
from pushfric_core.files.object_file import ObjectModel, load_object
from pushfric_core.geometry.frames import OBJECT
from pushfric_core.trajectories.ledger import OBSERVATIONS, POSES, REFUSED, STATES, WRENCHES, Ledger
from pushfric_core.trajectories.observation import Observation
from pushfric_core.trajectories.observation_maker import ObservationMaker
from pushfric_core.trajectories.stream import LONGEST_END_SKEW
from pushfric_core.wording import data_of
from pushfric_msgs.msg import EstimationStart, EstimatorProgress, PlanProgress, PusherState
from pushfric_msgs.msg import Observation as ObservationMsg
from pushfric_msgs.srv import SelectObject, SelectPush
from pushfric_ros.messages.conversions import observation_to_msg, stamp_to_msg
from pushfric_ros.node_kit.diagnostics import Diagnostics, Health, Level, without_publisher
from pushfric_ros.node_kit.heartbeat import Heartbeat
from pushfric_ros.node_kit.parameters import declare
from pushfric_ros.node_kit.process import run_node
from pushfric_ros.node_kit.qos import LATCHED, LATCHED_QUEUE, RELIABLE, SENSOR_QUEUE
from pushfric_ros.node_kit.required_subscribers import RequiredSubscribers
from pushfric_ros.node_kit.transforms import TransformBroadcaster, object_transform
from pushfric_ros.nodes.estimator.publications import ModelPublication, Publications

if TYPE_CHECKING:
    from pushfric_core.bags.resumption import Resumption

PROGRESS_PERIOD = 0.05
"""Time between reports of how far the estimator has come, between drawings, and between looks for rest, in wall time [s]."""

KINDS = {"object_pose": POSES, "pusher_state": STATES, "wrench": WRENCHES}
"""The inputs' names in the ledger."""

HANDOVER_PERIOD = 0.2
"""While a restarted estimator catches up from the bag: time between two reads of the bag, in wall time [s]."""

QUIET = 0.5
"""During a push, the estimate is at rest if it has not changed for this time; between pushes, if it has not since the last look
[s of wall time]."""


class EstimatorNode(Node):
    """Publishes an estimate after every observation; late subscribers get the last one."""

    def __init__(self, **kwargs: Any) -> None:
        super().__init__("estimator", **kwargs)
        model, config = declare(self, ObjectConfig), declare(self, EstimatorNodeConfig)
        self._models = declare(self, ModelConfig)
        prefix = declare(self, FrameConfig).within(self.get_namespace())
        self._settings = EstimatorSettings.of(*[declare(self, part) for part in EstimatorSettings.PARTS])
        if self._models.save:
            check_name(pathlib.Path(self._models.save))
        self._initial, self._bag = model.object, config.bag
        self._prior = prior(pathlib.Path(self._models.model), load_object(model.object)) if self._models.model else []
        self._resumption, self._caught_up = self._interrupted(), False
        self._diagnostics = topics = Diagnostics(self, self._health, prefix)
        self._publications = Publications(topics, self._settings.slipping)
        self._model_publication = ModelPublication(topics)
        self._begin(model.object if self._resumption is None else self._resumption.start.object)
        # the compiled solver is loaded now, not with the first observation
        self._settings.new_estimator(self._object.support_points).estimate()
        self._observations_out = self._required_subscribers = None
        Heartbeat(self)
        if config.source is EstimatorInput.OBSERVATIONS:
            topics.subscribe(ObservationMsg, "observation", self._on_observation, RELIABLE)
        else:
            self._observations_out = topics.advertise(ObservationMsg, "observation", RELIABLE)
            self._required_subscribers = RequiredSubscribers(self, self._observations_out, ["recorder"])
            self._transforms = TransformBroadcaster(self, prefix)
            for kind, topic in ((PoseWithCovarianceStamped, "object_pose"), (PusherState, "pusher_state")):
                topics.subscribe(kind, topic, partial(self._on_input, topic), RELIABLE)
            self.create_subscription(PlanProgress, PLAN, partial(self._on_input, PLAN), LATCHED_QUEUE)
            if self._settings.with_forces:
                topics.subscribe(WrenchStamped, "wrench", partial(self._on_input, "wrench"), SENSOR_QUEUE)
        self._settings_out = topics.advertise(String, SETTINGS_TOPIC, LATCHED)
        self._progress_out = topics.advertise(EstimatorProgress, "estimator_progress", LATCHED)
        self._last_progress: tuple[int, int, bool] | None = None  # what the last report said
        self.create_timer(PROGRESS_PERIOD, self._report, clock=Clock(clock_type=ClockType.STEADY_TIME))
        self._start_out = topics.advertise(EstimationStart, START_TOPIC, LATCHED)
        self._publish_start()
        if self._resumption is None:
            self._publish_settings()
        else:
            self.get_logger().warning(f"goes on from {self._bag}")
            self._catch_up_timer = self.create_timer(
                HANDOVER_PERIOD, self._catch_up, clock=Clock(clock_type=ClockType.STEADY_TIME)
            )
        self._publications.publish_all(self._judge())
        self._model_publication.publish(self._verdict)
        self.create_service(Trigger, "~/reset", self._on_reset)
        self.create_service(SelectObject, "~/select_object", self._on_select_object)
        self.create_service(SelectPush, "~/exclude_push", self._on_exclude_push)
        self.create_service(SelectPush, "~/keep_push", self._on_keep_push)
        self._previous: Estimate | None = None  # the estimate at the last look
        self._changed = 0.0  # when it was seen to have changed, by time.monotonic() [s]
        self._pushing = True  # whether a push is under way, as far as is known
        self._steady: Estimate | None = None  # the last estimate that had not changed for a while
        self._settling: Generator[None, None, None] | None = None  # what is published at rest, in steps
        self._more = self.create_guard_condition(self._settle_on)
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
            elif self._models.save and self._online.usable:
                assert self._online.estimate is not None
                made_from = self._bag or self.get_fully_qualified_name()
                settings = self._settings_now()
                model = make_model(self._object, self._online.estimate, made_from, settings)
                save_model(model, pathlib.Path(self._models.save))
        finally:
            super().destroy_node()

    def _interrupted(self) -> "Resumption | None":
        """The remains of an estimator that died in this run; None if this is the run's first estimator."""
        if not self._bag or not mcap_file(pathlib.Path(self._bag)).exists():
            return None
        from pushfric_core.bags.resumption import Resumption  # imported late: few estimators need to read bags

        inputs = ("object_pose", "pusher_state", *["wrench"] * self._settings.with_forces)
        try:
            resumption = Resumption(pathlib.Path(self._bag), self.get_namespace(), inputs)
        except (OSError, ValueError) as error:
            raise InvalidInput(f"{self._bag}: the estimate cannot go on from it: {error}") from error
        return None if resumption.start is None else resumption

    def _catch_up(self) -> None:
        """Take the messages of the bag; once it holds all earlier ones, take those that came by topic meanwhile."""
        assert self._resumption is not None
        if self._required_subscribers is not None and self._required_subscribers.missing:
            return
        try:
            found = self._resumption.read_on()
        except (OSError, ValueError) as error:
            raise InvalidInput(f"{self._bag}: the estimate cannot go on from it: {error}") from error
        before = self._online.estimate
        if found is None:
            return
        if not self._caught_up:  # with the earlier estimator, whose last messages are known only now
            self._caught_up = True
            self._begin(self._resumption.start.object)
            self._publish_settings()
            self._publish_start()
        held = self._resumption.held
        for each in (*found, *(held or ())):
            self._take_input(*each)
        if self._online.estimate is not before:
            self._publications.publish_all(self._judge())
        if held is not None:
            self._catch_up_timer.cancel()
            self._resumption = None
            estimate = self._online.estimate
            known = "no observations" if estimate is None else data_of(estimate.data_points, estimate.pushes)
            self.get_logger().warning(f"has gone on from the bag with {known}; the topics lead from here")

    def _begin(self, chosen: str) -> None:
        """Start a new estimate of an object, given by its name or file."""
        self._select(load_object(chosen))
        self._chosen = chosen
        for observation in self._prior if chosen == self._initial else ():
            self._made.append(observation)
            if observation.push_id not in self._excluded:
                self._online.learn(observation)

    def _select(self, model: ObjectModel) -> None:
        settings = self._settings
        self._object = model
        last = self._resumption.settings if self._resumption is not None else None
        self._excluded = set(settings.excluded if last is None else last.excluded)
        self._maker = ObservationMaker(model.outline, settings.trajectory, settings.with_forces)
        self._plan = PlanRecord()
        self._estimate_anew()
        self._verdict = Verdict()
        self._problem: str | None = None
        self._refused = 0
        self._refused_messages: Counter[str] = Counter()  # by kind of the ledger
        self._made: list[Observation] = []  # of all pushes
        self._noted: set[tuple[str, int]] = set()  # codes and stamps of the doubts that the log has

    def _estimate_anew(self) -> None:
        model, settings = self._object, self._settings
        estimator = settings.new_estimator(model.support_points)
        recognizer = Recognizer(model.hypotheses, settings.estimator) if model.hypotheses else None
        self._online = OnlineEstimation(model.outline, estimator, settings.region.region_margin, recognizer, self._refuse)
        self._publications.begin(model, self._online)
        self._model_publication.begin(model, self._online)

    def _settings_now(self) -> EstimatorSettings:
        return dataclasses.replace(self._settings, excluded=tuple(sorted(self._excluded)))

    def _on_input(self, topic: str, msg: Any) -> None:
        clock = self.get_clock()
        received = None if clock.ros_time_is_active else clock.now().nanoseconds  # a replay's clock says nothing of delays
        if self._resumption is not None:
            self._resumption.hold(topic, msg, received)
        elif self._take_input(topic, msg, received) and topic == "object_pose":
            self._transforms.broadcast(object_transform(msg))

    def _take_input(self, topic: str, msg: Any, received: int | None) -> bool:
        """Make observations from a message of a topic or of the bag; return whether the message was valid."""
        try:
            if topic == PLAN:
                self._plan.take(msg)
            elif topic == "wrench":
                self._take(self._maker.add_force(force_sample_from_msg(msg)))
            elif topic == "object_pose":
                self._take(self._maker.add_pose(pose_sample_from_msg(msg), received))
            else:
                self._take(self._maker.add_pusher(pusher_sample_from_msg(msg), received))
                self._pushing = msg.push_id != PusherState.NO_PUSH
        except ValueError as error:
            self._refused_messages[KINDS[topic]] += 1
            self._refuse(topic, error)
            return False
        return True

    def _on_observation(self, msg: ObservationMsg) -> None:
        try:
            observation = observation_from_msg(msg)
            observation.check_contact(self._object.outline)
        except (ValueError, PushfricError) as error:
            self._refused_messages[OBSERVATIONS] += 1
            self._refuse("observation", error)
        else:
            self._take([observation])

    def _take(self, observations: list[Observation]) -> None:
        for observation in observations:
            self._made.append(observation)
            used = observation.push_id not in self._excluded
            if self._resumption is not None:
                if used:
                    self._online.learn(observation)
                if (observation.push_id, observation.stamp) not in self._resumption.published:
                    self._tell(observation)
                continue
            used = used and self._online.take(observation)
            if used:
                self._publications.publish_estimate(self._judge(), at_rest=False)
            self._tell(observation)
            if used:
                self._follow_up(observation)

    def _follow_up(self, observation: Observation) -> None:
        """Publish what planners do not wait for, after the estimate with a new observation."""
        self._online.narrow(observation)
        self._publications.publish_region()
        if self._online.recognize(observation):
            self._publications.publish_ranking()

    def _tell(self, observation: Observation) -> None:
        """Publish an observation that was made here."""
        if self._observations_out is not None:
            self._observations_out.publish(observation_to_msg(observation, self._object.name))

    def _judge(self) -> Verdict:
        """The verdict on the estimate; the log says once that observations contradict each other, or why."""
        self._verdict = self._online.verdict()
        problem = None
        if self._online.estimate is not None and self._online.estimate.contradiction is not None:
            problem = "; ".join(map(str, self._verdict.reasons))
            if self._problem is None:
                self.get_logger().error(problem)
        self._problem = problem
        return self._verdict

    def _publish_settings(self) -> None:
        self._settings_out.publish(String(data=self._settings_now().to_text()))

    def _publish_start(self) -> None:
        msg = EstimationStart(object=self._chosen)
        msg.header.stamp, msg.header.frame_id = self.get_clock().now().to_msg(), OBJECT
        if self._resumption is not None:
            msg.header.stamp = stamp_to_msg(stamp_from_msg(self._resumption.start.header.stamp))
            msg.continuation = self._resumption.continuation
        self._start_out.publish(msg)

    def _start_afresh(self, chosen: str) -> None:
        load_object(chosen)  # what cannot be loaded changes nothing
        if self._resumption is not None:  # the rest of the bag no longer counts
            self._catch_up_timer.cancel()
            self._resumption = None
        self._begin(chosen)
        self._publish_settings()
        self._publish_start()
        if self._online.estimate is None:
            self._publications.publish_nothing()
        self._publications.publish_all(self._judge())
        self._model_publication.publish(self._verdict)

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

    def _on_exclude_push(self, request: SelectPush.Request, response: SelectPush.Response) -> SelectPush.Response:
        try:
            left = self._online.exclude(request.push_id)
        except ValueError as error:
            response.message = str(error)
            return response
        self._excluded.add(request.push_id)  # also its observations that are still to come
        response.success = True
        response.message = f"left: {data_of(left.data_points, left.pushes)}"
        self._show_again()
        return response

    def _on_keep_push(self, request: SelectPush.Request, response: SelectPush.Response) -> SelectPush.Response:
        ids = tuple(sorted({*self._settings.kept, request.push_id}))
        self._settings = dataclasses.replace(self._settings, kept=ids)
        if request.push_id in self._excluded:  # all again, in the order in which a bag has them
            self._excluded.remove(request.push_id)
            self._estimate_anew()
            for observation in self._made:
                if observation.push_id not in self._excluded:
                    self._online.learn(observation)
        kept = self._online.keep(request.push_id)
        response.success = True
        response.message = f"kept: {data_of(kept.data_points, kept.pushes)} are in"
        self._show_again()
        return response

    def _show_again(self) -> None:
        """Publish what has changed because other pushes are left out."""
        self._publish_settings()
        verdict = self._judge()
        self._publications.publish_region()
        if self._online.estimate is None:
            self._publications.publish_nothing()
        else:
            self._publications.publish_estimate(verdict)
        if self._online.ranking is not None:
            self._publications.publish_ranking()
        self._model_publication.publish(verdict)
        self._publish_progress()  # before the answer: a run may end with it

    def _at_rest(self) -> None:
        """Publish what takes longer than an observation may wait, for an estimate that stays for a while."""
        estimate, now = self._online.estimate, time.monotonic()
        if self._previous is not estimate:
            self._previous, self._changed = estimate, now
            return
        if self._steady is estimate or (self._pushing and now - self._changed < QUIET):
            return
        self._steady = estimate
        self._settling = self._settle()
        self._settle_on()

    def _settle(self) -> Generator[None, None, None]:
        """Publish what rests on all observations; pauses after each step."""
        complete, rejected = self._publications.complete, self._verdict.rejected
        if not complete or not self._online.settled:
            yield from self._online.settling()
            self._previous = self._steady = self._online.estimate
            said = self._verdict
            if self._judge() != said or not complete:
                self._publications.publish_estimate(self._verdict)
            if self._verdict.rejected != rejected:
                self._publications.publish_region()
                self._publications.publish_ranking()
        self._model_publication.publish(self._verdict)

    def _settle_on(self) -> None:
        """Do a step of it, unless the estimate has changed meanwhile; messages that have come get their turn in between."""
        if self._settling is None or self._online.estimate is not self._steady:
            self._settling = None
            return
        try:
            next(self._settling)
        except StopIteration:
            self._settling = None
        else:
            self._more.trigger()

    def _on_clock_jump(self, jump: TimeJump) -> None:
        self.get_logger().warning(f"the clock jumped back by {-jump.delta.nanoseconds / 1e9:.3f} s: estimation starts again")
        self._start_afresh(self._chosen)

    def _report(self) -> None:
        self._publish_progress()
        self._publications.draw()
        self._at_rest()

    def _publish_progress(self) -> None:
        """Publish the time up to which all poses have become observations, and whether these are judged, if it has changed."""
        settled, judged = self._maker.settled, self._online.settled
        newest = self._online.estimate.stamp if self._online.estimate is not None else 0
        if (settled, newest, judged) != self._last_progress:
            self._last_progress = settled, newest, judged
            msg = EstimatorProgress(settled_until=stamp_to_msg(settled), judged=judged)
            msg.header.stamp, msg.header.frame_id = stamp_to_msg(newest), OBJECT
            self._progress_out.publish(msg)

    def _ledger(self) -> Ledger:
        """The account of every message so far."""
        ledger = self._maker.ledger(self._plan.planned, ended=False)
        for kind, number in self._refused_messages.items():
            ledger.accounts[kind].enter(REFUSED, number)
        ledger.doubt_refused()
        used = Counter(one.push_id for one in self._online.observations)
        made = Counter(one.push_id for one in self._made)
        self._plan.doubt_empty(ledger, made, self._maker.settled)
        rejected = {one.push_id for one in self._verdict.rejected}
        ledger.settle(made, used, self._excluded, rejected, self._plan.started, self._plan.aborted)
        return ledger

    def _health(self) -> Health:
        values = {"object": self._object.name, "refused": self._refused, "observations": 0}
        if (estimate := self._online.estimate) is not None:
            solution = estimate.solution
            values |= {
                "observations": estimate.data_points,
                "fit error": solution.objective,
                "fit error per observation": solution.objective / estimate.data_points,
                "gap": solution.gap,
                "status": estimate.status.value,
            }
        ledger = self._ledger()
        values |= {kind: ", ".join(f"{n} {reason}" for reason, n in sums.items()) for kind, sums in ledger.sums().items()}
        if ledger.lines:
            values["doubts"] = "; ".join(ledger.lines)
        for doubt in ledger.doubts:
            if (doubt.code, doubt.stamp) not in self._noted:
                self.get_logger().warning(doubt.text)
                self._noted.add((doubt.code, doubt.stamp))
        if self._maker.waiting is not None:
            values["observations without their force yet"] = self._maker.waiting
        if self._resumption is not None:
            return Health(Level.WARN, f"goes on from {self._bag}", values)
        # a cell of another kind has no plan
        if silent := [topic for topic in without_publisher(self) if not topic.endswith(f"/{PLAN}")]:
            return Health(Level.WARN, f"no publisher of {', '.join(silent)}", values)
        if self._problem is not None:
            return Health(Level.ERROR, self._problem, values)
        if self._maker.skew > LONGEST_END_SKEW:
            ahead = f"the poses are stamped {self._maker.skew:.0f} s ahead of the pusher states: no observation can be made"
            return Health(Level.WARN, ahead, values)
        if self._maker.contradiction is not None:
            return Health(Level.WARN, self._maker.contradiction, values)
        if (apart := self._maker.apart) is not None:
            return Health(Level.WARN, tip_stays_away(apart), values)
        if ledger.doubts:
            return Health(Level.WARN, max(ledger.doubts, key=lambda one: one.stamp).text, values)
        if not self._verdict.use:
            # nobody need act while the first pushes are made
            begun = [one.code for one in self._verdict.reasons] == ["few_pushes"]
            return Health(Level.OK if begun else Level.WARN, "; ".join(map(str, self._verdict.reasons)), values)
        if self._verdict.notes:
            return Health(Level.WARN, "; ".join(map(str, self._verdict.notes)), values)
        if self._verdict.rejected:
            words = "; ".join(f"push {one.push_id} is left out: {one.reason}" for one in self._verdict.rejected)
            return Health(Level.OK, words, values)
        return Health(Level.OK, "estimating" if estimate is not None else "waiting for observations", values)


def main() -> None:
    run_node(EstimatorNode)
