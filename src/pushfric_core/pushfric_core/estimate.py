"""The estimate of w, p_CF and mu_c that the estimator returns."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from pushfric_core import contact_friction
from pushfric_core.contact_friction import ContactForces, MuC, Tip
from pushfric_core.observation import Observation
from pushfric_core.planar import Array
from pushfric_core.records import comparable
from pushfric_core.solvers.program import Optimum, Status
from pushfric_core.spread import Spread
from pushfric_core.support import center_of_friction


@comparable
@dataclass(frozen=True)
class Estimate:
    """What is known after the last data point; it never changes later.

    Attributes:
        support_points: (n, 2) [m], object frame.
        solution: w with its objective and certificate: the fit error [m, unit force]; with the loss l2 [m^2, unit force^2].
        data_points: number of data points used.
        pushes: number of pushes that they came from.
        stamp: of the newest data point [ns]; 0 if unknown.
        contact_forces: at each contact, of supports of unit weight, in order of arrival.
        conflicts: data points whose hard constraints contradict each other; empty unless the status is INFEASIBLE.
        center_given: the centre of friction is one of the hard constraints (eq. 13).
        spread: how far p_CF and w can be trusted; None if it is not computed, or the data do not tell.
        lack: why the pushes do not tell the spread, in words; None if they vary enough.
        tip: what was seen and measured of the pusher's tip at each contact.
        moment_error: mean moment error of a data point [m, unit force]; None if the fit has other terms or another loss.
    """

    support_points: Array
    solution: Optimum
    data_points: int
    pushes: int
    stamp: int
    contact_forces: ContactForces
    conflicts: tuple[Observation, ...] = ()
    center_given: bool = False
    spread: Spread | None = None
    lack: str | None = None
    tip: Tip | None = None
    moment_error: float | None = None

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
        return f"no w{given} lets the pusher push (f.n >= 0) in all of the pushes {', '.join(map(str, pushes))}"

    @cached_property
    def center_of_friction(self) -> Array:
        """p_CF (2,) [m], object frame (eq. 3)."""
        return center_of_friction(self.support_points, self.w)

    @property
    def confidence(self) -> float | None:
        """Radius about p_CF that holds the true one with a probability of 90 % [m]; None without a spread."""
        return None if self.spread is None else self.spread.radius

    @cached_property
    def mu_c(self) -> MuC | None:
        """The contact friction coefficient with its interval; None without data points."""
        if self.tip is None or not self.data_points:
            return None
        weights = self.w[None] if self.spread is None else np.vstack((self.spread.middle, self.spread.samples))
        return contact_friction.coefficient(self.contact_forces, self.tip, weights)

    def mu_c_of(self, weights: Array) -> list[float | None]:
        """mu_c under each of some w (k, n); None for a w under which it is only bounded."""
        if self.tip is None or not self.data_points:
            return [None] * len(weights)
        found = [contact_friction.coefficient(self.contact_forces, self.tip, w[None]) for w in weights]
        return [None if one is None else one.value for one in found]

    @cached_property
    def contact_friction(self) -> Array:
        """Lower bounds (m,) on mu_c, one for each data point (eq. 12)."""
        return contact_friction.lower_bounds(self.contact_forces, self.w)

    @property
    def mu_c_p90(self) -> float:
        """Value at or below which 90 % of the lower bounds lie."""
        return contact_friction.percentile(self.contact_friction, 0.9)

    @property
    def mu_c_max(self) -> float:
        """The largest of the lower bounds."""
        return contact_friction.percentile(self.contact_friction, 1.0)
