"""What can become of a robot in a plan, and why: the codes every stage shares."""

from dataclasses import dataclass
from enum import IntEnum

import numpy as np

from fiber_core.errors import FiberError

__all__ = ["Outcome", "PlanOutcome", "Reason"]


class Outcome(IntEnum):
    """How a robot ended a plan; every robot of every plan gets exactly one."""

    REACHED = 0  # the fibre is within tolerance of its target
    HELD = 1  # the robot is somewhere safe, by decision, and not on a target
    FAILED = 2  # the robot did not do what it was ordered


class Reason(IntEnum):
    """Why a robot ended as it did; the number travels in messages and files."""

    OK = 0
    NO_TARGET = 1  # nothing was asked of it

    # the assignment was refused (fiber_core.assignment)
    UNKNOWN_ROBOT = 10
    DUPLICATE = 11
    NOT_FINITE = 12
    DISABLED = 13
    UNREACHABLE = 14  # outside the annulus the two arms can span
    OUTSIDE_JOINT_RANGE = 15  # in the annulus, but every elbow and turn breaks a joint limit
    TARGET_TOO_CLOSE = 16  # closer than the spacing to another robot's target
    TARGET_ON_OBSTACLE = 17  # every configuration touches something that cannot move
    START_OUTSIDE_LIMITS = 18

    # planning
    GOAL_BLOCKED = 30  # no elbow and turn is clear of the neighbours' chosen goals
    NOT_CONVERGED = 31  # the planner's horizon ended before the robot arrived
    TANGLED = 32  # too close to a neighbour at the start: it waits while that one leaves

    # discretization
    UNSAFE = 40  # no motion of it could be certified beside its neighbours
    BAD_TRAJECTORY = 41  # jump, speed, limit, or a start that is not where the robot is
    TOO_MANY_SEGMENTS = 42  # more segments than one order can carry

    # on the bus
    NOT_PLANNED = 60  # asked, but no orders arrived for it
    NOT_ACKNOWLEDGED = 61
    NOT_VERIFIED = 62
    UNSAFE_AS_LOADED = 63  # the loaded bytes, decoded, could not be certified
    STOPPED = 64
    OFF_TARGET = 65  # it ran its orders and its encoder is not where it was sent
    REFUSED = 66  # the robot itself refused the order


@dataclass(frozen=True, eq=False)
class PlanOutcome:
    """How every robot of a plan ended.

    Args:
        stamp_ns: the stamp that names the plan [ns].
        ids: robot ids, shape (n,).
        outcome: Outcome of each, shape (n,).
        reason: Reason of each, shape (n,).
        error_mm: distance from fibre to target [mm], nan without a target, shape (n,).
    """

    stamp_ns: int
    ids: np.ndarray
    outcome: np.ndarray
    reason: np.ndarray
    error_mm: np.ndarray

    def of(self, ids) -> "PlanOutcome":
        """Return the outcomes of some robots, shape (k,), in that order.

        Raises:
            FiberError: the plan has no such robot; names the first.
        """
        ids = np.asarray(ids)
        order = np.argsort(self.ids)
        place = np.searchsorted(self.ids, ids, sorter=order)
        rows = order[np.minimum(place, len(order) - 1)] if len(order) else place
        unknown = np.ones(len(ids), bool) if not len(order) else self.ids[rows] != ids
        if unknown.any():
            raise FiberError(f"robot {ids[np.argmax(unknown)]} has no outcome in this plan")
        columns = (self.ids, self.outcome, self.reason, self.error_mm)
        return PlanOutcome(self.stamp_ns, *(column[rows] for column in columns))

    def count(self, outcome: Outcome) -> int:
        """Return the number of robots with an outcome."""
        return int(np.count_nonzero(self.outcome == outcome))
