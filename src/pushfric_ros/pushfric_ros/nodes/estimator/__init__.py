"""The estimator node: poses and pusher states -> observations -> w, p_CF and mu_c after every observation."""

import dataclasses
import pathlib
from collections.abc import Callable, Generator, Iterable
from functools import partial
from typing import TYPE_CHECKING, Any

from geometry_msgs.msg import PoseWithCovarianceStamped, WrenchStamped
from rclpy.clock import JumpThreshold, TimeJump
from rclpy.duration import Duration
from rclpy.node import Node
from std_srvs.srv import Trigger

from pushfric_core.bags.contents import mcap_file
from pushfric_core.bags.run_record import PLAN
from pushfric_core.belief.symptoms import tip_stays_away
from pushfric_core.cell.node_settings import EstimatorInput, EstimatorNodeConfig, FrameConfig, ModelConfig, ObjectConfig
from pushfric_core.errors import InvalidInput, UninformativePush
from pushfric_core.estimation.estimate_report import EstimateReport
from pushfric_core.files.estimator_settings import EstimatorSettings
from pushfric_core.files.model_file import check_name, make_model, prior, save_model
from pushfric_core.files.object_file import load_object
from pushfric_core.geometry.planar import Twist
from pushfric_core.trajectories.observation import Observation
from pushfric_core.trajectories.stream import LONGEST_END_SKEW
from pushfric_core.wording import data_of
from pushfric_msgs.msg import Observation as ObservationMsg
from pushfric_msgs.msg import PlanProgress, PusherState
from pushfric_msgs.srv import SelectObject, SelectPush
from pushfric_ros.messages.conversions import estimate_to_msg, observation_to_msg
from pushfric_ros.node_kit.diagnostics import Diagnostics, Health, Level, without_publisher
from pushfric_ros.node_kit.heartbeat import Heartbeat
from pushfric_ros.node_kit.parameters import declare
from pushfric_ros.node_kit.process import run_node
from pushfric_ros.node_kit.qos import LATCHED_QUEUE, RELIABLE, SENSOR_QUEUE
from pushfric_ros.node_kit.required_subscribers import RequiredSubscribers
from pushfric_ros.node_kit.timers import wall_timer
from pushfric_ros.node_kit.transforms import TransformBroadcaster, object_transform
from pushfric_ros.nodes.estimator.estimation import LiveEstimation
from pushfric_ros.nodes.estimator.publications import Announcements, Publications
from pushfric_ros.nodes.estimator.rest import RestWatch

if TYPE_CHECKING:
    from pushfric_core.bags.resumption import Resumption

CATCHES_UP = "the estimator still goes on from the bag: ask again"
"""A choice would be replaced by those made before it died."""

PROGRESS_PERIOD = 0.05
"""Time between reports of how far the estimator has come, between drawings, between looks for rest, and, while a restarted
estimator catches up, between reads of the bag, in wall time [s]."""


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
        self._resumption = self._interrupted()
        topics = Diagnostics(self, self._health, prefix)
        self._publications = Publications(topics)
        self._announcements = Announcements(self, topics)
        if self._resumption is None:
            self._begin(model.object, 0)
        else:
            self._begin(self._resumption.start.object)
        self._rehearse()
        self._observations_out = self._recorder = None
        Heartbeat(self)
        if config.source is EstimatorInput.OBSERVATIONS:
            topics.subscribe(ObservationMsg, "observation", self._on_observation, RELIABLE)
        else:
            self._observations_out = topics.advertise(ObservationMsg, "observation", RELIABLE)
            self._recorder = RequiredSubscribers(self, self._observations_out, ["recorder"])
            self._transforms = TransformBroadcaster(self, prefix)
            for kind, topic in ((PoseWithCovarianceStamped, "object_pose"), (PusherState, "pusher_state")):
                topics.subscribe(kind, topic, partial(self._on_input, topic), RELIABLE)
            self.create_subscription(PlanProgress, PLAN, partial(self._on_input, PLAN), LATCHED_QUEUE)
            if self._settings.with_forces:
                topics.subscribe(WrenchStamped, "wrench", partial(self._on_input, "wrench"), SENSOR_QUEUE)
        self._rest = RestWatch(self, lambda: self._now.online.estimate, self._settle)
        wall_timer(self, PROGRESS_PERIOD, self._report)
        self._announcements.start(self._now, self._resumption)
        if self._resumption is None:
            self._announcements.settings(self._now)
        else:
            self.get_logger().warning(f"goes on from {self._bag}")
        self._publications.publish_all()
        self._publications.publish_model()
        self.create_service(Trigger, "~/reset", partial(self._on_choice, self._reset))
        self.create_service(SelectObject, "~/select_object", partial(self._on_choice, self._select_object))
        self.create_service(SelectPush, "~/exclude_push", partial(self._on_choice, self._exclude))
        self.create_service(SelectPush, "~/keep_push", partial(self._on_choice, self._keep))
        # time that runs backwards means another run of the cell or a bag, whose data must not be mixed with earlier data
        backwards = JumpThreshold(min_forward=None, min_backward=Duration(nanoseconds=-1), on_clock_change=False)
        self._jump = self.get_clock().create_jump_callback(backwards, post_callback=self._on_clock_jump)

    def destroy_node(self) -> None:
        """Write the model that is to be kept, and destroy the node.

        The model of another object than this one never takes the place of the one that the estimate went on from.

        Raises:
            InvalidInput: the model cannot be written.
        """
        now, models = self._now, self._models
        try:
            if models.save and now.chosen != self._initial and models.save == models.model:
                self.get_logger().warning(f"{models.save} stays as it was: it is not the model of {now.object.name}")
            elif models.save and now.online.usable:
                assert now.online.estimate is not None
                made_from = self._bag or self.get_fully_qualified_name()
                save_model(make_model(now.object, now.online.estimate, made_from, now.settings), pathlib.Path(models.save))
        finally:
            super().destroy_node()

    def _rehearse(self) -> None:
        """Load what an estimate needs now, not with the first observation: the solver, and what works when it is first used."""
        pushed = Observation((0.0, 0.0), (1.0, 0.0), Twist(-0.01, 0.0, 0.0), tip_velocity=(-0.01, 0.0))
        estimate = self._settings.new_estimator(self._now.object.support_points).add(pushed)
        estimate_to_msg(EstimateReport.of(estimate, "", None))

    def _interrupted(self) -> "Resumption | None":
        """The remains of an estimator that died in this run; None if this is the run's first estimator."""
        if not self._bag or not mcap_file(pathlib.Path(self._bag)).exists():
            return None
        from pushfric_core.bags.resumption import Resumption  # imported late: few estimators need to read bags

        inputs = ("object_pose", "pusher_state", *["wrench"] * self._settings.with_forces)
        resumption = Resumption(pathlib.Path(self._bag), self.get_namespace(), inputs)
        return None if resumption.start is None else resumption

    def _catch_up(self, resumption: "Resumption") -> None:
        """Take the messages of the bag; once it holds all earlier ones, take those that came by topic meanwhile."""
        if self._recorder is not None and self._recorder.missing:
            return
        heard, found, before = resumption.heard, resumption.read_on(), self._now.online.estimate
        if found is None:
            return
        if not heard:  # with the earlier estimator, whose last messages are known only now
            self._begin(resumption.start.object)
            self._announcements.settings(self._now)
            self._announcements.start(self._now, resumption)
        held = resumption.held
        for each in (*found, *(held or ())):
            self._take_input(*each)
        if self._now.online.estimate is not before:
            self._publications.publish_all()
        if held is not None:
            self._resumption = None
            estimate = self._now.online.estimate
            known = "no observations" if estimate is None else data_of(estimate.data_points, estimate.pushes)
            self.get_logger().warning(f"has gone on from the bag with {known}; the topics lead from here")

    def _begin(self, chosen: str, first: int | None = None, without: Iterable[int] = ()) -> None:
        """Start a new estimate of an object, given by its name or file, without these pushes; the first as of `PlanRecord`."""
        settings = self._settings
        if self._resumption is not None and (last := self._resumption.settings) is not None:
            self._settings = dataclasses.replace(settings, kept=last.kept)
            settings = dataclasses.replace(self._settings, excluded=last.excluded)
        # what cannot be loaded changes nothing
        self._now = LiveEstimation(chosen, settings.without(without), self.get_logger(), first)
        for observation in self._prior if chosen == self._initial else ():
            self._now.learn(observation)
        self._publications.begin(self._now)

    def _on_input(self, topic: str, msg: Any) -> None:
        clock = self.get_clock()
        received = None if clock.ros_time_is_active else clock.now().nanoseconds  # a replay's clock says nothing of delays
        if self._resumption is not None:
            self._resumption.hold(topic, msg, received)
        elif self._take_input(topic, msg, received) and topic == "object_pose":
            self._transforms.broadcast(object_transform(msg))

    def _on_observation(self, msg: ObservationMsg) -> None:
        self._take_input("observation", msg, None)

    def _take_input(self, topic: str, msg: Any, received: int | None) -> bool:
        """Make observations from a message of a topic or of the bag; return whether the message was valid."""
        try:
            self._take(self._now.observations(topic, msg, received))
        except (ValueError, UninformativePush) as error:
            self._now.refuse_message(topic, error)
            return False
        if topic == "pusher_state":
            self._rest.pushing = msg.push_id != PusherState.NO_PUSH
        return True

    def _take(self, observations: list[Observation]) -> None:
        for observation in observations:
            if self._resumption is not None:
                self._now.learn(observation)
                if (observation.push_id, observation.stamp) not in self._resumption.published:
                    self._tell(observation)
                continue
            if used := self._now.take(observation):
                self._now.judge()
                self._publications.publish_estimate(at_rest=False)
            self._tell(observation)
            if used:  # planners do not wait for the rest
                self._now.online.narrow(observation)
                self._publications.publish_region()
                if self._now.online.recognize(observation):
                    self._publications.publish_ranking()

    def _tell(self, observation: Observation) -> None:
        """Publish an observation that was made here."""
        if self._observations_out is not None:
            self._observations_out.publish(observation_to_msg(observation, self._now.object.name))

    def _start_afresh(self, chosen: str, without: Iterable[int] = ()) -> None:
        self._begin(chosen, without=without)
        self._announcements.start(self._now, None)

    def _on_choice(self, choose: Callable[[Any], str], request: Any, response: Any) -> Any:
        """Carry out what a person chose, which gives the answer; the bag has it, so that it gives the same estimate."""
        if self._resumption is not None:
            response.message = CATCHES_UP
            return response
        try:
            response.message = choose(request)
        except (ValueError, InvalidInput) as error:
            response.message = str(error)
            return response
        response.success = True
        self._show_again()
        return response

    def _reset(self, _: Trigger.Request) -> str:
        self._now.leave_out(self._pushes_so_far())
        return f"estimation of {self._now.object.name} starts again"

    def _select_object(self, request: SelectObject.Request) -> str:
        self._start_afresh(request.object, self._pushes_so_far())
        answer = f"estimation of {self._now.object.name} starts"
        if self._prior:
            model, of = self._models.model, load_object(self._initial).name
            used = "goes on from" if self._now.chosen == self._initial else f"does not use the model of {of},"
            answer += f"; it {used} {model}"
            self.get_logger().warning(answer)
        return answer

    def _pushes_so_far(self) -> set[int]:
        """The pushes of this run, without those of the model that it went on from."""
        return self._now.pushes - {observation.push_id for observation in self._prior}

    def _exclude(self, request: SelectPush.Request) -> str:
        left = self._now.exclude(request.push_id)
        return f"left: {data_of(left.data_points, left.pushes)}"

    def _keep(self, request: SelectPush.Request) -> str:
        kept = self._now.keep(request.push_id)
        self._settings = dataclasses.replace(self._settings, kept=self._now.settings.kept)
        return f"kept: {data_of(kept.data_points, kept.pushes)} are in"

    def _show_again(self) -> None:
        """Publish what has changed because other pushes are left out, or all begins again."""
        self._announcements.settings(self._now)
        if self._now.online.estimate is None:
            self._publications.publish_nothing()
        self._publications.publish_all()
        self._publications.publish_model()
        self._announcements.progress(self._now)  # before the answer: a run may end with it

    def _settle(self) -> Generator[None, None, None]:
        """Publish what rests on all observations; pauses after each step."""
        now, complete, said = self._now, self._publications.complete, self._now.verdict
        if not complete or not now.online.settled:
            yield from now.online.settling()
            if now.judge() != said or not complete:
                self._publications.publish_estimate()
            if now.verdict.rejected != said.rejected:
                self._publications.publish_region()
                self._publications.publish_ranking()
        self._publications.publish_model()

    def _on_clock_jump(self, jump: TimeJump) -> None:
        self.get_logger().warning(f"the clock jumped back by {-jump.delta.nanoseconds / 1e9:.3f} s: estimation starts again")
        self._resumption = None  # the rest of a bag no longer counts
        self._start_afresh(self._now.chosen)
        self._show_again()

    def _report(self) -> None:
        if self._resumption is not None:
            self._catch_up(self._resumption)
        self._announcements.progress(self._now)
        self._publications.draw()
        self._rest.check()

    def _health(self) -> Health:
        now, seen, verdict = self._now, self._now.maker.trajectory, self._now.verdict
        values = {"object": now.object.name, "refused": now.refused, "observations": 0}
        if (estimate := now.online.estimate) is not None:
            solution = estimate.solution
            values["observations"], error = estimate.data_points, solution.objective
            values |= {"fit error": error, "fit error per observation": error / estimate.data_points}
            values |= {"gap": solution.gap, "status": estimate.status.value}
        ledger = now.ledger()
        values |= {kind: ", ".join(f"{n} {reason}" for reason, n in sums.items()) for kind, sums in ledger.sums().items()}
        if ledger.lines:
            values["doubts"] = "; ".join(ledger.lines)
        if (waiting := now.maker.waiting) is not None:
            values["observations without their force yet"] = waiting
        # a cell of another kind has no plan
        silent = [topic for topic in without_publisher(self) if not topic.endswith(f"/{PLAN}")]
        ahead = f"the poses are stamped {seen.skew:.0f} s ahead of the pusher states: no observation can be made"
        reasons, notes = ("; ".join(map(str, some)) for some in (verdict.reasons, verdict.notes))
        # nobody need act while the first pushes are made
        begun = [one.code for one in verdict.reasons] == ["few_pushes"]
        words: list[tuple[Level, str | None]] = [
            (Level.WARN, f"goes on from {self._bag}" if self._resumption is not None else ""),
            (Level.WARN, f"no publisher of {', '.join(silent)}" if silent else ""),
            (Level.ERROR, now.problem),
            (Level.WARN, ahead if seen.skew > LONGEST_END_SKEW else ""),
            (Level.WARN, seen.contradiction),
            (Level.WARN, tip_stays_away(seen.apart) if seen.apart is not None else ""),
            (Level.WARN, max(ledger.doubts, key=lambda one: one.stamp).text if ledger.doubts else ""),
            (Level.OK if begun else Level.WARN, reasons),
            (Level.WARN, notes),
            (Level.OK, "; ".join(f"push_id {one.push_id} is left out: {one.reason}" for one in verdict.rejected)),
            (Level.OK, "estimating" if estimate is not None else "waiting for observations"),
        ]
        return next(Health(level, text, values) for level, text in words if text)


def main() -> None:
    run_node(EstimatorNode)
