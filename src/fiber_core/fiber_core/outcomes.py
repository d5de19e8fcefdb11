"""What can become of a robot in a plan, and why: the codes every stage shares."""

from enum import IntEnum

__all__ = ["Outcome", "Reason"]


class Outcome(IntEnum):
    """How a robot ended a plan; every robot of every plan gets exactly one."""

    REACHED = 0  # the fibre is within tolerance of its target
    HELD = 1  # the robot is somewhere safe, by decision, and not on a target
    FAILED = 2  # the robot did not do what it was ordered


class Reason(IntEnum):
    """Why a robot ended as it did; the number travels in messages and files."""

    OK = 0
    NO_TARGET = 1  # nothing was asked of it

    # the assignment was refused (fiber_core.targets)
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
