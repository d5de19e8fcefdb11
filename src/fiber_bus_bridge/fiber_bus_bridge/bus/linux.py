# SPDX-License-Identifier: Apache-2.0
"""Real buses: messages to /dev/i2c-N through the Linux kernel."""

import errno
import logging
import time
from collections.abc import Callable, Iterator, Mapping
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from fiber_bus_bridge.bus.backend import Ack, Replies
from fiber_bus_bridge.bus.recovery import Recovery
from fiber_bus_bridge.errors import TopologyError
from fiber_bus_bridge.wire import CALL_PREFIX, Frames, Opcode
from fiber_core.array_types import Floats, Ints
from fiber_core.ragged import Parts
from fiber_core.threads import started_pool

if TYPE_CHECKING:
    from smbus2 import i2c_msg

__all__ = ["ACK_OF_ERRNO", "LinuxBuses"]

_BATCH = 42  # largest number of messages in one I2C_RDWR
_TEN_BIT = 0x10  # I2C_M_TEN
_GO = int(Opcode.GO)

# Errors of the kernel's drivers (Documentation/i2c/fault-codes). Drivers differ in how they
# distinguish a refused address from a refused byte: EREMOTEIO and EIO stand for both.
ACK_OF_ERRNO = {
    errno.ENXIO: Ack.NO_ADDRESS,
    errno.ENODEV: Ack.NO_ADDRESS,
    errno.EREMOTEIO: Ack.NO_ADDRESS,
    errno.EIO: Ack.NO_ADDRESS,
    errno.EBADMSG: Ack.REFUSED,
    errno.EAGAIN: Ack.LOST,
    errno.EBUSY: Ack.STUCK,
    errno.ETIMEDOUT: Ack.TIMED_OUT,
}
_LOG = logging.getLogger(__name__)


class LinuxBuses:
    """A set of I2C adapters of this machine, each served by a thread of its own from the begin.

    The kernel takes up to 42 messages at a time, joined by repeated START. When one of them
    fails, the kernel does not report which: all messages of that batch are sent again one by
    one. So only messages that may be repeated are batched, and GO is always sent alone. The
    driver of an adapter sets its clock and frees its lines; there is no alert line. An adapter
    that reports an error which is not an error of a bus cannot be used: its bus counts as
    stuck, and the error is logged.

    No physical bus has been driven with this class.

    Args:
        devices: path of the device of each bus number, as "/dev/i2c-1".
        power: called with a bus number to power-cycle its branch; None where that is impossible.
        clock: returns the time [s]; all times of this class are times of this clock.
        wait: waits for a number of seconds.

    Raises:
        ModuleNotFoundError: smbus2 is not installed.
        OSError: a device cannot be opened.
    """

    def __init__(
        self,
        devices: Mapping[int, str],
        power: Callable[[int], None] | None = None,
        clock: Callable[[], float] = time.monotonic,
        wait: Callable[[float], None] = time.sleep,
    ):
        from smbus2 import SMBus

        self._devices = {bus: SMBus(path) for bus, path in devices.items()}
        self._power, self._clock, self._wait = power, clock, wait
        self._threads = started_pool(max(len(self._devices), 1))

    def close(self) -> None:
        """Close every device."""
        self._threads.shutdown()
        for device in self._devices.values():
            device.close()

    def transfer(self, frames: Frames, read_bytes: ArrayLike, not_before_s: ArrayLike) -> Replies:
        """Carry a batch of messages; see BusBackend.transfer.

        Raises:
            TopologyError: a bus has no device.
        """
        f = len(frames)
        read = np.broadcast_to(np.asarray(read_bytes, dtype=np.int64), (f,))
        before = np.broadcast_to(np.asarray(not_before_s, dtype=float), (f,))
        offsets = Parts.from_counts(read).offsets
        replies = Replies(
            np.full(f, Ack.NOT_SENT, dtype=np.int64), np.zeros(f), np.zeros(f), offsets,
            np.full(offsets[-1], 0xFF, dtype=np.uint8),
        )  # fmt: skip
        work = []
        for bus in np.unique(frames.to.bus).tolist():
            if bus not in self._devices:
                raise TopologyError(f"bus {bus} has no device, there are {sorted(self._devices)}")
            rows = np.flatnonzero(frames.to.bus == bus)
            work.append(self._threads.submit(self._serve, bus, frames, read, before, rows, replies))
        for task in work:
            task.result()
        return replies

    def recover(self, bus: int, recovery: Recovery, t: float) -> tuple[float, bool]:
        """Try to free the lines of a bus; see BusBackend.recover.

        A driver frees stuck lines by itself when it can, so CLOCKS reports free lines and the
        next message is another try. The kernel has no call for a RESET of the branch.
        """
        powered = recovery == Recovery.POWER and self._power is not None
        if powered and self._power is not None:
            self._power(bus)
        return self._clock(), recovery == Recovery.CLOCKS or powered

    def alert_lines(self, t: float) -> Ints:
        """Return no bus: there is no alert line."""
        return np.zeros(0, dtype=np.int64)

    def _serve(
        self, bus: int, frames: Frames, read: Ints, before: Floats, rows: Ints, replies: Replies
    ) -> None:
        """Send the frames of one bus, in its thread."""
        for batch in _batches(frames, read, before, rows):
            self._wait(max(0.0, before[batch[0]] - self._clock()))
            if len(batch) > 1 and self._send(bus, frames, read, batch, replies) == Ack.OK:
                continue
            for row in batch:
                ack = self._send(bus, frames, read, [row], replies)
                if ack in (Ack.STUCK, Ack.TIMED_OUT):
                    self._mark_not_sent(rows[np.searchsorted(rows, row) + 1 :], replies)
                    return

    def _mark_not_sent(self, rows: Ints, replies: Replies) -> None:
        replies.ack[rows] = Ack.NOT_SENT
        replies.start_s[rows] = replies.end_s[rows] = self._clock()

    def _send(self, bus: int, frames: Frames, read: Ints, rows: list[int], replies: Replies) -> Ack:
        """Send some frames in one call of the kernel; record the result and return it."""
        messages, buffers = [], []
        for row in rows:
            out, buffer = _messages(frames, read, row)
            messages += out
            buffers.append(buffer)
        replies.start_s[rows] = self._clock()
        try:
            self._devices[bus].i2c_rdwr(*messages)
            ack = Ack.OK
        except OSError as error:
            number = error.errno if error.errno is not None else 0
            if number not in ACK_OF_ERRNO:
                _LOG.error("bus %d counts as stuck: %s", bus, error)
            ack = ACK_OF_ERRNO.get(number, Ack.STUCK)
        replies.end_s[rows] = self._clock()
        replies.ack[rows] = ack
        for row, buffer in zip(rows, buffers):
            if ack == Ack.OK and buffer is not None:
                first, last = replies.offsets[row], replies.offsets[row + 1]
                replies.data[first:last] = np.frombuffer(bytes(buffer), dtype=np.uint8)
        return ack


def _messages(frames: Frames, read: Ints, row: int) -> tuple[list["i2c_msg"], "i2c_msg | None"]:
    """Return the kernel's messages of a frame, and the one that receives the reply."""
    from smbus2 import i2c_msg

    address, out, buffer = int(frames.to.address[row]), [], None
    if frames.lengths[row] or not read[row]:
        out.append(i2c_msg.write(address, frames.payload(row)))
    if read[row]:
        buffer = i2c_msg.read(address, int(read[row]))
        out.append(buffer)
    if frames.to.ten_bit[row]:
        for message in out:
            message.flags |= _TEN_BIT
    return out, buffer


def _batches(frames: Frames, read: Ints, before: Floats, rows: Ints) -> Iterator[list[int]]:
    """Yield the frames of a bus in batches that may be repeated and are due together."""
    batch: list[int] = []
    size = 0
    for row in rows.tolist():
        needs = 1 + bool(read[row] and frames.lengths[row])
        alone = _starts_motion(frames.payload(row))
        due = bool(batch) and before[row] > before[batch[0]]
        if batch and (alone or due or size + needs > _BATCH):
            yield batch
            batch, size = [], 0
        batch.append(row)
        size += needs
        if alone:
            yield batch
            batch, size = [], 0
    if batch:
        yield batch


def _starts_motion(payload: bytes) -> bool:
    body = payload[1:] if payload[:1] == bytes([CALL_PREFIX]) else payload
    return len(body) > 0 and body[0] >> 4 == _GO
