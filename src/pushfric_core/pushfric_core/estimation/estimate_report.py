"""An estimate as it is reported, the same live, replayed and offline: as one record, and its JSON."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import numpy.typing as npt

from pushfric_core.estimation.verdict import Verdict
from pushfric_core.geometry.planar import Array
from pushfric_core.solvers.program import Status
from pushfric_core.uncertainty.contact_friction import MuC, Slip
from pushfric_core.uncertainty.outlier_rejection import Change, Rejected
from pushfric_core.uncertainty.reasons import Reason

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
    def of(cls, estimate: "Estimate", slipping: Sequence[bool] = ()) -> "FrictionReport":
        """The report on an estimate, O(M) for M observations; `slipping` as for `EstimateReport.of`."""
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
            estimate.mu_c,
        )


class SpreadReport(NamedTuple):
    """How certain p_CF and w are."""

    covariance: Array  # (2, 2) of p_CF [m^2]
    middle: Array  # (n,) the mean of the extreme w
    intervals: Array  # (n, 2) low and high of each w_j
    data_points: int  # it rests on


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
    spread: SpreadReport | None  # None: not computed, or the pushes cannot give it
    confidence: float | None  # radius about p_CF [m]; None without a spread
    reasons: Sequence[Reason] = ()  # why the estimate is not to be used
    notes: Sequence[Reason] = ()
    rejected: Sequence[Rejected] = ()
    change: Change | None = None  # of the object

    @classmethod
    def of(
        cls,
        estimate: "Estimate",
        object_name: str,
        slipping: Sequence[bool] = (),
        verdict: Verdict | None = None,
        friction: FrictionReport | None = None,
    ) -> "EstimateReport":
        """The report on an estimate.

        Args:
            estimate: from at least one observation.
            object_name: name of the object.
            slipping: for each observation, whether its contact is known to have slipped; empty: for none.
            verdict: on its input; None: not judged.
            friction: what is said of mu_c; None: what this estimate says.
        """
        solution, spread, verdict = estimate.solution, estimate.spread, verdict or Verdict()
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
            friction or FrictionReport.of(estimate, slipping),
            None if spread is None else SpreadReport(spread.covariance, spread.middle, spread.intervals, spread.data_points),
            estimate.confidence,
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
        if self.confidence is not None:
            figures["confidence"] = self.confidence
        if self.spread is not None:
            figures["center_of_friction_covariance"] = self.spread.covariance.tolist()
            figures["w_intervals"] = self.spread.intervals.tolist()
            center = (self.spread.middle @ self.support_points).tolist()
            figures["middle"] = {"w": self.spread.middle.tolist(), "center_of_friction": center}
        if (mu_c := friction.mu_c) is not None:
            figures["mu_c"] |= {"value": mu_c.value, "interval": [mu_c.low, mu_c.high], "kind": mu_c.kind.value}
        if friction.slips:
            figures["mu_c"]["slips"] = dict(zip(SLIP_NAMES, friction.slips, strict=True))
        reasons, notes = ([one._asdict() for one in found] for found in (self.reasons, self.notes))
        figures["verdict"] = {"use": not self.reasons, "reasons": reasons, "notes": notes}
        figures["rejected"] = [{"push": one.push_id, "reason": one.reason._asdict()} for one in self.rejected]
        if self.change is not None:
            figures["change"] = {"since_push": self.change.since, "shift": list(self.change.shift)}
        return figures


def center_line(figures: dict[str, Any]) -> str:
    """p_CF in words, from what `EstimateReport.to_dict` gives."""
    x, y = (1e3 * value for value in figures["center_of_friction"])
    trust = f", within {figures['confidence'] * 1e3:.2f} mm with 90 % probability" if "confidence" in figures else ""
    return f"p_CF   ({x:.2f}, {y:.2f}) mm{trust}"


def contact_friction_line(figures: dict[str, Any]) -> str:
    """mu_c in words, from what `EstimateReport.to_dict` gives."""
    mu = figures["mu_c"]
    slipping = "; {:.3f} to {:.3f} in the pushes that slipped".format(*mu["slipping"]) if "slipping" in mu else ""
    bounds = f"lower bounds up to {mu['max']:.3f}, 90 % of them up to {mu['p90']:.3f}"
    return f"mu_c   {_coefficient(mu)}{bounds}{slipping}"


def _coefficient(mu: dict[str, Any]) -> str:
    """The value and its interval, in front of the bounds; nothing if it is only bounded."""
    if mu.get("value") is None:
        return ""
    low, high = mu["interval"]
    return f"{mu['value']:.3f} from {mu['kind']}, {low:.3f} to {high:.3f} with 90 % probability; "
