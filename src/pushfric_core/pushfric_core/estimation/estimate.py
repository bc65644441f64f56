"""The estimate of w, p_CF and mu_c that the estimator returns."""

from __future__ import annotations

import html
import importlib.util
import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from pushfric_core.belief.doubts import Rejected
from pushfric_core.belief.judge import Judgement, judging
from pushfric_core.errors import UninformativePush, extra
from pushfric_core.estimation.estimate_report import EstimateReport, center_line, contact_friction_line
from pushfric_core.estimation.verdict import Verdict, verdict_on
from pushfric_core.geometry.outline import Outline
from pushfric_core.geometry.planar import Array
from pushfric_core.geometry.support import center_of_friction
from pushfric_core.mechanics.prediction import FrictionModel, MuC
from pushfric_core.program import contact_friction
from pushfric_core.program.contact_friction import ContactForces, Tip
from pushfric_core.records import comparable
from pushfric_core.solvers.program import Optimum, Status
from pushfric_core.steps import finished
from pushfric_core.trajectories.observation import Observation
from pushfric_core.trajectories.observations import Observations
from pushfric_core.wording import Reason, data_of

if TYPE_CHECKING:
    import pandas


@comparable
@dataclass(frozen=True, repr=False)
class Estimate:
    """An estimate after the last observation; it never changes later.

    Attributes:
        support_points: (n, 2) [m], object frame.
        solution: w with its objective and certificate: the fit error [m, unit force]; with the loss l2 [m^2, unit force^2].
        data_points: number of observations used.
        pushes: number of pushes that they came from.
        stamp: of the newest observation [ns]; 0 if unknown.
        contact_forces: at each contact, of supports of unit weight, in order of arrival.
        conflicts: observations whose hard constraints contradict each other; empty unless the status is INFEASIBLE.
        center_given: the centre of friction is one of the hard constraints (eq. 13).
        lack: why the pushes do not show how far p_CF is off; None if they vary enough.
        tip: what was seen and measured of the pusher's tip at each contact.
        observations: those that it rests on; in order of arrival, except that those of a push that came back are the last.
        rejected: the pushes that are left out because the others contradict them, each with the reason.
        outline: of the object; None: the estimator does not know it.
        kept: pushes that are not left out, whatever speaks against them; None: all.
        useful_radius: if p_CF is not known to within this [m], the estimate is not to be used.
        judged: the judgement on all observations, those of rejected pushes, too; None: not all have been judged.

    Example:
        >>> from pushfric_core import Estimator, Observation, Twist
        >>> estimator = Estimator([(-0.05, 0.0), (0.05, 0.0)])
        >>> estimate = estimator.add(Observation((0.01, -0.03), (0.0, -1.0), Twist(0.0, 0.02, 0.1)))
        >>> estimate
        <Estimate: p_CF (10.00, 0.00) mm from 1 observation of 1 push, optimal>
        >>> print(str(estimate).splitlines()[0])
        p_CF   (10.00, 0.00) mm by the program
        >>> estimate.w.round(2).tolist(), estimate.verdict.use
        ([0.4, 0.6], False)
    """

    support_points: Array
    solution: Optimum
    data_points: int
    pushes: int
    stamp: int
    contact_forces: ContactForces
    conflicts: tuple[Observation, ...] = ()
    center_given: bool = False
    lack: Reason | None = None
    tip: Tip | None = None
    observations: Observations = field(default_factory=Observations, compare=False)
    rejected: tuple[Rejected, ...] = ()
    outline: Outline | None = field(default=None, compare=False)
    kept: Sequence[int] | None = field(default=(), compare=False)
    useful_radius: float = field(default=math.inf, compare=False)
    judged: Judgement | None = field(default=None, compare=False)

    @property
    def w(self) -> Array:
        """Support friction distribution (n,), >= 0, sum 1."""
        return self.solution.w

    @property
    def status(self) -> Status:
        """How far the solution can be trusted."""
        return self.solution.status

    @property
    def total_friction(self) -> float | None:
        """Support friction of the translating object [N], so that w times it is in newtons; None without measured forces."""
        return 1 / self.solution.scale if self.solution.scale > 0 else None

    @property
    def contradiction(self) -> str | None:
        """Which pushes contradict each other, in words; None if no pushes do."""
        if self.status is not Status.INFEASIBLE:
            return None
        pushes = sorted({observation.push_id for observation in self.conflicts})
        if not pushes:
            return "no w over the support points has the centre of friction that is asked for"
        given = " with the centre of friction that is asked for" if self.center_given else ""
        return f"no w{given} lets the pusher push (f.n >= 0) in all of the pushes with push_id {', '.join(map(str, pushes))}"

    @cached_property
    def center_of_friction(self) -> Array:
        """p_CF (2,) [m], object frame (eq. 3)."""
        return center_of_friction(self.support_points, self.w)

    @property
    def belief(self) -> FrictionModel | None:
        """The belief after the pushes, with its uncertainty, computed when it is first asked for.

        None without a push, or if the centre of friction is given. Its covariance is None if the pushes lack variety.
        """
        return self.judgement.belief

    @cached_property
    def judgement(self) -> Judgement:
        """The belief, and what speaks against the observations: computed when it is first asked for, unless all were judged."""
        found = self.judged or finished(judging(self.support_points, self.observations, self.kept))
        belief = None if self.center_given else found.belief
        if belief is not None and self.lack is not None:
            belief = replace(belief, covariance=None)
        return found._replace(belief=belief)

    @property
    def believed_center(self) -> Array:
        """The belief's p_CF (2,) [m]; that of the program as long as nothing is believed."""
        return self.center_of_friction if self.belief is None else self.belief.center_of_friction

    @property
    def confidence(self) -> float | None:
        """Radius about the belief's p_CF that holds the true one with a probability of 90 % [m]; None: it is not known."""
        return None if self.belief is None else self.belief.confidence

    @property
    def mu_c(self) -> MuC | None:
        """The contact friction coefficient with its interval, by the belief; None without observations."""
        return None if self.belief is None else self.belief.known_mu_c

    @cached_property
    def contact_friction(self) -> Array:
        """Lower bounds (m,) on mu_c, one for each observation (eq. 12)."""
        if self.tip is None:
            return contact_friction.lower_bounds(self.contact_forces, self.w)
        return self.tip.bounds(self.contact_forces, self.w)

    @property
    def mu_c_p90(self) -> float:
        """Value at or below which 90 % of the lower bounds lie."""
        return contact_friction.percentile(self.contact_friction, 0.9)

    @property
    def mu_c_max(self) -> float:
        """The largest of the lower bounds."""
        return contact_friction.percentile(self.contact_friction, 1.0)

    @property
    def verdict(self) -> Verdict:
        """Whether the estimate may be used: `use`, and `reasons` if not."""
        return verdict_on(self, self.judgement)

    def __str__(self) -> str:
        if not self.data_points:
            return f"no observations yet: any w over the {len(self.w)} support points is as good as another"
        figures = self.to_dict()
        rests_on = f"from   {data_of(self.data_points, self.pushes)}; {self.verdict}"
        return f"{center_line(figures)}\n{contact_friction_line(figures)}\n{rests_on}"

    def __repr__(self) -> str:
        x, y = 1e3 * self.center_of_friction
        return f"<Estimate: p_CF ({x:z.2f}, {y:z.2f}) mm from {data_of(self.data_points, self.pushes)}, {self.status.value}>"

    def to_dict(self, object_name: str = "") -> dict[str, Any]:
        """All numbers, named as in the JSON of `pushfric estimate --json`: SI units, object frame (docs/files.md).

        Args:
            object_name: the value of the key `object`.
        Raises:
            ValueError: the estimate rests on no observation.
        """
        return EstimateReport.of(self, object_name, self.belief, verdict=self.verdict).to_dict()

    def to_frame(self) -> pandas.DataFrame:
        """A table with a row for each support point: `x`, `y` [m], object frame, `w`, and its 90 % interval `low`, `high`.

        The interval is NaN without a belief.

        Raises:
            MissingPackage: pandas is not installed.
        """
        with extra("pandas", "to_frame"):
            import pandas
        intervals = np.full((len(self.w), 2), np.nan) if self.belief is None else self.belief.intervals
        return pandas.DataFrame(
            np.column_stack((self.support_points, self.w, intervals)), columns=["x", "y", "w", "low", "high"]
        )

    def plot(self, axes: Any = None) -> Any:
        """Draw the object in its frame [mm]: w as dots of proportional area, p_CF, its 90 % ellipse, contacts and pushes.

        The outline is drawn if the estimator was given it. An arrow shows where each push began.

        Args:
            axes: of matplotlib; None: those of a new figure of pyplot.
        Returns:
            The axes.
        Raises:
            MissingPackage: matplotlib is not installed.
        """
        with extra("plot", "plot"):
            from pushfric_core.estimation import picture
        return picture.draw(axes, self)

    def _repr_html_(self) -> str:
        """For notebooks: the text, with the picture if matplotlib is installed."""
        text = f"<pre>{html.escape(str(self))}</pre>"
        if importlib.util.find_spec("matplotlib") is None:
            return text
        from pushfric_core.estimation import picture

        return picture.as_html(self) + text


def friction_model(estimate: Estimate) -> FrictionModel:
    """The friction model of an estimate: what is believed after its pushes, for predictions.

    Args:
        estimate: from at least one observation; without a centre of friction that was given.
    Raises:
        UninformativePush: nothing is believed: in no observation anything moves into the object, or p_CF is given.

    Example:
        >>> from pushfric_core import Estimator, Observation, Twist, friction_model, predict
        >>> estimator = Estimator([(-0.05, -0.02), (0.05, -0.02), (0.0, 0.02)])
        >>> estimate = estimator.add(Observation((0.01, -0.03), (0.0, -1.0), Twist(0.0, 0.02, 0.1)))
        >>> model = friction_model(estimate)
        >>> predict(model, [(0.0, -0.03)], [(0.0, -1.0)], [(0.0, 0.02)]).twists.shape
        (1, 3)
    """
    if estimate.belief is None:
        raise UninformativePush("no friction model: the tip or the contact never moves into the object, or p_CF is given")
    return estimate.belief
