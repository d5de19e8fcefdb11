# SPDX-License-Identifier: Apache-2.0
"""The step of a motion: supervise the robots until all have arrived."""

from fiber_bus_bridge.protocol.context import Context, Phase, Watch
from fiber_bus_bridge.protocol.states import Event
from fiber_bus_bridge.protocol.supervision import supervise
from fiber_bus_bridge.protocol.tables import running
from fiber_core.outcomes import Reason

__all__ = ["move"]


def move(c: Context, phase: Phase, watch: Watch) -> Event:
    """Supervise the robots once, and see whether they have arrived, failed, or are overdue."""
    if running(c.robots).any():
        supervise(c, watch)
    if watch.stop_all_at_s is not None:
        return Event.FAILURE
    moving = running(c.robots)
    if not moving.any():
        return Event.ARRIVED
    if watch.now_s > _latest_end_s(c, phase):
        c.robots["cause"][moving] = Reason.OVERDUE
        c.t = watch.now_s
        return Event.OVERDUE
    return Event.STEPPED


def _latest_end_s(c: Context, phase: Phase) -> float:
    """Time after which a plan is ended although robots have not arrived [s]."""
    loaded_plan, safety = c.loaded_plan, c.safety
    assert loaded_plan is not None  # robots were started
    makespan_s = loaded_plan.makespan_s + c.plane.drive.longest_ramp_s
    late_s = safety.clock_ppm * 1e-6 * makespan_s + safety.start_skew_s
    return phase.start_s + makespan_s + late_s + c.config.grace_s
