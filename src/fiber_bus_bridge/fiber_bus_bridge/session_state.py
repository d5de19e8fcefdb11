# SPDX-License-Identifier: Apache-2.0
"""States of a session and the calls that each state allows."""

from enum import Enum

from fiber_bus_bridge.protocol import State

__all__ = ["SessionState", "session_state"]


class SessionState(Enum):
    """State of a session; the value is the advice given with a refused call."""

    UNCONFIGURED = "configure first"
    IDLE = "send orders, or home"
    READY = "start, or clear to drop the orders"
    MOVING = "wait for the end, or stop"
    STOPPED = "clear first"


_OF_STATE = {
    State.UNCONFIGURED: SessionState.UNCONFIGURED,
    State.IDLE: SessionState.IDLE,
    State.READY: SessionState.READY,
    State.STOPPED: SessionState.STOPPED,
}


def session_state(state: State) -> SessionState:
    """Return the state of a session by that of its protocol: MOVING while a call is at work."""
    return _OF_STATE.get(state, SessionState.MOVING)
