"""Real buses: messages to /dev/i2c-N through the Linux kernel."""

import errno
import logging
import time
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor

import numpy as np

from fiber_bus_bridge.bus.backend import Ack, Replies
from fiber_bus_bridge.bus.recovery import Recovery
from fiber_bus_bridge.errors import TopologyError
from fiber_bus_bridge.wire import CALL_PREFIX, Frames, Opcode

__all__ = ["ACK_OF_ERRNO", "LinuxBuses"]

_BATCH = 42  # messages of one I2C_RDWR that the kernel takes
_TEN_BIT = 0x10  # I2C_M_TEN
_GO = int(Opcode.GO)

# What the kernel's drivers report (Documentation/i2c/fault-codes). They differ in how they tell
# a refused address from a refused byte: EREMOTEIO and EIO stand for both.
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
    """A set of I2C adapters of this machine, each served by a thread of its own.

    Messages go to the kernel by up to 42 at a time, joined by repeated START. When one of them
    fails the kernel does not say which: all of that batch are sent again one by one, so only
    what may be repeated is batched, and GO always goes alone. The clock of an adapter is set
    by its driver, and so is how lines are freed; there is no alert line. An adapter that
    reports what is no fault of a bus cannot be used: it counts as stuck, and the log says why.

    No physical bus has been driven with it.

    Args:
        devices: path of the device of each bus number, as "/dev/i2c-1".
        power: called with a bus number to power-cycle its branch, if that can be done.
        clock: tells the time [s], of which all times here are.
        wait: waits so many seconds.

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
        self._threads = ThreadPoolExecutor(max(len(self._devices), 1))

    def close(self) -> None:
        """Close every device."""
        self._threads.shutdown()
        for device in self._devices.values():
            device.close()

    def transfer(self, frames: Frames, read_bytes, not_before_s) -> Replies:
        """Carry a batch of messages; see BusBackend.transfer.

        Raises:
            TopologyError: there is no device for a bus.
        """
        f = len(frames)
        read = np.broadcast_to(np.asarray(read_bytes, dtype=np.int64), (f,))
        before = np.broadcast_to(np.asarray(not_before_s, dtype=float), (f,))
        offsets = np.concatenate([[0], np.cumsum(read)])
        replies = Replies(
            np.full(f, Ack.NOT_SENT, dtype=np.int64), np.zeros(f), np.zeros(f), offsets,
            np.full(offsets[-1], 0xFF, dtype=np.uint8),
        )  # fmt: skip
        work = []
        for bus in np.unique(frames.to.bus).tolist():
            if bus not in self._devices:
                raise TopologyError(f"no device for bus {bus}")
            rows = np.flatnonzero(frames.to.bus == bus)
            work.append(self._threads.submit(self._serve, bus, frames, read, before, rows, replies))
        for one in work:
            one.result()
        return replies

    def recover(self, bus: int, cure: Recovery, t: float) -> tuple[float, bool]:
        """Try to free the lines of a bus; see BusBackend.recover.

        A driver frees the lines itself, if it can, when it finds them stuck: after CLOCKS it
        is worth another try, a RESET of the branch cannot be asked of the kernel.
        """
        if cure == Recovery.POWER and self._power is not None:
            self._power(bus)
        return self._clock(), cure == Recovery.CLOCKS or (
            cure == Recovery.POWER and bool(self._power)
        )

    def alert_lines(self, t: float) -> np.ndarray:
        """Return no bus: there is no alert line."""
        return np.zeros(0, dtype=np.int64)

    def _serve(self, bus, frames, read, before, rows, replies):
        for batch in _batches(frames, read, before, rows):
            self._wait(max(0.0, before[batch[0]] - self._clock()))
            if len(batch) > 1 and self._send(bus, frames, read, batch, replies) == Ack.OK:
                continue
            for row in batch:
                ack = self._send(bus, frames, read, [row], replies)
                if ack in (Ack.STUCK, Ack.TIMED_OUT):
                    self._not_sent(rows[np.searchsorted(rows, row) + 1 :], replies)
                    return

    def _not_sent(self, rows, replies):
        replies.ack[rows] = Ack.NOT_SENT
        replies.start_s[rows] = replies.end_s[rows] = self._clock()

    def _send(self, bus, frames, read, rows, replies):
        """Send some frames in one go, note how that ended, and return it."""
        messages, answers = [], []
        for row in rows:
            out, answer = _messages(frames, read, row)
            messages += out
            answers.append(answer)
        replies.start_s[rows] = self._clock()
        try:
            self._devices[bus].i2c_rdwr(*messages)
            ack = Ack.OK
        except OSError as error:
            if error.errno not in ACK_OF_ERRNO:
                _LOG.error("bus %d: %s", bus, error)
            ack = ACK_OF_ERRNO.get(error.errno, Ack.STUCK)
        replies.end_s[rows] = self._clock()
        replies.ack[rows] = ack
        for row, answer in zip(rows, answers):
            if ack == Ack.OK and answer is not None:
                first, last = replies.offsets[row], replies.offsets[row + 1]
                replies.data[first:last] = np.frombuffer(bytes(answer), dtype=np.uint8)
        return ack


def _messages(frames, read, row):
    """The kernel's messages of a frame, and the one that is read into."""
    from smbus2 import i2c_msg

    address, out, answer = int(frames.to.address[row]), [], None
    if frames.lengths[row] or not read[row]:
        out.append(i2c_msg.write(address, frames.payload(row)))
    if read[row]:
        answer = i2c_msg.read(address, int(read[row]))
        out.append(answer)
    if frames.to.ten_bit[row]:
        for message in out:
            message.flags |= _TEN_BIT
    return out, answer


def _batches(frames, read, before, rows):
    """Cut the frames of a bus into batches that may be repeated and are due together."""
    batch, size = [], 0
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


def _starts_motion(payload):
    body = payload[1:] if payload[:1] == bytes([CALL_PREFIX]) else payload
    return len(body) > 0 and body[0] >> 4 == _GO
