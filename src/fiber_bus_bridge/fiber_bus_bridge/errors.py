# SPDX-License-Identifier: Apache-2.0
"""Errors of the bus bridge."""

from enum import IntEnum

from fiber_core.errors import FiberError

__all__ = ["BridgeError", "ProtocolError", "SessionError", "TopologyError", "WireError"]


class BridgeError(FiberError):
    """Base of every error the bus bridge raises for bad input."""


class WireError(BridgeError):
    """A value does not fit its field, or a single frame is malformed.

    Args:
        message: description of the error, with the value.
        fault: the Fault that a robot would report for the frame; None for values.
    """

    def __init__(self, message: str, fault: IntEnum | None = None):
        super().__init__(message)
        self.fault = fault


class TopologyError(BridgeError):
    """A bus mode or an address does not exist."""


class SessionError(BridgeError):
    """A call does not fit the state of the session, or orders do not fit the plane."""


class ProtocolError(BridgeError):
    """An event that a state of the protocol does not know: a defect of a step."""
