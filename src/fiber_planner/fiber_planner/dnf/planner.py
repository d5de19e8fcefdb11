"""The planner of the papers: every robot follows its own navigation function."""

import numpy as np

from fiber_core import kinematics
from fiber_core.motion import SampledMotion
from fiber_core.outcomes import Reason
from fiber_core.problem import Problem
from fiber_planner.dnf.arm_repulsion import ArmNeighbours
from fiber_planner.dnf.integrator import places, turned, turns
from fiber_planner.dnf.navigation_function import Law, Swarm
from fiber_planner.dnf.parameters import DnfParameters, DnfPriorityParameters
from fiber_planner.dnf.priority import Equals, Priorities
from fiber_planner.dnf.tip_repulsion import TipNeighbours
from fiber_planner.goal_selection import choose_goals, travel_s
from fiber_planner.interface import PlannedMotion, ProgressCallback

__all__ = ["DnfArmsPlanner", "DnfArmsPriorityPlanner", "DnfPlanner", "DnfPriorityPlanner"]

_STEPS_PER_REPORT = 25


class DnfPlanner:
    """Decentralized navigation function on the tips, as in Makarem et al. 2014 (A&A 566, A84).

    Only tips are kept apart: no two of them ever come within d, arms are outside the
    model. Convergence is not guaranteed; robots that do not arrive are reported.

    Args:
        parameters: weights, radii, time step and horizon.
    """

    name = "dnf"

    def __init__(self, parameters: DnfParameters | None = None):
        self.parameters = parameters or DnfParameters()

    def plan(self, problem: Problem, progress: ProgressCallback | None = None) -> PlannedMotion:
        """Plan the motion of every robot, see Planner.plan.

        Raises:
            PlannerError: D and d do not suit the plane.
        """
        law = Law.of(problem.plane, self.parameters)
        goal, reason = choose_goals(problem, self.parameters.margin_mm)
        motion = self._follow(problem, goal, law, progress)

        tips = kinematics.forward(problem.plane, motion.end)[1]
        away = np.linalg.norm(tips - problem.targets, axis=1)
        late = (reason == Reason.OK) & (away > self.parameters.tolerance_mm)
        return PlannedMotion(motion, goal, np.where(late, Reason.NOT_CONVERGED, reason))

    def _neighbours(self, problem, goal, law):
        return TipNeighbours(problem.plane, law)

    def _order(self, swarm, alone_s, law):
        return Equals(swarm, law.dt)

    def _follow(self, problem, goal, law, progress):
        # steps of the law until everybody is home, nobody moves, or the horizon
        plane = problem.plane
        neighbours = self._neighbours(problem, goal, law)
        swarm = Swarm.of(plane, problem.start, goal, plane.enabled & ~neighbours.stuck)
        alone_s = travel_s(problem, goal)
        order = self._order(swarm, alone_s, law)
        towards_aim = swarm._replace(goal=order.aim)
        horizon_s = self.parameters.end_s(alone_s.max(initial=0.0))
        steps = max(1, int(np.ceil(horizon_s / law.dt - 1e-9)))

        angles = np.array(problem.start)
        history = [angles]
        while len(history) <= steps:
            elbows, tips = places(angles, swarm)
            _, push, contacts = neighbours.push(angles, elbows, tips, order.ranks)
            turn, lands = turns(angles, elbows, tips, push, towards_aim, law)
            part, hinderer = np.ones(plane.n), np.full(plane.n, -1)
            if law.adaptive:
                part, hinderer = neighbours.shorten(turn, contacts)
            after = turned(angles, turn, lands, part, towards_aim)
            last = order.watch(angles, after, part, hinderer)
            angles = after
            history.append(angles)
            if progress is not None and len(history) % _STEPS_PER_REPORT == 0:
                done = len(history) - 1
                progress(done / steps, f"{done * law.dt:.2f} s of motion")
            if last or self._home(angles, swarm, law):
                break
        return SampledMotion(law.dt * np.arange(len(history)), np.stack(history, axis=-1))

    def _home(self, angles, swarm, law):
        if law.joint:
            return (angles == swarm.goal)[swarm.movable].all()
        away = places(angles, swarm)[1] - swarm.goal_tip
        within = np.linalg.norm(away, axis=1) <= self.parameters.tolerance_mm
        return within[swarm.movable].all()


class DnfArmsPlanner(DnfPlanner):
    """The same law between whole arms: no two outlines ever touch (our extension).

    The distance of two tips is replaced by d plus the gap between two outlines less the
    margin, so D - d is the range of the repulsion. No gap above the margin ever falls to
    it, and none below it shrinks. Robots that overlap at the outset do not move.
    """

    name = "dnf_arms"

    def _neighbours(self, problem, goal, law):
        return ArmNeighbours(problem.plane, problem.start, goal, law, self.parameters.margin_mm)


class DnfPriorityPlanner(DnfPlanner):
    """The same law between tips, with priorities where robots block each other.

    Args:
        parameters: those of the law, and how the robots wait and give way.
    """

    name = "dnf_priority"

    def __init__(self, parameters: DnfPriorityParameters | None = None):
        super().__init__(parameters or DnfPriorityParameters())

    def _order(self, swarm, alone_s, law):
        patience_s, yield_s = self.parameters.waits_s(swarm.speed)
        return Priorities(swarm, alone_s, law.dt, patience_s, yield_s, self.parameters.claims)


class DnfArmsPriorityPlanner(DnfPriorityPlanner, DnfArmsPlanner):
    """The law between whole arms, with priorities where robots block each other."""

    name = "dnf_arms_priority"
