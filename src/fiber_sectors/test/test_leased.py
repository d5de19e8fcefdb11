# SPDX-License-Identifier: Apache-2.0
"""A process that is paused anywhere in a step lets its robots move no longer than the terms say."""

import numpy as np
import pytest

from fiber_bus_bridge.bus import Ack, Replies
from fiber_bus_bridge.wire import Addresses, Frames, Opcode, encode_command, general_call
from fiber_core.ragged import Parts
from fiber_sectors import Terms
from fiber_sectors.leased import LeasedBuses
from fiber_sectors.paced import PacedBuses

SILENCE_S = Terms.notice_s
MESSAGE_S = 2e-5
HEARTBEATS = encode_command(Opcode.HEARTBEAT, general_call([4, 4, 9, 9]))
POLLS = Frames.empty(Addresses(np.array([4, 9, 9]), np.array([8, 8, 9]), np.zeros(3, dtype=bool)))
BATCH = HEARTBEATS.then(POLLS).then(HEARTBEATS)  # a step of the supervision


class Robots:
    """Buses whose process is paused before any message, and robots that stop by themselves.

    Args:
        paused_s: pause before each message, in order of sending [s]; 0 for later ones.
    """

    def __init__(self, paused_s):
        self.now_s, self._paused_s, self.sent = 0.0, list(paused_s), []
        self.beaten_s = {4: 0.0, 9: 0.0}  # the newest heartbeat that moving robots have heard

    def transfer(self, frames, read_bytes, not_before_s):
        read = np.broadcast_to(np.asarray(read_bytes, dtype=np.int64), (len(frames),))
        start_s = np.zeros(len(frames))
        parts = Parts.from_counts(read)
        for row in range(len(frames)):
            self.now_s += self._paused_s.pop(0) if self._paused_s else 0.0
            start_s[row] = self.now_s
            bus, payload = int(frames.to.bus[row]), frames.payload(row)
            self.sent.append((bus, int(frames.to.address[row]), payload))
            if payload and self.now_s < self.beaten_s[bus] + SILENCE_S:
                self.beaten_s[bus] = self.now_s
            self.now_s += MESSAGE_S
        data = np.repeat(frames.to.bus + frames.to.address, read).astype(np.uint8)
        ack = np.full(len(frames), int(Ack.OK))
        return Replies(ack, start_s, start_s + MESSAGE_S, parts.offsets, data)

    @property
    def rest_s(self):
        """Time at which all have stopped by themselves [s]."""
        return max(self.beaten_s.values()) + SILENCE_S


class OneBatch:
    """A session whose step is one batch."""

    class protocol:
        watch = None

    def __init__(self, leased):
        self._leased = leased

    def advance(self, until_s):
        read = np.where(BATCH.lengths > 0, 0, 3)
        self.replies = self._leased.transfer(BATCH, read, until_s)


def step(paused_s, lease_s):
    robots = Robots(paused_s)
    leased = LeasedBuses(robots, lambda: robots.now_s)
    session = OneBatch(leased)
    return robots, session, leased.advance_one_step(session, 0.0, lease_s)


@pytest.mark.parametrize("paused_s", [0.5 * SILENCE_S, 0.98 * SILENCE_S, 1.02 * SILENCE_S])
def test_no_pauses_in_a_step_let_robots_move_longer_than_the_bound(paused_s):
    lease_s, rests_s = 1e-4, []
    beats = np.flatnonzero(BATCH.lengths > 0)
    for which in range(2 ** len(beats)):  # any heartbeats of the step come after a pause
        pauses_s = np.zeros(len(BATCH))
        pauses_s[beats] = paused_s * (which >> np.arange(len(beats)) & 1)
        robots, _, __ = step(pauses_s, lease_s)
        rests_s.append(robots.rest_s)
    assert max(rests_s) <= lease_s + SILENCE_S + Terms.notice_s
    if paused_s < SILENCE_S:  # and the bound needs both: a pause between the look and its message
        assert max(rests_s) > lease_s + paused_s + Terms.notice_s - 10 * MESSAGE_S


def test_what_is_sent_in_time_is_the_batch_and_its_replies_in_their_order():
    robots, session, in_time = step([], 1.0)
    assert in_time
    replies = session.replies
    assert len(robots.sent) == len(BATCH) == len(replies.ack)
    for bus in (4, 9):  # each bus has its messages in their order
        rows = np.flatnonzero(BATCH.to.bus == bus)
        expected = [(bus, int(BATCH.to.address[k]), BATCH.payload(k)) for k in rows]
        assert [each for each in robots.sent if each[0] == bus] == expected
        assert (np.diff(replies.start_s[rows]) > 0.0).all()
    np.testing.assert_array_equal(replies.lengths, np.where(BATCH.lengths > 0, 0, 3))
    np.testing.assert_array_equal(np.repeat(POLLS.to.bus + POLLS.to.address, 3), replies.data)


def test_a_lease_that_ends_in_a_step_ends_its_heartbeats():
    robots, _, in_time = step([0.0, 0.0, 0.0, 2e-4], 1e-4)
    assert not in_time
    assert len(robots.sent) == 4  # the pause came between the look and the last of these


class Simulated(Robots):
    """Robots whose messages follow each other from the time of the first on."""

    def transfer(self, frames, read_bytes, not_before_s):
        self.now_s = float(np.max(not_before_s))
        return super().transfer(frames, read_bytes, not_before_s)


@pytest.mark.parametrize(
    "paused_s", [0.0, 0.5e-4, 2e-4, 0.98 * SILENCE_S, SILENCE_S, 3 * SILENCE_S]
)
@pytest.mark.parametrize("before_look", range(4))
def test_simulated_robots_hear_a_whole_batch_under_the_lease_or_none(paused_s, before_look):
    looks, lease_s = [0], 1e-4
    now_s = [0.0]

    def clock():
        now_s[0] += paused_s if looks[0] == before_look else 0.0
        looks[0] += 1
        return now_s[0]

    def wait(clock_s):
        now_s[0] += clock_s

    robots = Simulated([])
    leased = LeasedBuses(PacedBuses(robots, clock, wait, origin_s=0.0), clock)
    in_time = leased.advance_one_step(OneBatch(leased), 0.0, lease_s)
    assert len(robots.sent) == (len(BATCH) if in_time else 0)
    lasts_s = len(BATCH) * MESSAGE_S
    assert robots.rest_s <= lease_s + lasts_s + SILENCE_S  # a pause lets none move longer
