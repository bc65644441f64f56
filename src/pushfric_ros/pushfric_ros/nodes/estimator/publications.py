"""The estimator node's publications: each is latched, so that a late subscriber gets the last one."""

from typing import TYPE_CHECKING

from geometry_msgs.msg import PointStamped
from rclpy.node import Node
from std_msgs.msg import String
from visualization_msgs.msg import Marker, MarkerArray

from pushfric_core.bags.samples import stamp_from_msg
from pushfric_core.estimation.estimate import Estimate
from pushfric_core.estimation.estimate_report import BoundsReport, EstimateReport
from pushfric_core.files.estimator_settings import START_TOPIC
from pushfric_core.files.estimator_settings import TOPIC as SETTINGS_TOPIC
from pushfric_core.geometry.planar import OBJECT
from pushfric_core.mechanics.prediction import FrictionModel as Belief
from pushfric_msgs.msg import (
    CenterOfFrictionRegion,
    ContactFriction,
    EstimationStart,
    EstimatorProgress,
    FrictionEstimate,
    FrictionModel,
    Recognition,
    SupportFriction,
)
from pushfric_ros.messages.conversions import (
    MODEL_TOPIC,
    estimate_to_msg,
    friction_model_to_msg,
    nothing_known,
    recognition_to_msg,
    region_to_msg,
    stamp_to_msg,
)
from pushfric_ros.messages.markers import estimate_to_markers, region_to_markers
from pushfric_ros.node_kit.diagnostics import Diagnostics
from pushfric_ros.node_kit.qos import LATCHED
from pushfric_ros.nodes.estimator.estimation import LiveEstimation

if TYPE_CHECKING:
    from pushfric_core.bags.resumption import Resumption

MANY = 1000
"""Up to so many observations, what is said of mu_c rests on all; then it lags by one, two, ...: its cost does not grow."""


class Publications:
    """The topics of an estimate, of an object whose estimation has begun.

    Args:
        topics: of the node.
    """

    def __init__(self, topics: Diagnostics) -> None:
        self._estimate_out = topics.advertise(FrictionEstimate, "friction_estimate", LATCHED)
        self._support_friction_out = topics.advertise(SupportFriction, "support_friction", LATCHED)
        self._center_of_friction_out = topics.advertise(PointStamped, "center_of_friction", LATCHED)
        self._contact_friction_out = topics.advertise(ContactFriction, "contact_friction", LATCHED)
        self._recognition_out = topics.advertise(Recognition, "recognition", LATCHED)
        self._markers_out = topics.advertise(MarkerArray, "markers", LATCHED)
        self._region_out = topics.advertise(CenterOfFrictionRegion, "center_of_friction_region", LATCHED)
        self._model_out = topics.advertise(FrictionModel, MODEL_TOPIC, LATCHED)

    def begin(self, now: LiveEstimation) -> None:
        """Publish this estimation from now on; nothing is published yet."""
        self._now = now
        self._bounds: BoundsReport | None = None  # the last ones on mu_c
        self._belief: Belief | None = None  # of the last estimate that was at rest
        self._believed = 0  # number of observations that it rests on
        self._region = CenterOfFrictionRegion()
        self._undrawn: FrictionEstimate | None = None  # published, but not drawn yet
        self._modelled: Estimate | None = None  # the estimate whose model was published

    @property
    def complete(self) -> bool:
        """Whether all that was published last rests on all observations."""
        estimate = self._now.online.estimate
        if self._bounds is None or estimate is None:
            return True
        return self._bounds.data_points == self._believed == estimate.data_points

    def publish_all(self) -> None:
        """Judge the estimate, and publish all that is known."""
        self._now.judge()
        self.publish_region()
        if self._now.online.estimate is not None:
            self.publish_estimate()
        if self._now.online.ranking is not None:
            self.publish_ranking()

    def publish_estimate(self, at_rest: bool = True) -> None:
        """Publish w, p_CF and mu_c of the estimate, which has been judged.

        Args:
            at_rest: no observation followed it at once.
        """
        now = self._now
        estimate = now.online.estimate
        assert estimate is not None
        if at_rest:
            self._belief, self._believed = estimate.belief, estimate.data_points
        bounds = self._bounds
        held = 0 if bounds is None else estimate.data_points - bounds.data_points
        if bounds is None or at_rest or not 0 <= held <= estimate.data_points // MANY:
            slipping = now.settings.slipping
            slips = [observation.push_id in slipping for observation in (now.online.observations if slipping else ())]
            bounds = self._bounds = BoundsReport.of(estimate, slips)
        report = EstimateReport.of(estimate, now.object.name, self._belief, (), now.verdict, bounds, self._believed)
        msg = estimate_to_msg(report)
        # w, p_CF and mu_c have no status of their own
        self._publish(msg, msg if now.online.usable else nothing_known(now.object.name))

    def publish_nothing(self) -> None:
        """Publish that nothing is known: without observations, nothing that was published before is valid any longer."""
        self.begin(self._now)
        msg = nothing_known(self._now.object.name)
        self._publish(msg, msg)
        self._recognition_out.publish(Recognition())

    def publish_region(self) -> None:
        """Publish where p_CF can lie by the half-planes, and what to push next."""
        online, name = self._now.online, self._now.object.name
        stamp = online.estimate.stamp if online.estimate is not None else 0
        self._region = region_to_msg(online.region(), online.next_pushes(), online.slip_pushes(), stamp, name)
        self._region_out.publish(self._region)

    def publish_ranking(self) -> None:
        """Publish how well each hypothesis about the object fits."""
        ranking = self._now.online.ranking
        ranked = recognition_to_msg(ranking) if ranking is not None and ranking.data_points else Recognition()
        self._recognition_out.publish(ranked)

    def publish_model(self) -> None:
        """Publish the model of the estimate, which has been judged, unless that has been done."""
        now, estimate = self._now, self._now.online.estimate
        if estimate is not None and estimate is self._modelled:
            return
        model = estimate.belief if estimate is not None and now.online.usable else None
        self._model_out.publish(friction_model_to_msg(now.object.name, now.object.outline, estimate, model, now.verdict))
        self._modelled = estimate

    def draw(self) -> None:
        """Publish what RViz and the like draw of the last estimate and region, unless that was done or nobody looks."""
        msg = self._undrawn
        if msg is None or not self._markers_out.get_subscription_count():
            return
        self._undrawn = None
        if msg.status in (msg.STATUS_NO_DATA, msg.STATUS_INFEASIBLE):
            self._markers_out.publish(MarkerArray(markers=[Marker(action=Marker.DELETEALL)]))
            return
        outline, newest = self._now.object.outline, self._now.online.newest
        assert newest is not None
        markers = estimate_to_markers(msg, outline, newest)
        markers.markers += region_to_markers(self._region, outline)
        self._markers_out.publish(markers)

    def _publish(self, msg: FrictionEstimate, usable: FrictionEstimate) -> None:
        """Publish an estimate, and by themselves the parts of one that may be used."""
        self._estimate_out.publish(msg)
        self._support_friction_out.publish(usable.support_friction)
        self._center_of_friction_out.publish(PointStamped(header=usable.header, point=usable.center_of_friction))
        self._contact_friction_out.publish(usable.contact_friction)
        self._undrawn = msg


class Announcements:
    """The topics that say what is estimated, by which settings, and how far that has come.

    Args:
        node: the estimator's.
        topics: of the node.
    """

    def __init__(self, node: Node, topics: Diagnostics) -> None:
        self._clock = node.get_clock()
        self._settings_out = topics.advertise(String, SETTINGS_TOPIC, LATCHED)
        self._start_out = topics.advertise(EstimationStart, START_TOPIC, LATCHED)
        self._progress_out = topics.advertise(EstimatorProgress, "estimator_progress", LATCHED)
        self._last: tuple[int, int, int, bool] | None = None  # what the last report of progress said

    def settings(self, now: LiveEstimation) -> None:
        """Publish by which settings anything is estimated."""
        self._settings_out.publish(String(data=now.settings.to_text()))

    def start(self, now: LiveEstimation, resumption: "Resumption | None") -> None:
        """Publish that an estimation starts, or goes on from the bag of an earlier one."""
        msg = EstimationStart(object=now.chosen)
        msg.header.stamp, msg.header.frame_id = self._clock.now().to_msg(), OBJECT
        if resumption is not None:
            msg.header.stamp = stamp_to_msg(stamp_from_msg(resumption.start.header.stamp))
            msg.continuation = resumption.continuation
        self._start_out.publish(msg)

    def progress(self, now: LiveEstimation) -> None:
        """Publish the time up to which all poses have become observations, and whether these are judged, if it has changed."""
        estimate = now.online.estimate
        newest, data_points = (estimate.stamp, estimate.data_points) if estimate is not None else (0, 0)
        state = now.maker.settled, newest, data_points, now.online.settled
        if state != self._last:
            self._last = state
            msg = EstimatorProgress(data_points=data_points, judged=now.online.settled)
            msg.settled_until = stamp_to_msg(now.maker.settled)
            msg.header.stamp, msg.header.frame_id = stamp_to_msg(newest), OBJECT
            self._progress_out.publish(msg)
