"""Errors of the bus bridge."""

from fiber_core.errors import FiberError

__all__ = ["BridgeError", "SessionError", "TopologyError", "WireError"]


class BridgeError(FiberError):
    """Base of every error the bus bridge raises for bad input."""


class WireError(BridgeError):
    """A value does not fit its field, or a single frame is malformed.

    Args:
        message: what is wrong, with the value.
        fault: the Fault a robot would report for such a frame, None for values.
    """

    def __init__(self, message: str, fault=None):
        super().__init__(message)
        self.fault = fault


class TopologyError(BridgeError):
    """There is no such bus mode, or no such address."""


class SessionError(BridgeError):
    """A call does not fit the state the session is in, or orders do not fit the plane."""
