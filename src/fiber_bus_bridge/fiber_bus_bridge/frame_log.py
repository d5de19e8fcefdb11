"""Traffic on the buses as the frames topic tells it."""

from collections.abc import Iterable

import numpy as np

from fiber_bus_bridge.bus import Exchange
from fiber_core.frame_log import FrameLog

__all__ = ["frame_log"]


def frame_log(exchanges: Iterable[Exchange]) -> FrameLog:
    """Return one row for what was written to each robot, and one for what was read from it.

    All exchanges go into one log: looks at moving robots are many and small, and messages
    cost by the piece.
    """
    return FrameLog.joined(map(_of_one, exchanges))


def _of_one(exchange):
    sent, replies = exchange.frames, exchange.replies
    lengths = np.stack([sent.lengths, np.diff(replies.offsets)], axis=1)
    both = np.concatenate([sent.data, replies.data])
    begins = np.stack([sent.offsets[:-1], len(sent.data) + replies.offsets[:-1]], axis=1)
    row, read = np.nonzero(lengths)
    offsets = np.concatenate([[0], np.cumsum(lengths[row, read])])
    place = np.repeat(begins[row, read] - offsets[:-1], lengths[row, read]) + np.arange(offsets[-1])
    return FrameLog(
        replies.start_s[row],
        sent.to.bus[row],
        sent.to.address[row],
        sent.to.ten_bit[row],
        read.astype(bool),
        replies.ack[row],
        offsets,
        both[place],
    )
