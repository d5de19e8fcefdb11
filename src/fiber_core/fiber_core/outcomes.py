# SPDX-License-Identifier: Apache-2.0
"""Outcomes and reasons: the codes with which every stage reports how a robot ended a plan."""

from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import ArrayLike

from fiber_core.array_types import Codes, Floats, Ids, Mask
from fiber_core.errors import FiberError

__all__ = ["STILL", "Outcome", "PlanOutcome", "Reason", "Verdict", "first_reason", "holds"]


class Outcome(IntEnum):
    """How a robot ended a plan; every robot of every plan gets exactly one."""

    REACHED = 0  # the fibre is within tolerance of its target
    HELD = 1  # the robot is safe, by decision, and not on a target
    FAILED = 2  # the robot did not carry out its orders


class Reason(IntEnum):
    """The cause of an outcome; the number travels in messages and files."""

    OK = 0
    NO_TARGET = 1  # the robot has no target in this plan

    # the assignment was refused (fiber_core.assignment)
    UNKNOWN_ROBOT = 10
    DUPLICATE = 11
    NOT_FINITE = 12
    DISABLED = 13
    UNREACHABLE = 14  # outside the annulus that the two arms span
    OUTSIDE_JOINT_RANGE = 15  # in the annulus, but every elbow and turn breaks a joint limit
    TARGET_TOO_CLOSE = 16  # closer than the spacing to the target of another robot
    TARGET_ON_OBSTACLE = 17  # every configuration is too close to a body that cannot move
    START_OUTSIDE_LIMITS = 18

    # the planner (fiber_planner)
    GOAL_BLOCKED = 30  # no elbow and turn is clear of the goals chosen for the neighbours
    NOT_CONVERGED = 31  # the horizon of the planner ended before the robot arrived
    TANGLED = 32  # too close to a neighbour at the start: it waits while the neighbour leaves

    # the discretizer (fiber_discretizer)
    UNSAFE = 40  # no motion of the robot could be certified among its neighbours
    BAD_TRAJECTORY = 41  # a jump, a speed, a limit, or a start away from the robot
    TOO_MANY_SEGMENTS = 42  # more segments than one order can carry
    OVERLOAD = 43  # its motors would be one too many for their power supply

    # the bus (fiber_bus_bridge)
    NOT_PLANNED = 60  # the robot has a target, but no orders arrived for it
    NOT_ACKNOWLEDGED = 61  # not found at configuration, or another cause than those below
    NOT_VERIFIED = 62
    UNSAFE_AS_LOADED = 63  # the loaded bytes, decoded, could not be certified
    STOPPED = 64  # an operator, or the end of the plan, stopped the robot
    OFF_TARGET = 65  # the orders have ended, and the fibre is not within tolerance of its target
    REFUSED = 66  # the robot refused the order
    PLAN_REFUSED = 67  # the whole plan was refused: its targets, or a stage could not work on it
    # of the robot itself
    NO_REPLY = 68  # the robot does not answer any more: it may have lost power
    BUS_FAILED = 69  # the lines of the bus are stuck: the robot cannot be reached
    REBOOTED = 70  # the robot booted, and lost its configuration and its order
    STALLED = 71  # a joint did not follow
    NO_HEARTBEAT = (
        72  # received none, unlike others on the bus or as the bridge died: stopped itself
    )
    OVERDUE = 73  # still on the way when the time for its order was over
    # of a robot that is well
    OTHER_FAILED = 74  # another robot failed: all were stopped and did not resume
    PLACE_UNKNOWN = 75  # the place of the robot, or of one beside it, is not known

    # the camera (fiber_metrology)
    NOT_MOVED = 90  # an image shows that a joint did not turn when it was told to
    NOT_SEEN = 91  # no light of the last image is surely that of its fibre


class Verdict(IntEnum):
    """What an image says about a robot."""

    MEASURED = 0
    DARK = 1  # no light, and none in an earlier image either
    MISSING = 2  # no light in this image
    AMBIGUOUS = 3  # a light that may be of another robot, or a stray one
    MERGED = 4  # a light that may be two
    NOT_MOVED = 5  # neither joint turned
    THETA_NOT_MOVED = 6
    PHI_NOT_MOVED = 7
    OFF_MODEL = 8  # further from where it should be than its errors explain
    UNPLACED = 9  # at an unknown place, and no light is surely that of its fibre
    UNEXPLAINED = 10  # no light where it should be, and one in its reach that no robot explains


# a joint, or both, did not turn when they were told to
STILL = (Verdict.NOT_MOVED, Verdict.THETA_NOT_MOVED, Verdict.PHI_NOT_MOVED)


def holds(reason: ArrayLike) -> Mask:
    """Return whether each reason keeps its robot from a target: all but OK and NO_TARGET.

    Args:
        reason: Reason of each robot, shape (n,).
    """
    return ~np.isin(reason, (Reason.OK, Reason.NO_TARGET))


def first_reason(*stages: ArrayLike) -> Codes:
    """Return the reason of the first stage that held each robot, shape (n,).

    A plan passes its stages in order: assignment, planner, discretizer, bus. The first stage
    that held a robot gives the cause; later reasons for that robot are its consequences. A
    robot that no stage held keeps the reason of the last stage, OK or NO_TARGET.

    Args:
        stages: Reason of each robot by stage, in the order of the stages, each of shape (n,).

    Raises:
        FiberError: no stages, or stages with different numbers of robots.
    """
    reasons = [np.asarray(stage, dtype=np.int64) for stage in stages]
    if not reasons:
        raise FiberError("first_reason needs the reasons of at least one stage")
    if len({stage.shape for stage in reasons}) > 1:
        shapes = ", ".join(str(stage.shape) for stage in reasons)
        raise FiberError(f"the stages have reasons of different shapes: {shapes}")
    first = reasons[-1].copy()
    for stage in reversed(reasons[:-1]):
        first = np.where(holds(stage), stage, first)
    return first


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
    ids: Ids
    outcome: Codes
    reason: Codes
    error_mm: Floats

    def __post_init__(self):
        for name in ("ids", "outcome", "reason", "error_mm"):
            object.__setattr__(self, name, np.asarray(getattr(self, name)))

    def of(self, ids: ArrayLike) -> "PlanOutcome":
        """Return the outcomes of some robots, in the order in which their ids are given.

        Args:
            ids: ids of the robots, shape (k,).

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
        return PlanOutcome(
            self.stamp_ns,
            self.ids[rows],
            self.outcome[rows],
            self.reason[rows],
            self.error_mm[rows],
        )

    def count(self, outcome: Outcome) -> int:
        """Return the number of robots with an outcome."""
        return int(np.count_nonzero(self.outcome == outcome))
