# SPDX-License-Identifier: Apache-2.0
"""A running focal plane in a browser: what moves, what is wrong, and orders."""

from fiber_console.errors import ConsoleError
from fiber_console.plane_feed import PlaneFeed
from fiber_console.server import ConsoleServer, kept_token

__all__ = ["ConsoleError", "ConsoleServer", "PlaneFeed", "kept_token"]
