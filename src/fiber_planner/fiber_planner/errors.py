"""Errors of the planners."""

from fiber_core.errors import FiberError

__all__ = ["PlannerError"]


class PlannerError(FiberError):
    """A planner does not exist, or one of its parameters is out of range."""
