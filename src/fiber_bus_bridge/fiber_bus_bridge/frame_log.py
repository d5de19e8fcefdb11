# SPDX-License-Identifier: Apache-2.0
"""Bus traffic as the table that the topic `frames` carries."""

from collections.abc import Iterable

import numpy as np

from fiber_bus_bridge.bus import Exchange
from fiber_core.frame_log import FrameLog
from fiber_core.ragged import Parts

__all__ = ["frame_log"]


def frame_log(exchanges: Iterable[Exchange]) -> FrameLog:
    """Return one row for the bytes written to each robot, and one for the bytes read from it.

    All exchanges go into one log, because polls of moving robots are many and small, and each
    message has a cost of its own.
    """
    return FrameLog.joined(map(_log_of, exchanges))


def _log_of(exchange: Exchange) -> FrameLog:
    sent, replies = exchange.frames, exchange.replies
    lengths = np.stack([sent.lengths, replies.lengths], axis=1)
    both = np.concatenate([sent.data, replies.data])
    begins = np.stack([sent.offsets[:-1], len(sent.data) + replies.offsets[:-1]], axis=1)
    row, read = np.nonzero(lengths)
    parts, place = Parts.gather(begins[row, read], lengths[row, read])
    return FrameLog(
        replies.start_s[row],
        sent.to.bus[row],
        sent.to.address[row],
        sent.to.ten_bit[row],
        read.astype(bool),
        replies.ack[row],
        parts.offsets,
        both[place],
    )
