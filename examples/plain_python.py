"""Estimate and predict without ROS: observations in, motions out. pushfric_core is all it needs.

python3 examples/plain_python.py
"""

import numpy as np

from pushfric_core import Estimator, Observation, Outline, Twist, friction_model, named_ellipsoid, predict

OUTLINE = Outline.rectangle(0.12, 0.06)

DATA = [  # contact point [m], outward unit normal, twist [m, m, rad] of the object-frame origin: three pushes of one object
    Observation((-0.03, -0.03), (0.0, -1.0), Twist(0.0, 0.0103, -0.155), push_id=0),
    Observation((0.04, -0.03), (0.0, -1.0), Twist(0.0, 0.0094, 0.162), push_id=1),
    Observation((0.06, 0.02), (1.0, 0.0), Twist(-0.0132, 0.0, 0.163), push_id=2),
]


def main() -> None:
    estimator = Estimator(OUTLINE.grid(6, 3))
    for observation in DATA:
        estimate = estimator.add(observation)
    model = friction_model(estimate)
    x, y = 1e3 * model.center_of_friction
    print(f"centre of friction ({x:.1f}, {y:.1f}) mm, m_max {named_ellipsoid(model.support).m_max:.4f} m")
    motion = predict(model, [(0.0, -0.03)], [(0.0, -1.0)], [(0.0, 0.02)])
    vx, vy, omega = motion.twists[0]
    print(f"{motion.modes[0].value}: vx {vx:.4f} m/s, vy {vy:.4f} m/s, omega {omega:.3f} rad/s")
    print(f"within {np.degrees(motion.spread[0]):.1f} degrees")


if __name__ == "__main__":
    main()
