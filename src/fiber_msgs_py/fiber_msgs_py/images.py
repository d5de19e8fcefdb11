# SPDX-License-Identifier: Apache-2.0
"""Images: the pixels of one exposure, 8 or 16 bits a pixel."""

import array

import numpy as np
from numpy.typing import NDArray
from sensor_msgs.msg import Image

from fiber_msgs_py.errors import MessageError
from fiber_msgs_py.stamps import PlanStamp, header

__all__ = ["decode", "encode"]

_BYTES = {"mono8": 1, "mono16": 2}


def encode(pixels: NDArray[np.uint16], stamp: PlanStamp) -> Image:
    """Return pixels as a message of encoding mono16.

    Args:
        pixels: counts, shape (rows, columns).
        stamp: time of the exposure.
    """
    rows, columns = pixels.shape
    return Image(
        header=header(stamp), height=rows, width=columns, encoding="mono16",
        is_bigendian=0, step=2 * columns,
        data=array.array("B", np.ascontiguousarray(pixels, dtype="<u2").tobytes()),
    )  # fmt: skip


def decode(message: Image) -> NDArray[np.unsignedinteger]:
    """Return the pixels of a message, shape (rows, columns), of its own byte order.

    Raises:
        MessageError: an encoding other than mono8 and mono16, or sizes that contradict each other.
    """
    size = _BYTES.get(message.encoding)
    if size is None:
        raise MessageError(
            "image", f"is not one of {', '.join(_BYTES)}", field="encoding", value=message.encoding
        )
    if not message.height or not message.width:
        raise MessageError(
            "image", "are no pixels", field="sizes", value=(message.height, message.width)
        )
    row = size * message.width
    if message.step < row or len(message.data) < message.step * message.height:
        raise MessageError(
            "image", f"are too few for {message.height} rows of {message.width} pixels",
            field="bytes", value=len(message.data),
        )  # fmt: skip
    data = np.frombuffer(message.data, dtype=np.uint8)[: message.step * message.height]
    lines = np.ascontiguousarray(data.reshape(message.height, message.step)[:, :row])
    order = ">" if message.is_bigendian else "<"
    return lines.view(np.dtype(f"{order}u{size}"))
