# SPDX-License-Identifier: Apache-2.0
"""The traffic of a sector's buses in its answers: the coordinator publishes it for recordings."""

from collections.abc import Sequence

import numpy as np

from fiber_bus_bridge.bus import Exchange, Replies
from fiber_bus_bridge.errors import WireError
from fiber_bus_bridge.wire import Addresses, Frames
from fiber_core.array_types import Ints
from fiber_core.ragged import Parts
from fiber_sectors.calls import Columns, column
from fiber_sectors.errors import SectorError

__all__ = ["traffic_columns", "traffic_of"]

_MOST_S = 1e10


def traffic_columns(traffic: Sequence[Exchange]) -> Columns:
    """Return the columns of some batches, as one batch; none for none."""
    if not traffic:
        return {}
    frames, replies = traffic[0].frames, [each.replies for each in traffic]
    for each in traffic[1:]:
        frames = frames.then(each.frames)
    lengths = np.concatenate([each.lengths for each in replies])
    return {
        "frame_bus": frames.to.bus,
        "frame_address": frames.to.address,
        "frame_ten_bit": frames.to.ten_bit,
        "frame_offsets": frames.offsets,
        "frame_data": frames.data,
        "reply_ack": np.concatenate([each.ack for each in replies]),
        "reply_start_s": np.concatenate([each.start_s for each in replies]),
        "reply_end_s": np.concatenate([each.end_s for each in replies]),
        "reply_offsets": Parts.from_counts(lengths).offsets,
        "reply_data": np.concatenate([each.data for each in replies]),
    }


def traffic_of(columns: Columns, buses: Ints) -> Exchange | None:
    """Return the traffic in an answer, None without any; times are those of the sector.

    Args:
        columns: the columns of the answer.
        buses: numbers of the buses of the sector.

    Raises:
        SectorError: a column is missing or malformed.
    """
    if "frame_bus" not in columns:
        return None
    bus = column(columns, "frame_bus", "i8", (None,))
    f = len(bus)
    address = column(columns, "frame_address", "i8", (f,))
    to = bus, address, column(columns, "frame_ten_bit", "?", (f,))
    offsets, data = _ragged(columns, "frame", f)
    read, replied = _ragged(columns, "reply", f)
    ack = column(columns, "reply_ack", "i8", (f,), 0, 6)
    begins_s = column(columns, "reply_start_s", "f8", (f,), -_MOST_S, _MOST_S)
    ends_s = column(columns, "reply_end_s", "f8", (f,), -_MOST_S, _MOST_S)
    if not np.isin(bus, buses).all():
        raise SectorError("traffic of a bus that the sector does not have")
    try:
        replies = Replies(ack, begins_s, ends_s, read, replied)
        return Exchange(Frames(Addresses(*to), offsets, data), replies)
    except WireError as error:
        raise SectorError(f"traffic that is none: {error}") from error


def _ragged(columns: Columns, name: str, parts: int) -> tuple[Ints, np.ndarray]:
    offsets = column(columns, f"{name}_offsets", "i8", (parts + 1,))
    data = column(columns, f"{name}_data", "u1", (None,))
    if not Parts(offsets).cover(parts, len(data)):
        raise SectorError(f"offsets of {name}s that are not those of {len(data)} bytes")
    return offsets, data
