# SPDX-License-Identifier: Apache-2.0
"""What operators change through parameters while the bridge is configured."""

from collections.abc import Callable, Sequence

from fiber_bus_bridge.availability import Availability
from fiber_bus_bridge.errors import SessionError
from fiber_bus_bridge.node.attempts import Attempts
from fiber_bus_bridge.node.publishers import Publishers
from fiber_bus_bridge.session import Session
from fiber_bus_bridge.session_state import SessionState
from fiber_node import ManagedNode

__all__ = ["OperatorChanges"]


class OperatorChanges:
    """Disables robots, and vouches for their places. A caller holds the lock of the bridge.

    Args:
        node: the node of the bridge.
        session: the session with the robots.
        availability: the robots that can be commanded.
        attempts: the plan that is under way.
        outgoing: publishes the layout.
        save_memory: saves what is remembered of the robots.
    """

    def __init__(
        self,
        node: ManagedNode,
        session: Session,
        availability: Availability,
        attempts: Attempts,
        outgoing: Publishers,
        save_memory: Callable[[], None],
    ):
        self._node, self._session = node, session
        self._availability, self._attempts = availability, attempts
        self._outgoing, self._save_memory = outgoing, save_memory

    def disable(self, ids: Sequence[int], reason: str) -> None:
        """Replace the list of disabled robots.

        Args:
            ids: all robots on the new list.
            reason: reason of the robots that are new on it.

        Raises:
            SessionError: a plan is under way.
            BridgeError: a robot does not exist, or the list cannot be written.
        """
        changed = sorted(set(ids) ^ set(self._availability.disabled))
        moving = self._session.state is SessionState.MOVING
        if changed and (moving or self._attempts.awaited is not None):
            verb = "disabled" if changed[0] in ids else "enabled"
            raise SessionError(f"robot {changed[0]} cannot be {verb} while a plan is under way")
        self._availability.disable(ids, reason)
        self._session.enable(self._availability.enabled)
        self._outgoing.publish_layout()
        self._tell("disabled", ids)

    def vouch(self, ids: Sequence[int]) -> None:
        """Take robots that do not answer for resting where they were read last.

        Raises:
            SessionError: a plan is under way.
        """
        self._session.vouch(ids)
        self._save_memory()
        self._tell("vouched for", ids)

    def _tell(self, change: str, ids: Sequence[int]) -> None:
        self._node.reporter.publish()
        self._node.get_logger().info(f"{change} by operators: {sorted(ids) or 'no robot'}")
