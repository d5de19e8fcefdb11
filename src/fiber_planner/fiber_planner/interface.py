# SPDX-License-Identifier: Apache-2.0
"""The planner interface: the problem that goes in, the planned motion that comes out.

A planner is an object with a `name` and a method `plan`. It reads a `fiber_core.Problem`
(the plane, the present joint angles, the targets) and returns a `PlannedMotion`:

    1. goals: the joint angles that bring each fibre to its target (`choose_goals`);
    2. motion: joint angles of all robots at common instants, from the start of the problem;
    3. reason: OK for each robot that arrives at its goal, and else why it does not.

A planner need not be perfect. The discretizer and the bus bridge certify every motion
again and hold the robots that would come too close; a planner decides how many robots
arrive and how soon. The README shows a complete planner of 15 lines.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Protocol, TypeAlias, runtime_checkable

import numpy as np

from fiber_core.array_types import Angles, Codes, Pairs
from fiber_core.clearance import Safety
from fiber_core.focal_plane import FocalPlane
from fiber_core.motion import SampledMotion
from fiber_core.problem import Problem
from fiber_planner.errors import PlannerError

__all__ = ["PlannedMotion", "Planner", "ProgressCallback", "SpacedPlanner", "check_borders",
           "spacing_of"]  # fmt: skip

# Called from time to time with the fraction of the work that is done, 0..1, and a short text. It
# ends the planning by raising an exception, which the planner lets pass.
ProgressCallback: TypeAlias = Callable[[float, str], None]


@dataclass(frozen=True, eq=False)
class PlannedMotion:
    """The motion of every robot of a plane, its goal, and whether it arrives there.

    Args:
        motion: joint angles of all robots of the plane over time; it begins at the start of
            the problem, and robots that do not move are constant.
        goal: joint angles that each robot aims at [rad], shape (n, 2); the start of a robot
            that has no target or cannot be moved.
        reason: fiber_core.outcomes.Reason of each robot, shape (n,): OK (it arrives),
            NO_TARGET, GOAL_BLOCKED, NOT_CONVERGED, TANGLED, DISABLED, START_OUTSIDE_LIMITS or
            OUTSIDE_JOINT_RANGE (of the approach of a motor).
        tangled: pairs that start closer than the margin, rows a < b, robots first and
            obstacles after them, shape (k, 2); the motion must not bring them closer.

    Raises:
        PlannerError: an array does not have one row for each robot of the motion.
    """

    motion: SampledMotion
    goal: Angles
    reason: Codes
    tangled: Pairs = field(default_factory=lambda: np.zeros((0, 2), dtype=np.int64))

    def __post_init__(self) -> None:
        n = self.motion.n
        for name, dtype, shape in (
            ("goal", np.float64, (n, 2)),
            ("reason", np.int64, (n,)),
            ("tangled", np.int64, (len(self.tangled), 2)),
        ):
            value = np.array(getattr(self, name), dtype=dtype, order="C")
            if value.shape != shape:
                raise PlannerError(f"{name} has shape {value.shape}, expected {shape}")
            value.setflags(write=False)
            object.__setattr__(self, name, value)


@runtime_checkable
class Planner(Protocol):
    """An object that turns a reconfiguration problem into a motion.

    Equal problems give equal plans, to the byte. A planner that uses random numbers seeds
    its own generator, and its effort is counted in steps and not in seconds.
    """

    @property
    def name(self) -> str:
        """Name of the planner, for logs and results."""
        ...

    def plan(self, problem: Problem, progress: ProgressCallback | None = None) -> PlannedMotion:
        """Plan the motion of every robot from its start to its target.

        A robot without a target, or one that is disabled, has a row in the result too.

        Args:
            problem: the plane, the present joint angles and the targets that were accepted.
            progress: called with the fraction of the work that is done and a short text, several
                times a second, so that a node can end the planning.

        Raises:
            PlannerError: the parameters of the planner do not suit the plane.
        """
        ...


@runtime_checkable
class SpacedPlanner(Planner, Protocol):
    """A planner that needs targets apart, as those that know only the tips of the robots."""

    def spacing_mm(self, plane: FocalPlane) -> float:
        """Return the least distance between two targets that the planner can bring together [mm].

        Raises:
            PlannerError: the parameters of the planner do not suit the plane.
        """
        ...


def check_borders(planner: Planner, skews_s: tuple[float, float]) -> None:
    """Check that a planner leaves the gaps that the sectors of a plane need at their borders.

    A planner without a certificate of its own leaves no such gaps; the discretizer does.

    Args:
        planner: the planner.
        skews_s: skews of start and stop that robots of two sectors need [s].

    Raises:
        MotionError: a skew of its parameters is smaller; names it and both values.
    """
    safety = getattr(getattr(planner, "parameters", None), "safety", None)
    if isinstance(safety, Safety):
        safety.check_borders(*skews_s, planner.name)


def spacing_of(planner: Planner, plane: FocalPlane) -> float:
    """Return the spacing of targets for a planner [mm]: that of the plane, or more if it needs it.

    Args:
        planner: the planner.
        plane: the focal plane.

    Raises:
        PlannerError: the parameters of the planner do not suit the plane.
    """
    needed_mm = planner.spacing_mm(plane) if isinstance(planner, SpacedPlanner) else 0.0
    return max(plane.spacing_mm, needed_mm)
