# SPDX-License-Identifier: Apache-2.0
"""The attempts of plans that the bridge has accepted: a stage works on these and on no others."""

from collections.abc import Callable

from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.callback_groups import CallbackGroup
from rclpy.node import Node

from fiber_core.errors import FiberError
from fiber_msgs_py import Attempt, PlanStamp, progress, topics
from fiber_node.claims import BRIDGE
from fiber_node.session_gate import SessionGate

__all__ = ["AcceptedAttempts"]

_KEPT = 16


class AcceptedAttempts:
    """Starts work on a message as soon as the bridge has accepted the attempt that it belongs to.

    The bridge hears targets too. It accepts them with its progress, which says how new layout and
    joint states must be to plan with, or it refuses them, and then there is nothing to do. Topics
    overtake each other, so an acceptance may come before the message or after it. Each attempt is
    worked on once.

    Args:
        node: the node that receives the messages.
        gate: tells which sessions are open.
        group: callback group of the acceptances; None for the default one of the node.
    """

    def __init__(self, node: Node, gate: SessionGate, group: CallbackGroup | None = None):
        self._gate, self._logger = gate, node.get_logger()
        self._accepted: dict[PlanStamp, tuple[Attempt, str]] = {}
        self._waiting: dict[PlanStamp, Callable[[Attempt, str], None]] = {}
        self._ended: dict[PlanStamp, None] = {}  # refused, or worked on already
        topics.PROGRESS.subscription(node, self._on_progress, callback_group=group)

    def when_accepted(self, stamp: PlanStamp, work: Callable[[Attempt, str], None]) -> bool:
        """Do work on the attempt of a stamp as soon as the bridge has accepted it.

        Of several works for one stamp the first is done.

        Args:
            stamp: names the attempt.
            work: called once with the attempt and its session.

        Returns:
            Whether the work was done at once.
        """
        if stamp in self._ended:
            return False
        _keep(self._waiting, stamp, self._waiting.get(stamp, work))
        return self._start_if_accepted(stamp)

    def has_ended(self, stamp: PlanStamp) -> bool:
        """Return whether the attempt of a stamp was refused, or work on it has begun."""
        return stamp in self._ended

    def _start_if_accepted(self, stamp: PlanStamp) -> bool:
        if stamp not in self._accepted or stamp not in self._waiting:
            return False
        work = self._waiting.pop(stamp)
        attempt, session = self._accepted.pop(stamp)
        _keep(self._ended, stamp, None)
        work(attempt, session)
        return True

    def _on_progress(self, message: DiagnosticStatus) -> None:
        try:
            received = progress.decode(message)
        except FiberError:
            return
        attempt, session = received.attempt, received.session
        if received.stage != BRIDGE or session is None or attempt.stamp in self._ended:
            return
        if not self._gate.is_open(session):
            return  # of a bag, say; an acceptance is repeated as long as its plan waits
        if received.refused:
            self._logger.debug(f"plan {attempt}: refused by the bridge")
            self._accepted.pop(attempt.stamp, None)
            self._waiting.pop(attempt.stamp, None)
            _keep(self._ended, attempt.stamp, None)
        elif attempt.since_ns is not None:
            self._logger.debug(f"plan {attempt}: accepted by the bridge")
            _keep(self._accepted, attempt.stamp, (attempt, session))
            self._start_if_accepted(attempt.stamp)


def _keep(table, stamp, value) -> None:
    table[stamp] = value
    for old in list(table)[:-_KEPT]:
        del table[old]
