# SPDX-License-Identifier: Apache-2.0
"""Messages that wait are few, however many come."""

import threading

from fiber_sectors.inbox import Inbox


def test_the_oldest_messages_are_forgotten():
    inbox = Inbox(most=3, most_bytes=10)
    for data in (b"a", b"b", b"c", b"d"):
        inbox.put(data)
    assert inbox.take(0.0) == [b"b", b"c", b"d"]
    inbox.put(b"123456")
    inbox.put(b"1234567")
    assert inbox.take(0.0) == [b"1234567"]
    inbox.put(bytes(100))
    assert inbox.take(0.0) == [bytes(100)] and inbox.take(0.0) == []


def test_a_message_ends_the_wait_for_it():
    inbox, taken = Inbox(), []
    waiting = threading.Thread(target=lambda: taken.extend(inbox.take(60.0)))
    waiting.start()
    inbox.put(b"a")
    waiting.join(30.0)
    assert taken == [b"a"]
