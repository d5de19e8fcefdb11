"""States of a session and the calls that each state allows."""

from enum import Enum

__all__ = ["SessionState"]


class SessionState(Enum):
    """State of a session; the value is the advice given with a refused call."""

    UNCONFIGURED = "configure first"
    IDLE = "send orders, or home"
    READY = "start, or clear to drop the orders"
    MOVING = "wait for the end, or stop"
    STOPPED = "clear first"
