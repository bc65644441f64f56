"""An estimate as it is reported, the same live, replayed and offline: as one record, and its JSON."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import numpy.typing as npt

from pushfric_core.belief.doubts import Change, Rejected
from pushfric_core.estimation.verdict import Verdict
from pushfric_core.geometry.planar import Array
from pushfric_core.mechanics.prediction import FrictionModel, MuC
from pushfric_core.program.contact_friction import Slip
from pushfric_core.reasons import Reason
from pushfric_core.solvers.program import Status

if TYPE_CHECKING:
    from pushfric_core.estimation.estimate import Estimate

SLIP_NAMES = [state.value for state in Slip]
"""The words for a slip, in the order of the values of ContactFriction.slips."""

BIN_WIDTH = 0.05
"""Width of the bins of the histogram of lower bounds on mu_c, about that of Figures 7 and 8."""

BINS = 41
"""Number of bins; the last one counts all bounds beyond 2."""


def histogram(lower_bounds: npt.ArrayLike) -> np.ndarray:
    """Number of lower bounds on mu_c (m,) in each bin: (BINS,)."""
    bins = np.minimum(np.asarray(lower_bounds, dtype=float) / BIN_WIDTH, BINS - 1)
    return np.bincount(bins.astype(int), minlength=BINS)


class FrictionReport(NamedTuple):
    """The mu_c of an estimate, which takes every observation into account."""

    data_points: int  # it rests on
    p90: float  # 90 % of the lower bounds lie at or below this value
    most: float  # the largest lower bound
    counts: Sequence[int]  # of the lower bounds in each bin: see `histogram`
    slipping: tuple[float, float] | None  # least and greatest bound of pushes known to slip; None: there is none
    slips: Sequence[int]  # observations of each kind, in the order of `Slip`; empty: unknown
    slip: Slip  # at the newest observation
    mu_c: MuC | None

    @classmethod
    def of(cls, estimate: "Estimate", belief: FrictionModel | None, slipping: Sequence[bool] = ()) -> "FrictionReport":
        """The report on an estimate and what is believed of mu_c, O(M) for M observations.

        Args:
            estimate: from at least one observation.
            belief: that of the estimate, or of an earlier one.
            slipping: for each observation, whether its contact is known to have slipped; empty: for none.
        """
        bounds = estimate.contact_friction
        slid = bounds[np.asarray(slipping)] if any(slipping) else None
        slips = np.empty(0, int) if estimate.tip is None else estimate.tip.slips
        return cls(
            estimate.data_points,
            estimate.mu_c_p90,
            estimate.mu_c_max,
            histogram(bounds).tolist(),
            None if slid is None else (float(slid.min()), float(slid.max())),
            () if estimate.tip is None else np.bincount(slips, minlength=len(Slip)).tolist(),
            list(Slip)[slips[-1]] if len(slips) else Slip.UNKNOWN,
            None if belief is None else belief.known_mu_c,
        )


class SpreadReport(NamedTuple):
    """The belief about w, with its uncertainty."""

    covariance: Array  # (2, 2) of p_CF [m^2]
    middle: Array  # (n,) the mean w
    intervals: Array  # (n, 2) low and high of each w_j


@dataclass(frozen=True)
class EstimateReport:
    """Everything that is said of an estimate: in a message, as JSON, and on the page. SI units, object frame."""

    object_name: str
    stamp: int  # of the newest observation [ns]
    status: Status
    data_points: int
    pushes: int
    support_points: Array  # (n, 2)
    w: Array  # (n,)
    center_of_friction: Array  # (2,)
    objective: float
    lower_bound: float
    gap: float
    total_friction: float | None  # [N]; None without measured forces
    friction: FrictionReport
    believed: int  # number of observations that the spread and the value of mu_c rest on
    spread: SpreadReport | None  # None: not computed, or the pushes cannot give it
    confidence: float | None  # radius about the belief's p_CF [m]; None without a spread
    reasons: Sequence[Reason] = ()  # why the estimate is not to be used
    notes: Sequence[Reason] = ()
    rejected: Sequence[Rejected] = ()
    change: Change | None = None  # of the object

    @classmethod
    def of(
        cls,
        estimate: "Estimate",
        object_name: str,
        belief: FrictionModel | None,
        slipping: Sequence[bool] = (),
        verdict: Verdict | None = None,
        friction: FrictionReport | None = None,
        believed: int | None = None,
    ) -> "EstimateReport":
        """The report on an estimate.

        Args:
            estimate: from at least one observation.
            object_name: name of the object.
            belief: that of the estimate, or of an earlier one.
            slipping: for each observation, whether its contact is known to have slipped; empty: for none.
            verdict: on its input; None: not judged.
            friction: what is said of mu_c; None: what this estimate says.
            believed: number of observations that the belief rests on; None: all.
        """
        solution, verdict = estimate.solution, verdict or Verdict()
        return cls(
            object_name,
            estimate.stamp,
            estimate.status,
            estimate.data_points,
            estimate.pushes,
            estimate.support_points,
            estimate.w,
            estimate.center_of_friction,
            solution.objective,
            solution.lower_bound,
            solution.gap,
            estimate.total_friction,
            friction or FrictionReport.of(estimate, belief, slipping),
            estimate.data_points if believed is None else believed,
            None
            if belief is None or belief.covariance is None
            else SpreadReport(belief.covariance, belief.support.weights, belief.intervals),
            None if belief is None else belief.confidence,
            verdict.reasons,
            verdict.notes,
            verdict.rejected,
            verdict.change,
        )

    def to_dict(self) -> dict[str, Any]:
        """All numbers as the command line's JSON names them."""
        friction = self.friction
        figures: dict[str, Any] = {
            "object": self.object_name,
            "objective": self.objective,
            "lower_bound": self.lower_bound,
            "gap": self.gap,
            "w": self.w.tolist(),
            "support_points": self.support_points.tolist(),
            "center_of_friction": self.center_of_friction.tolist(),
            "mu_c": {"p90": friction.p90, "max": friction.most},
            "data_points": self.data_points,
            "pushes": self.pushes,
            "status": self.status.value,
        }
        if friction.slipping is not None:
            figures["mu_c"]["slipping"] = list(friction.slipping)
        if self.total_friction is not None:
            figures["total_friction"] = self.total_friction
        if friction.slips:
            figures["mu_c"]["slips"] = dict(zip(SLIP_NAMES, friction.slips, strict=True))
        return figures | {"belief": self._belief()}

    def _belief(self) -> dict[str, Any]:
        """All that claims how far it may be off, and the verdict."""
        belief: dict[str, Any] = {}
        if self.spread is not None:
            spread = self.spread
            belief |= {
                "center_of_friction": (spread.middle @ self.support_points).tolist(),
                "covariance": spread.covariance.tolist(),
                "radius": self.confidence,
                "w": spread.middle.tolist(),
                "w_intervals": spread.intervals.tolist(),
            }
        if (mu_c := self.friction.mu_c) is not None:
            belief["mu_c"] = {"value": mu_c.value, "interval": [mu_c.low, mu_c.high], "kind": mu_c.kind.value}
        reasons, notes = ([one._asdict() for one in found] for found in (self.reasons, self.notes))
        belief["verdict"] = {"use": not self.reasons, "reasons": reasons, "notes": notes}
        belief["rejected"] = [{"push": one.push_id, "reason": one.reason._asdict()} for one in self.rejected]
        change = self.change
        belief["change"] = None if change is None else {"since_push": change.since, "shift": list(change.shift)}
        return belief


def center_line(figures: dict[str, Any]) -> str:
    """p_CF in words, from what `EstimateReport.to_dict` gives: what is believed, and the optimum of the program."""
    x, y = (1e3 * value for value in figures["center_of_friction"])
    belief = figures["belief"]
    if "radius" not in belief:
        return f"p_CF   ({x:z.2f}, {y:z.2f}) mm by the program"
    u, v = (1e3 * value for value in belief["center_of_friction"])
    believed = f"p_CF   ({u:z.2f}, {v:z.2f}) mm, within {belief['radius'] * 1e3:.2f} mm with 90 % probability"
    return f"{believed}; ({x:z.2f}, {y:z.2f}) mm by the program"


def contact_friction_line(figures: dict[str, Any]) -> str:
    """mu_c in words, from what `EstimateReport.to_dict` gives."""
    mu = figures["mu_c"]
    slipping = "; {:.3f} to {:.3f} in the pushes that slipped".format(*mu["slipping"]) if "slipping" in mu else ""
    bounds = f"lower bounds up to {mu['max']:.3f}, 90 % of them up to {mu['p90']:.3f}"
    return f"mu_c   {_coefficient(figures['belief'].get('mu_c'))}{bounds}{slipping}"


def _coefficient(mu: dict[str, Any] | None) -> str:
    """The belief, in front of the bounds."""
    if mu is None:
        return ""
    low, high = mu["interval"]
    if mu["value"] is None:
        return f"at least {low:.3f} with 90 % probability; "
    return f"{mu['value']:.3f} from {mu['kind']}, {low:.3f} to {high:.3f} with 90 % probability; "
