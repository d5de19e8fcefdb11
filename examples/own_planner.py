# SPDX-License-Identifier: Apache-2.0
"""A planner of your own behind the planner interface, compared with the planner "direct".

This one moves every robot straight to its goal, one ring of robots after the other, from the
outside inwards. It ignores collisions: the discretizer certifies every motion and holds the robots
that would come too close. Run it with `python examples/own_planner.py`; ROBOTS=37 makes it smaller.
"""

import os

import numpy as np

from fiber_core.motion import SampledMotion
from fiber_planner import choose_goals, travel_s
from fiber_positioners import PlannedMotion, hexagonal, random_problem, reconfigure


class OutsideIn:
    """Robots far from the centre of the plane move first; each at its full speed."""

    name = "outside in"

    def plan(self, problem, progress=None):
        goal, reason = choose_goals(problem)
        distance = np.linalg.norm(problem.plane.centers, axis=1).round(3)
        _, ring = np.unique(distance, return_inverse=True)  # 0 is the innermost
        turn = ring.max(initial=0) - ring  # the outermost ring moves first
        instants = np.arange(turn.max(initial=0) + 2)
        time_s = instants * travel_s(problem, goal).max(initial=1e-3)
        arrived = instants > turn[:, None]  # shape (n, t)
        angles = np.where(arrived[:, None], goal[..., None], problem.start[..., None])
        return PlannedMotion(SampledMotion(time_s, angles), goal, reason)


plane = hexagonal(int(os.environ.get("ROBOTS", "61")), pitch_mm=9.0, arms_mm=(3.0, 3.0))
problem = random_problem(plane, seed=1)
for planner in (OutsideIn(), "direct"):
    report = reconfigure(problem, planner=planner).report
    print(
        f"{report['planner']}: {report['reached']} of {report['asked']} reached in "
        f"{report['makespan_s']:.2f} s, held: {report['reasons']}"
    )
