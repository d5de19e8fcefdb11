# SPDX-License-Identifier: Apache-2.0
"""What a session remembers of its robots, and what it takes over from an earlier one."""

import numpy as np

from fiber_bus_bridge.protocol import Context, State
from fiber_bus_bridge.protocol.turn_limits import turn_used_up
from fiber_bus_bridge.robot_memory import RobotMemory
from fiber_bus_bridge.session_state import SessionState, session_state
from fiber_core.array_types import Codes, Ints

__all__ = ["recall", "remember"]


def remember(c: Context, failed: Codes, starting: bool) -> RobotMemory:
    """Return what must be remembered of the robots; arguments as of Session.memory."""
    robots, state = c.robots, session_state(c.state)
    # a robot that rested when it lost its power is where it was, as far as nothing moved it
    lost = robots["lost"] & ~robots["recalled"] | (robots["verified"] if starting else False)
    boot = np.where(robots["unplaced"], -1, robots["boot"])  # and its next boot is another one
    # counts that the bridge has set, or a turn of theta that was guessed, tell no place
    placed = robots["placed"] & (~robots["unplaced"] | robots["recalled"])
    return RobotMemory(
        robots["counts"].copy(), placed, lost, boot, failed.copy(), c.buses["sequence"].copy(),
        state is SessionState.STOPPED, starting or state is SessionState.MOVING,
        _turn_limit(c, starting),
    )  # fmt: skip


def _turn_limit(c: Context, starting: bool) -> Ints:
    limit: Ints = c.robots["turn_limit"].copy()
    if not starting or c.plan is None or c.plan.within_mm is None:
        return limit
    turn = (c.plan.motion.end - c.plan.motion.start)[:, 0]
    return turn_used_up(limit, turn, c.robots["verified"])


def recall(c: Context, memory: RobotMemory) -> None:
    """Take over what was remembered, before the robots are configured."""
    assert c.state is State.UNCONFIGURED  # the session has checked it
    robots, placed = c.robots, memory.placed
    robots["counts"][placed] = memory.counts[placed]
    robots["placed"], robots["lost"] = placed, memory.lost
    robots["boot"] = memory.boot
    # an earlier version made turns, and kept none of them
    robots["turn_limit"] = 0 if memory.turn_limit is None else memory.turn_limit
    c.buses["sequence"] = memory.sequence
    c.was_stopped, c.was_moving = memory.stopped, memory.moving
