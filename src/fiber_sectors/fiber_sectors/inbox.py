# SPDX-License-Identifier: Apache-2.0
"""Messages that have come and were not taken yet: no sender fills the memory with them."""

import threading
from collections import deque

__all__ = ["Inbox"]


class Inbox:
    """A queue of messages between threads, which forgets the oldest when too many wait.

    What is lost is sent again, as over any network.

    Args:
        most: largest number of messages that wait.
        most_bytes: largest size of all that wait; one message is kept, whatever its size.
    """

    def __init__(self, most: int = 10_000, most_bytes: int = 2**28):
        self._most, self._most_bytes = most, most_bytes
        self._messages: deque[bytes] = deque()
        self._size = 0
        self._came = threading.Condition()

    def put(self, data: bytes) -> None:
        """Add a message."""
        with self._came:
            self._messages.append(data)
            self._size += len(data)
            while len(self._messages) > self._most or (
                self._size > self._most_bytes and len(self._messages) > 1
            ):
                self._size -= len(self._messages.popleft())
            self._came.notify()

    def take(self, wait_s: float) -> list[bytes]:
        """Return all that have come, oldest first, or wait for one [s]."""
        with self._came:
            self._came.wait_for(lambda: bool(self._messages), max(wait_s, 0.0))
            taken = list(self._messages)
            self._messages.clear()
            self._size = 0
        return taken
