"""Bus traffic as the table that the topic `frames` carries."""

from collections.abc import Iterable

import numpy as np

from fiber_bus_bridge.bus import Exchange
from fiber_core.frame_log import FrameLog

__all__ = ["frame_log"]


def frame_log(exchanges: Iterable[Exchange]) -> FrameLog:
    """Return one row for the bytes written to each robot, and one for the bytes read from it.

    All exchanges go into one log, because polls of moving robots are many and small, and each
    message has a cost of its own.
    """
    return FrameLog.joined(map(_log_of, exchanges))


def _log_of(exchange: Exchange) -> FrameLog:
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
