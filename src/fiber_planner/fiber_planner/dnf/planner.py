# SPDX-License-Identifier: Apache-2.0
"""The dnf planners: every robot follows its own navigation function (Makarem et al. 2014a)."""

from dataclasses import replace
from typing import NamedTuple, Protocol

import numpy as np

from fiber_core import kinematics
from fiber_core.array_types import Angles, Floats, Ints, Mask, Points
from fiber_core.focal_plane import FocalPlane
from fiber_core.motion import SampledMotion
from fiber_core.motors import with_independent_speeds
from fiber_core.outcomes import Reason
from fiber_core.problem import Problem
from fiber_planner.dnf.arm_repulsion import ArmNeighbours
from fiber_planner.dnf.integrator import apply_steps, arm_points, joint_steps
from fiber_planner.dnf.navigation_function import Contacts, ControlLaw, Swarm
from fiber_planner.dnf.parameters import DnfParameters, DnfPriorityParameters
from fiber_planner.dnf.priority import NoPriorities, Priorities, Run, Waits, folded_phi
from fiber_planner.dnf.rehearsal import Rehearsals
from fiber_planner.dnf.tip_repulsion import TipNeighbours
from fiber_planner.errors import PlannerError
from fiber_planner.goal_selection import choose_goals, travel_s
from fiber_planner.interface import PlannedMotion, ProgressCallback

__all__ = ["DnfArmsPlanner", "DnfArmsPriorityPlanner", "DnfPlanner", "DnfPriorityPlanner"]

_STEPS_PER_REPORT = 25
# The motion has one row for each robot and step; the usual has 250 to 10 000 steps.
_MOST_STEPS, _MOST_ROWS = 1_000_000, 100_000_000


class _Neighbours(Protocol):
    # the repulsion between neighbours, on tips or on whole arms
    immovable: Mask

    def repel(
        self, angles: Angles, elbows: Points, tips: Points, ranks: Floats
    ) -> tuple[Floats, Angles, Contacts]: ...

    def step_fractions(self, step: Angles, contacts: Contacts) -> tuple[Floats, Ints]: ...


class _Priorities(Protocol):
    # the ranks of the robots, and the angles that each aims at now
    @property
    def ranks(self) -> Floats: ...

    @property
    def aim(self) -> Angles: ...

    def update(self, before: Angles, after: Angles, fraction: Floats, blocker: Ints) -> bool: ...


class _Scene(NamedTuple):
    # what all runs of a plan have in common; the most steps end it at the horizon
    start: Angles
    neighbours: _Neighbours
    swarm: Swarm
    law: ControlLaw
    alone_s: Floats
    steps: int


class DnfPlanner:
    """Decentralized navigation function on the tips, as in Makarem et al. 2014 (A&A 566, A84).

    Only tips are kept apart: no two of them ever come within d, and arms may overlap.
    Convergence is not guaranteed; robots that do not arrive are reported.

    Args:
        parameters: weights, radii, time step and horizon.
    """

    name = "dnf"

    def __init__(self, parameters: DnfParameters | None = None):
        self.parameters = parameters or DnfParameters()

    def spacing_mm(self, plane: FocalPlane) -> float:
        """Return D [mm]: targets closer than that are no equilibria of the control law."""
        return self.parameters.radii_mm(plane)[0]

    def plan(self, problem: Problem, progress: ProgressCallback | None = None) -> PlannedMotion:
        """Plan the motion of every robot, see Planner.plan.

        Raises:
            PlannerError: D and d do not suit the plane, or the horizon has too many steps.
        """
        # each joint follows the law by itself
        problem = replace(problem, plane=with_independent_speeds(problem.plane))
        law = ControlLaw.of(problem.plane, self.parameters)
        goal, reason = choose_goals(problem, self.parameters.margin_mm)
        motion = self._move(self._scene(problem, goal, law), progress)

        away = kinematics.on_target(problem.plane, motion.end, problem.targets).error_mm
        late = (reason == Reason.OK) & (away > self.parameters.tolerance_mm)
        return PlannedMotion(motion, goal, np.where(late, int(Reason.NOT_CONVERGED), reason))

    def _neighbours(self, problem: Problem, goal: Angles, law: ControlLaw) -> _Neighbours:
        return TipNeighbours(problem.plane, law)

    def _move(self, scene: _Scene, progress: ProgressCallback | None) -> SampledMotion:
        priorities = NoPriorities(scene.swarm, scene.law.dt)
        return self._integrate(scene, priorities, scene.steps, progress)

    def _scene(self, problem: Problem, goal: Angles, law: ControlLaw) -> _Scene:
        plane = problem.plane
        neighbours = self._neighbours(problem, goal, law)
        swarm = Swarm.of(plane, problem.start, goal, plane.enabled & ~neighbours.immovable)
        alone_s = travel_s(problem, goal)
        horizon_s = self.parameters.end_s(float(alone_s.max(initial=0.0)))
        steps = max(1, int(np.ceil(horizon_s / law.dt - 1e-9)))
        if steps > _MOST_STEPS or steps * plane.n > _MOST_ROWS:
            raise PlannerError(
                f"a horizon of {horizon_s:.6g} s has {steps} steps of {law.dt:.6g} s for "
                f"{plane.n} robots, expected at most {_MOST_STEPS} steps, and {_MOST_ROWS} "
                "steps times robots; set horizon_s or dt_s"
            )
        return _Scene(np.array(problem.start), neighbours, swarm, law, alone_s, steps)

    def _integrate(
        self, scene: _Scene, priorities: _Priorities, steps: int, progress: ProgressCallback | None
    ) -> SampledMotion:
        # steps of the control law until all robots have arrived or stopped, or to the last step
        angles, neighbours, swarm, law = scene.start, scene.neighbours, scene.swarm, scene.law
        n = len(angles)
        towards_aim = swarm._replace(goal=priorities.aim)
        history = [angles]
        while len(history) <= steps:
            elbows, tips = arm_points(angles, swarm)
            _, push, contacts = neighbours.repel(angles, elbows, tips, priorities.ranks)
            step, arrives = joint_steps(angles, elbows, tips, push, towards_aim, law)
            fraction, blocker = np.ones(n), np.full(n, -1)
            if law.adaptive:
                fraction, blocker = neighbours.step_fractions(step, contacts)
            after = apply_steps(angles, step, arrives, fraction, towards_aim)
            last = priorities.update(angles, after, fraction, blocker)
            angles = after
            history.append(angles)
            if progress is not None and len(history) % _STEPS_PER_REPORT == 0:
                done = len(history) - 1
                progress(done / steps, f"{done * law.dt:.2f} s of motion")
            if last or self._all_arrived(angles, swarm, law):
                break
        return SampledMotion(law.dt * np.arange(len(history)), np.stack(history, axis=-1))

    def _all_arrived(self, angles: Angles, swarm: Swarm, law: ControlLaw) -> bool:
        if law.joint:
            return bool((angles == swarm.goal)[swarm.movable].all())
        away = arm_points(angles, swarm)[1] - swarm.goal_tip
        within = np.linalg.norm(away, axis=1) <= self.parameters.tolerance_mm
        return bool(within[swarm.movable].all())


class DnfArmsPlanner(DnfPlanner):
    """The navigation function between whole arms: no two outlines ever touch (our extension).

    The distance of two tips is replaced by d plus the gap between two outlines less the
    margin, so D - d is the range of the repulsion. No gap above the margin ever falls to
    it, and none below it shrinks. Robots that overlap at the start do not move.
    """

    name = "dnf_arms"

    def _neighbours(self, problem: Problem, goal: Angles, law: ControlLaw) -> _Neighbours:
        return ArmNeighbours(problem.plane, problem.start, goal, law, self.parameters.margin_mm)


class DnfPriorityPlanner(DnfPlanner):
    """The navigation function between tips, with priorities that resolve deadlocks.

    Args:
        parameters: those of the navigation function, and how long robots wait and give way.
    """

    name = "dnf_priority"

    def __init__(self, parameters: DnfPriorityParameters | None = None):
        self._priority_parameters = parameters or DnfPriorityParameters()
        super().__init__(self._priority_parameters)

    def _move(self, scene: _Scene, progress: ProgressCallback | None) -> SampledMotion:
        # the best of all rehearsals; none is followed for longer than that
        parameters, swarm = self._priority_parameters, scene.swarm
        patience_s, yield_s = parameters.waits_s(swarm.speed)
        folding_s = np.abs(folded_phi(swarm) - swarm.goal[:, 1]) / swarm.speed[:, 1]
        rehearsals = Rehearsals(
            scene.alone_s, folding_s, patience_s, yield_s, scene.law.dt,
            int(parameters.rehearsals),
        )  # fmt: skip
        none = Waits.none(len(folding_s))
        best = self._rehearsed(scene, none, scene.steps, rehearsals.share_of(progress))
        waits = rehearsals.next_waits(best[0])
        while waits is not None:
            all_arrive = best[0].score[0] == 0
            steps = len(best[1].time_s) - 1 if all_arrive else scene.steps
            tried = self._rehearsed(scene, waits, steps, rehearsals.share_of(progress))
            best = min(best, tried, key=lambda one: one[0].score)  # the first one of equals
            waits = rehearsals.next_waits(tried[0])
        return best[1]

    def _rehearsed(
        self, scene: _Scene, waits: Waits, steps: int, progress: ProgressCallback | None
    ) -> tuple[Run, SampledMotion]:
        parameters, dt = self._priority_parameters, scene.law.dt
        priorities = Priorities(
            scene.swarm, scene.start, scene.alone_s, dt, *parameters.waits_s(scene.swarm.speed),
            parameters.claims, waits,
        )  # fmt: skip
        motion = self._integrate(scene, priorities, steps, progress)
        return priorities.shown(), motion


class DnfArmsPriorityPlanner(DnfPriorityPlanner, DnfArmsPlanner):
    """The navigation function between whole arms, with priorities that resolve deadlocks."""

    name = "dnf_arms_priority"
