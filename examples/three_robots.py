# SPDX-License-Identifier: Apache-2.0
"""Three robots by hand: a plane array by array, two robots that pass each other, one at rest.

Run it with `python examples/three_robots.py`.
"""

import numpy as np

from fiber_positioners import FocalPlane, Outcome, Problem, Reason, reconfigure

# Lengths in mm, angles in rad. Three equal robots in a row, 8 mm apart, with arms of 3 mm.
# The phi arm is a capsule: the line from elbow to tip, grown by 1 mm.
plane = FocalPlane(
    ids=[10, 11, 12],
    centers=[[0.0, 0.0], [8.0, 0.0], [16.0, 0.0]],
    arms=np.full((3, 2), 3.0),
    limits=np.tile([[-np.pi, np.pi], [0.0, np.pi]], (3, 1, 1)),
    speeds=np.full((3, 2), np.pi),
    phi_vertices=np.tile([[0.0, 0.0], [3.0, 0.0]], (3, 1, 1)),
    phi_radius=np.full(3, 1.0),
    theta_vertices=np.zeros((3, 0, 2)),  # theta arms pass below all phi arms
    theta_radius=np.zeros(3),
    enabled=[True, True, True],
    spacing_mm=4.0,
)
folded = [0.0, 3.0]  # theta, phi
start = np.array([folded, folded, folded])

# The targets of robots 10 and 11 are between the two; robot 12 has no target.
targets = np.array([[3.0, 3.0], [5.0, -3.5], [np.nan, np.nan]])
result = reconfigure(Problem(plane, start, targets))

for robot, outcome, reason in zip(plane.ids, result.outcome, result.reason):
    print(f"robot {robot}: {Outcome(outcome).name.lower()}, {Reason(reason).name.lower()}")
print(f"{result.motion.makespan_s:.3f} s, least clearance {result.certificate.min_gap_mm:.2f} mm")
for time_s in np.linspace(0.0, result.motion.makespan_s, 5):
    theta, phi = np.rad2deg(result.motion(time_s)[0])
    print(f"{time_s:6.3f} s  robot 10: theta {theta:7.2f} deg, phi {phi:7.2f} deg")
