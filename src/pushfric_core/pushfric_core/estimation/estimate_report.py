"""An estimate as it is reported, the same live, replayed and offline: a record of the program, and in it one of the belief.

The fields have the names of the JSON; an annotation says where a field stands in the message, unless under its own name. JSON
and message are made from them by `records.plain` and by `write` of pushfric_ros.messages.conversions.
"""

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import numpy.typing as npt

from pushfric_core.belief.doubts import Change, Rejected
from pushfric_core.estimation.verdict import Verdict
from pushfric_core.geometry.planar import Array
from pushfric_core.mechanics.prediction import FrictionModel, MuC
from pushfric_core.program.contact_friction import Slip
from pushfric_core.records import FieldPlace, plain
from pushfric_core.solvers.program import Status
from pushfric_core.wording import Reason

if TYPE_CHECKING:
    from pushfric_core.estimation.estimate import Estimate

BIN_WIDTH = 0.05
"""Width of the bins of the histogram of lower bounds on mu_c, about that of Figures 7 and 8."""

BINS = 41
"""Number of bins; the last one counts all bounds beyond 2."""


def histogram(lower_bounds: npt.ArrayLike) -> np.ndarray:
    """Number of lower bounds on mu_c (m,) in each bin: (BINS,)."""
    bins = np.minimum(np.asarray(lower_bounds, dtype=float) / BIN_WIDTH, BINS - 1)
    return np.bincount(bins.astype(int), minlength=BINS)


@dataclass(frozen=True, kw_only=True)
class BoundsReport:
    """The lower bounds on mu_c."""

    p90: float  # 90 % of the lower bounds lie at or below this value
    max: float  # the largest lower bound
    slipping: tuple[float, float] | None = None  # least and greatest bound of pushes known to slip; None: there is none
    histogram: Annotated[Sequence[int], FieldPlace(key="")]  # number of them in each bin: see `histogram`
    slips: Annotated[Sequence[int], FieldPlace(key="")] = ()  # of each kind, in the order of `Slip`; empty: unknown
    slip: Annotated[Slip, FieldPlace(key="")]  # at the newest observation

    @classmethod
    def of(cls, estimate: "Estimate", slipping: Sequence[bool] = (), with_slips: bool = True) -> "BoundsReport":
        """The report on an estimate, O(M) for M observations.

        Args:
            estimate: from at least one observation.
            slipping: for each observation, whether its contact is known to have slipped; empty: for none.
            with_slips: say how the tip moved, too, which takes as long as the rest.
        """
        bounds = estimate.contact_friction
        slid = bounds[np.asarray(slipping)] if any(slipping) else None
        slips = estimate.tip.slips if estimate.tip is not None and with_slips else np.empty(0, int)
        return cls(
            p90=estimate.mu_c_p90,
            max=estimate.mu_c_max,
            histogram=histogram(bounds).tolist(),
            slipping=None if slid is None else (float(slid.min()), float(slid.max())),
            slips=np.bincount(slips, minlength=len(Slip)).tolist() if len(slips) else (),
            slip=list(Slip)[slips[-1]] if len(slips) else Slip.UNKNOWN,
        )

    @property
    def data_points(self) -> int:
        """Number of observations that it rests on."""
        return sum(self.histogram)


@dataclass(frozen=True)
class VerdictReport:
    """Why an estimate is not to be used, and what should be put right although it may be used."""

    reasons: tuple[Reason, ...]
    notes: tuple[Reason, ...]


@dataclass(frozen=True, kw_only=True)
class BeliefReport:
    """All that claims how far it may be off, and the verdict. What the pushes do not show is None."""

    center_of_friction: Annotated[Array | None, FieldPlace("spread.center_of_friction")] = None  # (2,)
    covariance: Annotated[Array | None, FieldPlace("spread.covariance")] = None  # (2, 2) of p_CF [m^2]
    radius: Annotated[float | None, FieldPlace("confidence")] = None  # about p_CF [m]
    w: Annotated[Array | None, FieldPlace("spread.middle")] = None  # (n,) the mean
    w_intervals: Annotated[Array | None, FieldPlace("spread.low spread.high")] = None  # (n, 2) of each w_j
    mu_c: Annotated[MuC | None, FieldPlace("contact_friction")] = None
    verdict: Annotated[VerdictReport, FieldPlace("")]
    rejected: tuple[Rejected, ...]
    change: Change | None  # of the object
    data_points: Annotated[int, FieldPlace("spread.data_points", "")]  # observations that all but the verdict rests on

    @classmethod
    def of(cls, model: FrictionModel | None, verdict: Verdict, data_points: int) -> "BeliefReport":
        """The report on what is believed, if anything, and on the verdict."""
        said: dict[str, Any] = {} if model is None else {"mu_c": model.known_mu_c}
        if model is not None and model.covariance is not None:
            said |= {"center_of_friction": model.center_of_friction, "covariance": model.covariance, "radius": model.confidence}
            said |= {"w": model.support.weights, "w_intervals": model.intervals}
        judged = VerdictReport(verdict.reasons, verdict.notes)
        return cls(**said, verdict=judged, rejected=verdict.rejected, change=verdict.change, data_points=data_points)


@dataclass(frozen=True, kw_only=True)
class EstimateReport:
    """Everything that is said of an estimate: in a message, as JSON, and on the page. SI units, object frame."""

    object: str  # its name
    stamp: Annotated[int, FieldPlace("header.stamp", "")]  # of the newest observation [ns]
    objective: float
    lower_bound: float
    gap: float
    w: Annotated[Array, FieldPlace("support_friction.weights")]  # (n,)
    support_points: Annotated[Array, FieldPlace("support_friction.support_points")]  # (n, 2)
    center_of_friction: Array  # (2,)
    mu_c: Annotated[BoundsReport, FieldPlace("contact_friction")]
    data_points: int
    pushes: int
    status: Status
    total_friction: Annotated[float | None, FieldPlace("support_friction.total_friction")] = None  # [N]; None: no forces
    belief: Annotated[BeliefReport, FieldPlace("")]

    @classmethod
    def of(
        cls,
        estimate: "Estimate",
        object_name: str,
        belief: FrictionModel | None,
        slipping: Sequence[bool] = (),
        verdict: Verdict | None = None,
        bounds: BoundsReport | None = None,
        believed: int | None = None,
    ) -> "EstimateReport":
        """The report on an estimate: each field is what the estimate, or its solution, has under that name.

        Args:
            estimate: from at least one observation.
            object_name: name of the object.
            belief: that of the estimate, or of an earlier one.
            slipping: for each observation, whether its contact is known to have slipped; empty: for none.
            verdict: on its input; None: not judged.
            bounds: those on mu_c; None: those of this estimate.
            believed: number of observations that the belief rests on; None: all.
        """
        given: dict[str, Any] = {
            "object": object_name,
            "mu_c": bounds or BoundsReport.of(estimate, slipping),
            "belief": BeliefReport.of(belief, verdict or Verdict(), estimate.data_points if believed is None else believed),
        }
        for name in {field.name for field in fields(cls)} - given.keys():
            given[name] = getattr(estimate if hasattr(estimate, name) else estimate.solution, name)
        return cls(**given)

    def to_dict(self) -> dict[str, Any]:
        """All numbers as the command line's JSON names them."""
        figures: dict[str, Any] = plain(self)
        verdict = figures["belief"]["verdict"]
        figures["belief"]["verdict"] = {"use": not verdict["reasons"]} | verdict
        if self.mu_c.slips:
            figures["mu_c"]["slips"] = dict(zip((one.value for one in Slip), self.mu_c.slips, strict=True))
        return figures


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
