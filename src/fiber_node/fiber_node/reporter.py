# SPDX-License-Identifier: Apache-2.0
"""Progress and diagnostics of a node."""

import math
import threading
import time
from collections.abc import Callable, Iterable
from dataclasses import replace
from typing import Any

from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.event_handler import PublisherEventCallbacks
from rclpy.node import Node

from fiber_msgs_py import (
    Attempt,
    RateLimit,
    diagnostics,
    guarded,
    progress,
    report_failures_to,
    topics,
)
from fiber_msgs_py.diagnostics import Level, Status
from fiber_msgs_py.progress import Progress

__all__ = ["Reporter"]

_PERIOD_S = 1.0
_CLOCK_LINE_S = 10.0  # time between two lines about a missing clock
_PROGRESS_PERIOD_S = 0.1  # least time between two messages about one piece of work


class Reporter:
    """Publishes progress and diagnostics of a node, and logs what is done and refused.

    Diagnostics are published every second, and at once when something is refused or dropped, or for
    a subscription that is new. An exception that escapes a callback of the node counts as a
    refusal. A refusal stays the node's message until the node reports progress again. `counters`
    are figures by name that go into the diagnostics, beside the numbers of messages refused and
    dropped.

    Args:
        node: the node.
        stage: name of the node in progress and diagnostics.
        more: called for every message of diagnostics; returns the further statuses in it.
    """

    def __init__(self, node: Node, stage: str, more: Callable[[], Iterable[Status]] = tuple):
        self._node, self._stage, self._more = node, stage, more
        self._level, self._text = Level.OK, "waiting"
        self.refused = self.dropped = 0
        self._lock = threading.Lock()  # a worker and callbacks may refuse at once
        self.counters: dict[str, object] = {}
        self.session: str | None = None  # of the attempts that progress is reported of
        self._progress = topics.PROGRESS.publisher(node)
        met = PublisherEventCallbacks(matched=guarded(node, "diagnostics", self._on_matched))
        self._diagnostics = topics.DIAGNOSTICS.publisher(node, event_callbacks=met)
        self._limit = RateLimit()
        # a client that waits for this node must not wait for what failed
        report_failures_to(node, self._count_refusal)
        # in real time, as a clock of use_sim_time may be missing or rest
        node.create_timer(
            _PERIOD_S,
            guarded(node, "diagnostics", self._on_timer),
            clock=Clock(clock_type=ClockType.STEADY_TIME),
        )

    def progress(self, attempt: Attempt, fraction: float, text: str) -> None:
        """Publish how far the work on an attempt of a plan is.

        Args:
            attempt: the attempt.
            fraction: the part of the work that is done, 0..1.
            text: one line for people.
        """
        self._level, self._text = Level.OK, text
        self._publish_progress(Progress(self._stage, min(fraction, 1.0), text, attempt))

    def progress_of(
        self, attempt: Attempt, check: Callable[[], None]
    ) -> Callable[[float, str], None]:
        """Return a progress callback for work on an attempt, which may be called at any rate.

        Args:
            attempt: the attempt.
            check: called each time; it ends the work by raising, as Worker.check does.
        """
        due_s = -math.inf

        def report(fraction: float, text: str) -> None:
            nonlocal due_s
            check()
            if fraction >= 1.0 or time.monotonic() >= due_s:
                self.progress(attempt, fraction, text)
                due_s = time.monotonic() + _PROGRESS_PERIOD_S

        return report

    def done(self, attempt: Attempt, text: str) -> None:
        """Publish that the work on an attempt of a plan is done, and log it."""
        self._node.get_logger().info(f"plan {attempt}: {text}")
        self.progress(attempt, 1.0, text)

    def waiting(self, text: str) -> None:
        """Show in the next diagnostics what the node waits for."""
        self._level, self._text = Level.OK, text
        self.debug(text)

    def info(self, text: str) -> None:
        """Log what has happened."""
        self._node.get_logger().info(text)

    def debug(self, text: str) -> None:
        """Log a decision, on the level debug."""
        self._node.get_logger().debug(text)

    def refuse(self, text: str, source: str | None = None, attempt: Attempt | None = None) -> None:
        """Log, count and publish that something was refused, and why.

        Args:
            text: one line for people.
            source: the topic of a refused message, of which one line a second is logged.
            attempt: the attempt of a plan that is refused, whose progress then says so.
        """
        self._count_refusal(text)
        if attempt is not None:
            self._publish_progress(Progress(self._stage, 1.0, text, attempt, refused=True))
        line = text if source is None else self._limit.line(source, text)
        if line is not None:
            self._node.get_logger().error(line)

    def refuse_message(self, topic: str, text: str, _: object) -> None:
        """Refuse a message, as a `SessionGate` asks for.

        Args:
            topic: name of its topic.
            text: one line for people.
        """
        self.refuse(text, topic)

    def drop(self, text: str, source: str | None = None) -> None:
        """Log, count and publish that something out of date was dropped.

        Args:
            text: one line for people.
            source: the topic of a dropped message, of which one line a second is logged.
        """
        self._level, self._text = Level.WARN, text
        with self._lock:
            self.dropped += 1
        line = text if source is None else self._limit.line(source, text)
        if line is not None:
            self._node.get_logger().warning(line)
        self.publish()

    def _publish_progress(self, report: Progress) -> None:
        self._progress.publish(progress.encode(replace(report, session=self.session)))

    def _count_refusal(self, text: str) -> None:
        self._level, self._text = Level.ERROR, text
        with self._lock:
            self.refused += 1
        self.publish()

    def _on_timer(self) -> None:
        for source, lines in self._limit.overdue():
            self._node.get_logger().error(
                f"{source}: {lines} more messages were refused or dropped, their lines left out"
            )
        self._warn_of_missing_clock()
        self.publish()

    def _on_matched(self, status: Any) -> None:
        if status.current_count_change > 0:  # a client may wait for this node
            self.publish()

    def _warn_of_missing_clock(self) -> None:
        if self._node.get_parameter("use_sim_time").value and not self._now_ns():
            text = f"no time on {self._node.resolve_topic_name('/clock')}, and use_sim_time is set"
            self._level, self._text = Level.WARN, text
            self._node.get_logger().warning(text, throttle_duration_sec=_CLOCK_LINE_S)

    def _now_ns(self) -> int:
        return self._node.get_clock().now().nanoseconds

    def publish(self) -> None:
        """Publish the diagnostics now."""
        node = self._node.get_fully_qualified_name()
        counters: dict[str, object] = {"node": node, "refused": self.refused}
        if self.dropped:
            counters["dropped"] = self.dropped
        own = Status(self._stage, self._level, self._text, counters | self.counters)
        namespace = self._node.get_namespace()
        statuses = [status.in_namespace(namespace) for status in (own, *self._more())]
        self._diagnostics.publish(diagnostics.encode(statuses, self._now_ns()))
