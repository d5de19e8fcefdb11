# SPDX-License-Identifier: Apache-2.0
"""Whether the bridge takes over what was measured."""

import threading
from collections.abc import Callable

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.node import Node

from fiber_core.errors import FiberError
from fiber_metrology.errors import MetrologyError
from fiber_msgs_py import PlanStamp, diagnostics, measured, progress, topics
from fiber_node import BRIDGE

__all__ = ["BridgeAnswer", "BridgeSilent"]


class BridgeSilent(MetrologyError):
    """The bridge has not said whether it takes over what was measured: it may do so later."""


class BridgeAnswer:
    """Waits until the bridge has taken over, or refused, what was measured.

    Args:
        node: the node, which subscribes.
    """

    def __init__(self, node: Node):
        self._namespace = node.get_namespace()
        self._came = threading.Condition()
        # number of images that the bridge has taken over, and stamp of the last, as text
        self._taken: tuple[str, str] | None = None
        self._refused: dict[PlanStamp, str] = {}
        group = MutuallyExclusiveCallbackGroup()
        topics.DIAGNOSTICS.subscription(node, self._on_diagnostics, callback_group=group)
        topics.PROGRESS.subscription(node, self._on_progress, callback_group=group)

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        try:
            received = diagnostics.decode(message)
        except FiberError:
            return
        for each in received:
            status = each.of_namespace(self._namespace)
            if status is not None and status.name == BRIDGE:
                with self._came:
                    images, stamp = (status.values.get(key) for key in ("images", "measured"))
                    self._taken = str(images), str(stamp)
                    self._came.notify_all()

    def _on_progress(self, message: DiagnosticStatus) -> None:
        try:
            received = progress.decode(message)
        except FiberError:
            return
        if received.stage == BRIDGE and received.refused:
            if received.text.startswith(measured.REFUSED):
                with self._came:
                    self._refused = {received.attempt.stamp: received.text}
                    self._came.notify_all()

    def wait_after(self, publish: Callable[[], None], stamp: PlanStamp, timeout_s: float) -> None:
        """Publish what was measured, and wait until the bridge has taken it over.

        Args:
            publish: publishes it.
            stamp: its stamp.
            timeout_s: longest wait [s].

        Raises:
            MetrologyError: the bridge refuses it; gives its reason. Or nothing was heard of it.
            BridgeSilent: it does not answer; it may take it over later.
        """
        with self._came:
            if not self._came.wait_for(lambda: self._taken is not None, timeout_s):
                raise MetrologyError(f"the bridge has told nothing of itself in {timeout_s:g} s")
            self._refused, before = {}, self._taken
            publish()

            def taken_over() -> bool:
                return self._taken not in (None, before) and self._taken[1] == str(stamp)

            self._came.wait_for(lambda: stamp in self._refused or taken_over(), timeout_s)
            if stamp in self._refused:
                raise MetrologyError(f"the bridge has not taken it over: {self._refused[stamp]}")
            if not taken_over():
                raise BridgeSilent(f"the bridge has not taken it over in {timeout_s:g} s")
