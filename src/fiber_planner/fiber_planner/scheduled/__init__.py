# SPDX-License-Identifier: Apache-2.0
"""The planner for motors with listed speeds: it chooses when joints move, not how fast."""

from fiber_planner.scheduled.planner import ScheduledParameters, ScheduledPlanner, timed

__all__ = ["ScheduledParameters", "ScheduledPlanner", "timed"]
