"""Which attempt of which plan a message belongs to, for a node that receives no targets itself."""

from collections.abc import Callable

from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.node import Node
from sensor_msgs.msg import PointCloud2

from fiber_core.errors import FiberError
from fiber_msgs_py import Attempt, AttemptTable, PlanStamp, progress, targets, topics

__all__ = ["AttemptListener"]


class AttemptListener:
    """Starts work on a message as soon as the attempt that its stamp names has been announced.

    A trajectory has a stamp and no place for more, and it can arrive before the targets that it
    derives from. Targets announce an attempt, and so does the progress of every stage that works
    on it. In a graph in which no node publishes targets, as where a trajectory is published by
    hand, there is nothing to wait for, and a stamp names a plan.

    Args:
        node: the node that receives the messages.
    """

    def __init__(self, node: Node):
        self._node = node
        self._attempts = AttemptTable()
        self._waiting: tuple[PlanStamp, Callable[[Attempt], None]] | None = None
        topics.TARGETS.subscription(node, self._on_targets)
        topics.PROGRESS.subscription(node, self._on_progress)

    def when_announced(self, stamp: PlanStamp, work: Callable[[Attempt], None]) -> bool:
        """Do work on the attempt of a stamp as soon as it has been announced.

        One piece of work waits at most: newer work takes its place.

        Args:
            stamp: names the attempt.
            work: called once with the attempt.

        Returns:
            Whether the work was started at once.
        """
        self._waiting = (stamp, work)
        return self._start_if_announced()

    def _start_if_announced(self) -> bool:
        if self._waiting is None:
            return False
        stamp, work = self._waiting
        attempt = self._attempts.find(stamp)
        if attempt is None and self._node.count_publishers(topics.TARGETS.name) == 0:
            attempt = Attempt.first(stamp)
        if attempt is None:
            return False
        self._waiting = None
        work(attempt)
        return True

    def _on_targets(self, message: PointCloud2) -> None:
        try:
            self._add(targets.decode_attempt(message))
        except FiberError:
            pass  # the planner refuses them

    def _on_progress(self, message: DiagnosticStatus) -> None:
        try:
            self._add(progress.decode(message).attempt)
        except FiberError:
            pass  # targets and later progress announce the attempt too

    def _add(self, attempt: Attempt) -> None:
        if self._attempts.add(attempt):
            self._start_if_announced()
