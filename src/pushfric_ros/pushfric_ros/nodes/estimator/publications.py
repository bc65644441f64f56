"""The estimator node's publications: each is latched, so that a late subscriber gets the last one."""

from collections.abc import Collection

from geometry_msgs.msg import PointStamped
from visualization_msgs.msg import Marker, MarkerArray

from pushfric_core.estimation.estimate import Estimate
from pushfric_core.estimation.estimate_report import BoundsReport, EstimateReport
from pushfric_core.estimation.online_estimation import OnlineEstimation
from pushfric_core.estimation.verdict import Verdict
from pushfric_core.files.object_file import ObjectModel
from pushfric_core.mechanics.prediction import FrictionModel as Belief
from pushfric_msgs.msg import (
    CenterOfFrictionRegion,
    ContactFriction,
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
)
from pushfric_ros.messages.markers import estimate_to_markers, region_to_markers
from pushfric_ros.node_kit.diagnostics import Diagnostics
from pushfric_ros.node_kit.qos import LATCHED

MANY = 1000
"""Up to so many observations, what is said of mu_c rests on all; then it lags by one, two, ...: its cost does not grow."""


class Publications:
    """The topics of an estimate, of an object whose estimation has begun.

    Args:
        topics: of the node.
        slipping: pushes known to slip.
    """

    def __init__(self, topics: Diagnostics, slipping: Collection[int]) -> None:
        self._slipping = slipping
        self._estimate_out = topics.advertise(FrictionEstimate, "friction_estimate", LATCHED)
        self._support_friction_out = topics.advertise(SupportFriction, "support_friction", LATCHED)
        self._center_of_friction_out = topics.advertise(PointStamped, "center_of_friction", LATCHED)
        self._contact_friction_out = topics.advertise(ContactFriction, "contact_friction", LATCHED)
        self._recognition_out = topics.advertise(Recognition, "recognition", LATCHED)
        self._markers_out = topics.advertise(MarkerArray, "markers", LATCHED)
        self._region_out = topics.advertise(CenterOfFrictionRegion, "center_of_friction_region", LATCHED)

    def begin(self, model: ObjectModel, online: OnlineEstimation) -> None:
        """Publish the estimation of this object from now on; nothing is published yet."""
        self._object, self._online = model, online
        self._bounds: BoundsReport | None = None  # the last ones on mu_c
        self._belief: Belief | None = None  # of the last estimate that was at rest
        self._believed = 0  # number of observations that it rests on
        self._region = CenterOfFrictionRegion()
        self._undrawn: FrictionEstimate | None = None  # published, but not drawn yet

    @property
    def complete(self) -> bool:
        """Whether all that was published last rests on all observations."""
        estimate = self._online.estimate
        if self._bounds is None or estimate is None:
            return True
        return self._bounds.data_points == self._believed == estimate.data_points

    def publish_all(self, verdict: Verdict) -> None:
        """Publish all that is known."""
        self.publish_region()
        if self._online.estimate is not None:
            self.publish_estimate(verdict)
        if self._online.ranking is not None:
            self.publish_ranking()

    def publish_estimate(self, verdict: Verdict, at_rest: bool = True) -> None:
        """Publish w, p_CF and mu_c.

        Args:
            verdict: on the estimate; there is one.
            at_rest: no observation followed it at once.
        """
        estimate = self._online.estimate
        assert estimate is not None
        if at_rest:
            self._belief, self._believed = estimate.belief, estimate.data_points
        bounds = self._bounds
        held = 0 if bounds is None else estimate.data_points - bounds.data_points
        if bounds is None or at_rest or not 0 <= held <= estimate.data_points // MANY:
            observations = self._online.observations if self._slipping else ()
            slips = [observation.push_id in self._slipping for observation in observations]
            bounds = self._bounds = BoundsReport.of(estimate, slips)
        report = EstimateReport.of(estimate, self._object.name, self._belief, (), verdict, bounds, self._believed)
        msg = estimate_to_msg(report)
        self._estimate_out.publish(msg)
        # w, p_CF and mu_c have no status of their own
        self._parts(msg if self._online.usable else nothing_known(self._object.name))
        self._undrawn = msg

    def publish_nothing(self) -> None:
        """Publish that nothing is known: without observations, nothing that was published before is valid any longer."""
        msg = nothing_known(self._object.name)
        self._estimate_out.publish(msg)
        self._parts(msg)
        self._undrawn = msg
        self._recognition_out.publish(Recognition())

    def publish_region(self) -> None:
        """Publish where p_CF can lie by the half-planes, and what to push next."""
        stamp = self._online.estimate.stamp if self._online.estimate is not None else 0
        online = self._online
        self._region = region_to_msg(online.region(), online.next_pushes(), online.slip_pushes(), stamp, self._object.name)
        self._region_out.publish(self._region)

    def publish_ranking(self) -> None:
        """Publish how well each hypothesis about the object fits."""
        ranking = self._online.ranking
        self._recognition_out.publish(
            Recognition() if ranking is None or not ranking.data_points else recognition_to_msg(ranking)
        )

    def draw(self) -> None:
        """Publish what RViz and the like draw of the last estimate and region, unless that was done or nobody looks."""
        msg = self._undrawn
        if msg is None or not self._markers_out.get_subscription_count():
            return
        self._undrawn = None
        if msg.status in (msg.STATUS_NO_DATA, msg.STATUS_INFEASIBLE):
            self._markers_out.publish(MarkerArray(markers=[Marker(action=Marker.DELETEALL)]))
            return
        assert self._online.newest is not None
        markers = estimate_to_markers(msg, self._object.outline, self._online.newest)
        markers.markers += region_to_markers(self._region, self._object.outline)
        self._markers_out.publish(markers)

    def _parts(self, msg: FrictionEstimate) -> None:
        self._support_friction_out.publish(msg.support_friction)
        self._center_of_friction_out.publish(PointStamped(header=msg.header, point=msg.center_of_friction))
        self._contact_friction_out.publish(msg.contact_friction)


class ModelPublication:
    """Publishes the model of the present estimate; it is latched, so that a late planner gets the last one.

    Args:
        topics: of the node.
    """

    def __init__(self, topics: Diagnostics) -> None:
        self._out = topics.advertise(FrictionModel, MODEL_TOPIC, LATCHED)

    def begin(self, model: ObjectModel, online: OnlineEstimation) -> None:
        """Publish the models of this object from now on; nothing is published yet."""
        self._object, self._online = model, online
        self._published: Estimate | None = None

    def publish(self, verdict: Verdict) -> None:
        """Publish the model of the estimate on which this is the verdict, unless that has been done."""
        estimate = self._online.estimate
        if estimate is not None and estimate is self._published:
            return
        model = estimate.belief if estimate is not None and self._online.usable else None
        self._out.publish(friction_model_to_msg(self._object.name, self._object.outline, estimate, model, verdict))
        self._published = estimate
