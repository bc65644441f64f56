"""A constraint of your own: the object lies on a table with a soft spot, on which it is known to exert no pressure.

python3 examples/own_constraint.py
"""

from dataclasses import dataclass

import numpy as np

from pushfric_core import Constraint, ConstraintRows, Estimator, EstimatorConfig, Observation, Outline, SupportForces, Twist

OUTLINE = Outline.rectangle(0.12, 0.06)

DATA = [  # contact point [m], outward unit normal, twist [m, m, rad]: two pushes, which leave w largely open
    Observation((-0.03, -0.03), (0.0, -1.0), Twist(0.0, 0.0103, -0.155), push_id=0),
    Observation((0.04, -0.03), (0.0, -1.0), Twist(0.0, 0.0094, 0.162), push_id=1),
]


@dataclass(frozen=True)
class SoftSpot(Constraint):
    """Supports within a circle should bear no weight: each unit of weight there costs a moment.

    Args:
        center: of the circle, object frame [m].
        radius: of the circle [m].
        cost: of a unit of weight in it [m].
    """

    center: tuple[float, float]
    radius: float
    cost: float = 0.01

    def rows(self, observation: Observation, forces: SupportForces) -> ConstraintRows:
        inside = np.hypot(*(forces.points - self.center).T) < self.radius
        return ConstraintRows(inside[None].astype(float), np.array((self.cost,)), np.zeros(1))


def weight_inside(spot: SoftSpot, *terms: str | Constraint) -> float:
    """The share of the weight that the pushes put into the circle, with these terms."""
    points = OUTLINE.grid(7, 5)
    estimator = Estimator(points, EstimatorConfig(terms=terms))
    for observation in DATA:
        estimate = estimator.add(observation)
    return float(estimate.w[np.hypot(*(points - spot.center).T) < spot.radius].sum())


def main() -> None:
    spot = SoftSpot(center=(0.0, 0.0), radius=0.02)
    print(f"weight on the soft spot: {weight_inside(spot, 'moment'):.2f} without the constraint")
    print(f"                         {weight_inside(spot, 'moment', spot):.2f} with it")


if __name__ == "__main__":
    main()
