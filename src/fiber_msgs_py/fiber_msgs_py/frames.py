# SPDX-License-Identifier: Apache-2.0
"""Frames: the bytes that went over each bus, with bus, address and simulated time.

A table and not a UInt8MultiArray: a table has a header for the plan's stamp and names its
columns, and one batch is one message. Bytes are padded with zeros to the longest frame of the
batch.
"""

import numpy as np
from sensor_msgs.msg import PointCloud2

from fiber_core.frame_log import FrameLog
from fiber_core.ragged import Parts
from fiber_msgs_py.errors import MessageError
from fiber_msgs_py.stamps import PlanStamp
from fiber_msgs_py.table import column_names, decode_table, encode_table

__all__ = ["decode", "encode"]

_COLUMNS = {
    "time": "<f8",
    "bus": "<u2",
    "address": "<u2",
    "ten_bit": "<u1",
    "read": "<u1",
    "ack": "<u1",
    "length": "<u2",
}


def encode(log: FrameLog, stamp: PlanStamp) -> PointCloud2:
    """Return a batch of frames as one message.

    Args:
        log: the frames.
        stamp: names the plan.

    Raises:
        MessageError: a number does not fit its column, or offsets do not fit the data.
    """
    lengths = log.lengths
    if len(lengths) != len(log) or log.offsets[0] != 0 or log.offsets[-1] != len(log.data):
        raise MessageError(
            "frames",
            f"bytes are not cut into {len(log)} frames by the offsets",
            value=len(log.data),
        )
    columns = {
        "time": log.time_s,
        "bus": log.bus,
        "address": log.address,
        "ten_bit": log.ten_bit,
        "read": log.read,
        "ack": log.ack,
        "length": lengths,
    }
    width = max(int(lengths.max(initial=0)), 1)
    rows = np.zeros(len(log), dtype=[*_COLUMNS.items(), ("bytes", "<u1", (width,))])
    for name, values in columns.items():
        rows[name] = values
        changed = np.asarray(values) != rows[name]
        if changed.any():
            at = int(np.argmax(changed))
            raise MessageError(
                "frames", f"of frame {at} does not fit", field=name, value=np.asarray(values)[at]
            )
    rows["bytes"][np.arange(width) < lengths[:, None]] = log.data
    return encode_table(rows, stamp)


def decode(message: PointCloud2) -> FrameLog:
    """Return the frames of a batch.

    Raises:
        MessageError: malformed table, or a frame longer than its bytes.
    """
    rows = decode_table(message, "frames", _COLUMNS, lists={"bytes": "<u1"})
    if "bytes" not in column_names(rows):
        raise MessageError("frames", "is missing", field="field", value="bytes")
    lengths = rows["length"].astype(np.int64)
    width = rows["bytes"].shape[1]
    if np.any(lengths > width):
        at = int(np.argmax(lengths > width))
        raise MessageError(
            "frames",
            f"of frame {at} is more than its {width} bytes",
            field="length",
            value=lengths[at],
        )
    return FrameLog(
        time_s=rows["time"].copy(),
        bus=rows["bus"].astype(np.int64),
        address=rows["address"].astype(np.int64),
        ten_bit=rows["ten_bit"].astype(bool),
        read=rows["read"].astype(bool),
        ack=rows["ack"].astype(np.int64),
        offsets=Parts.from_counts(lengths).offsets,
        data=rows["bytes"][np.arange(width) < lengths[:, None]],
    )
