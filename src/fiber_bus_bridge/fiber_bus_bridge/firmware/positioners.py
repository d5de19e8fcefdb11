"""All simulated positioners of a focal plane; they understand the wire format and nothing else."""

import numpy as np
from numba import njit

from fiber_bus_bridge.errors import WireError
from fiber_bus_bridge.firmware.drive import encoder, halt, reboot, settle
from fiber_bus_bridge.firmware.memory import new_memory
from fiber_bus_bridge.firmware.protocol import answer, hear
from fiber_bus_bridge.wire import Addresses, Frames, RobotState

__all__ = ["Positioners"]

_ENCODER_RANGE = 2**31
_UNCONFIGURED = int(RobotState.UNCONFIGURED)


class Positioners:
    """Simulated positioners: they store orders, check them, and run them on their own clocks.

    A joint moves by the decoded whole numbers and nothing is ever rounded at a tick.
    Nothing is known to them but the bytes they heard and when.

    Not modelled: acceleration, backlash, stalls, stuck joints and contact between arms.

    Args:
        addresses: where each robot listens, n rows.
        serial: number each was built with, shape (n,), 0..2^32 - 1.
        quantum_prad: what one count of their encoders is [1e-12 rad].
        position: encoders at the beginning [quanta], shape (n, 2).
        clock_ppm: how much faster than true time each clock runs [1e-6], one number or (n,).
        start_skew_s: how long after a GO each begins to move [s], one number or (n,).

    Raises:
        WireError: a serial number or an encoder value does not fit its field.
    """

    def __init__(
        self, addresses: Addresses, serial, quantum_prad: int, position,
        clock_ppm=0.0, start_skew_s=0.0,
    ):  # fmt: skip
        serial, position = np.asarray(serial), np.asarray(position)
        for name, wrong, value in (
            ("serial number", (serial < 0) | (serial >= 2**32), serial),
            ("encoder", np.abs(position) >= _ENCODER_RANGE, position),
        ):
            if wrong.any():
                at = int(np.argwhere(wrong)[0][0])
                raise WireError(f"row {at}: {name} {value[at].tolist()} does not fit 32 bits")
        self.addresses = addresses
        self.memory = new_memory(addresses, serial, quantum_prad, position, clock_ppm, start_skew_s)
        self.powered = np.ones(len(addresses), dtype=bool)

    @property
    def n(self) -> int:
        """Number of robots."""
        return len(self.addresses)

    def positions(self, t: float) -> np.ndarray:
        """True joint positions at time t [s], not earlier than anything heard: [quanta], (n, 2)."""
        out = np.empty((self.n, 2), dtype=np.int64)
        _positions(self.memory, t, out)
        return out

    def states(self, t: float) -> np.ndarray:
        """RobotState of each robot at time t [s], shape (n,)."""
        _settle_all(self.memory, t)
        return self.memory["state"].copy()

    def power(self, rows, on: bool, t: float) -> None:
        """Cut or give power to some robots at time t [s]; with power they boot unconfigured."""
        rows = np.atleast_1d(rows)
        _power(self.memory, rows[self.powered[rows] != on], on, t)
        self.powered[rows] = on

    def exchange(
        self, order, low, high, frames: Frames, offsets, start_s, end_s
    ) -> tuple[np.ndarray, np.ndarray]:
        """Let robots hear frames in turn and answer reads.

        Args:
            order: rows of robots; those listening to frame i are order[low[i] : high[i]].
            low: shape (f,).
            high: shape (f,).
            frames: what each hears; a frame without data is a plain read.
            offsets: bytes to answer, shape (f + 1,), as in Replies.
            start_s: when each frame begins [s], shape (f,); a plain read is of that instant.
            end_s: when each is complete [s], shape (f,); writes take effect then.

        Returns:
            Whether anybody acknowledged the last byte written, shape (f,), and the bytes
            read, shape (offsets[-1],), 0xFF where nobody answers.
        """
        accepted = np.zeros(len(frames), dtype=np.bool_)
        data = np.full(offsets[-1], 0xFF, dtype=np.uint8)
        _exchange(
            self.memory, self.powered, order, low, high, frames.to.address, frames.to.ten_bit,
            frames.offsets, frames.data, offsets, start_s, end_s, accepted, data,
        )  # fmt: skip
        return accepted, data


@njit(cache=True)
def _exchange(
    m, powered, order, low, high, address, ten_bit, starts, sent, offsets, start_s, end_s,
    accepted, data,
):  # fmt: skip
    for f in range(len(low)):
        writes = starts[f + 1] > starts[f]
        for k in range(low[f], high[f]):
            row = order[k]
            if not powered[row]:
                continue
            ok = True
            if writes:
                ok = hear(m[row], address[f], ten_bit[f], sent, starts[f], starts[f + 1], end_s[f])
            if ok and offsets[f + 1] > offsets[f]:
                at = end_s[f] if writes else start_s[f]
                answer(m[row], at, data[offsets[f] : offsets[f + 1]])
            accepted[f] |= ok


@njit(cache=True)
def _positions(m, t, out):
    for row in range(len(out)):
        settle(m[row], t)
        for joint in range(2):
            out[row, joint] = encoder(m[row], joint, t)


@njit(cache=True)
def _settle_all(m, t):
    for row in range(len(m)):
        settle(m[row], t)


@njit(cache=True)
def _power(m, rows, on, t):
    for row in rows:
        if on:
            reboot(m[row], t)
        else:
            settle(m[row], t)
            halt(m[row], t)
            m[row].state = _UNCONFIGURED  # the rest it forgets when it boots
