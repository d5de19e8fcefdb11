# SPDX-License-Identifier: Apache-2.0
"""Errors of the planners."""

from fiber_core.errors import FiberError

__all__ = ["PlannerError"]


class PlannerError(FiberError):
    """A planner is unknown, a parameter is out of range, or a plan does not fit its plane."""
