# SPDX-License-Identifier: Apache-2.0
"""A limit to the rate of log lines about messages that other nodes send."""

import threading
import time
from collections.abc import Callable

__all__ = ["RateLimit"]


class RateLimit:
    """Lets one line a second through for each source, and counts the lines left out.

    Args:
        period_s: least time between two lines of a source [s].
        clock: returns seconds.
    """

    def __init__(self, period_s: float = 1.0, clock: Callable[[], float] = time.monotonic):
        self._period_s, self._clock = period_s, clock
        self._due_s: dict[str, float] = {}  # when the next line of a source may come
        self._left_out: dict[str, int] = {}
        self._lock = threading.Lock()  # a node has several threads

    def line(self, source: str, text: str) -> str | None:
        """Return the line to log, with the number of lines left out before it; None to log none.

        Args:
            source: the source, such as a topic.
            text: the line.
        """
        now_s = self._clock()
        with self._lock:
            if now_s < self._due_s.get(source, now_s):
                self._left_out[source] = self._left_out.get(source, 0) + 1
                return None
            self._due_s[source] = now_s + self._period_s
            left_out = self._left_out.pop(source, 0)
        return f"{text} ({left_out} such lines were left out before)" if left_out else text

    def overdue(self) -> list[tuple[str, int]]:
        """Return and forget the sources with lines left out for longer than the period."""
        now_s = self._clock()
        with self._lock:
            due = [source for source in self._left_out if self._due_s[source] <= now_s]
            return [(source, self._left_out.pop(source)) for source in due]
