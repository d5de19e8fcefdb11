# SPDX-License-Identifier: Apache-2.0
"""What a session remembers of its robots, and what it takes over from an earlier one."""

import numpy as np

from fiber_bus_bridge.protocol import Context, State
from fiber_bus_bridge.protocol.turn_limits import turning
from fiber_bus_bridge.robot_memory import RobotMemory
from fiber_bus_bridge.session_state import SessionState, session_state
from fiber_core.array_types import Codes

__all__ = ["recall", "remember"]


def remember(c: Context, failed: Codes, starting: bool) -> RobotMemory:
    """Return what must be remembered of the robots; arguments as of Session.memory."""
    robots, state = c.robots, session_state(c.state)
    # robots that are configured or cleared rest
    moving = state is SessionState.MOVING and c.state not in (State.CONFIGURING, State.CLEARING)
    unplaced = robots["unplaced"]
    # a robot that rested when it lost its power is where it was, as far as nothing moved it
    recalled = robots["recalled"] & ~turning(c, starting)
    lost = robots["lost"] & ~recalled | (robots["verified"] if starting else False)
    boot = np.where(unplaced, -1, robots["boot"])  # and its next boot is another one
    # counts that the bridge has set, or a turn of theta that was guessed, tell no place
    placed = robots["placed"] & (~unplaced | recalled)
    # where counters are believed gaps are not kept, so that none may turn where they are not
    limit = None if c.config.counters_kept else robots["turn_limit"].copy()
    if starting and limit is not None and c.phase is not None and c.phase.turn_limit is not None:
        limit = np.minimum(limit, c.phase.turn_limit)
    return RobotMemory(
        robots["counts"].copy(), placed, lost, boot, failed.copy(), c.buses["sequence"].copy(),
        state is SessionState.STOPPED or c.was_stopped,
        starting or moving or c.was_moving,
        limit, unplaced.copy(), c.known_mm.copy(),
    )  # fmt: skip


def recall(c: Context, memory: RobotMemory) -> None:
    """Take over what was remembered, before the robots are configured."""
    assert c.state is State.UNCONFIGURED  # the session has checked it
    robots, placed, unplaced = c.robots, memory.placed, memory.unplaced
    if unplaced is None:  # of an earlier version
        unplaced = (memory.boot < 0) & (not c.config.counters_kept)
    robots["counts"][placed] = memory.counts[placed]
    # also of a robot that does not answer now
    robots["unplaced"], robots["recalled"] = unplaced, unplaced & placed
    robots["placed"], robots["lost"] = placed, memory.lost | unplaced
    robots["boot"] = memory.boot
    # an earlier version made turns, and kept none of them
    robots["turn_limit"] = 0 if memory.turn_limit is None else memory.turn_limit
    if memory.known_mm is not None:
        c.known_mm = memory.known_mm
    c.buses["sequence"] = memory.sequence
    c.was_stopped, c.was_moving = memory.stopped, memory.moving
