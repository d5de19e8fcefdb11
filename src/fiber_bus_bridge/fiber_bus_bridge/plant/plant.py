# SPDX-License-Identifier: Apache-2.0
"""The plant: simulated buses and robots, the rule of their time, and their true motion."""

import numpy as np
from numpy.typing import ArrayLike

from fiber_bus_bridge.bus import Recovery, Replies
from fiber_bus_bridge.errors import BridgeError
from fiber_bus_bridge.plant.order_watch import OrderWatch
from fiber_bus_bridge.simulation import Movements, SimulatedBuses, TrueMotion
from fiber_bus_bridge.wire import Frames, Opcode, RobotState
from fiber_core.array_types import Bools, Counts, Ints
from fiber_core.bounds import check_number

__all__ = ["Plant"]

_STEP_S = 0.1  # simulated time between two looks at robots that run on as fast as possible
_TICK_S = 0.1  # simulated time that a bridge waits for between two batches of traffic
_ORDER_PATIENCE_S = 10.0
_HEARTBEAT = int(Opcode.HEARTBEAT)
_MOST_SCALE = 1e6


class Plant:
    """Simulated buses and robots whose time goes on when their bridge falls silent.

    While a bridge talks, time advances with its traffic alone, so that the same calls give the
    same bytes as buses in the process of the bridge. When the connection ends, or no request comes
    for `patience_s` and two ticks of a bridge while robots move (for 10 s while orders wait), time
    goes on by itself: `time_scale` simulated seconds a second, counted from the last request; with
    0 at once, until all robots are at rest and no order waits. Then time stands still.

    The time of the machine, wall_s [s], is an argument of every call.

    Args:
        buses: the buses and robots.
        quantum_rad: size of one encoder count [rad].
        time_scale: simulated seconds per second, 0 = as fast as possible.
        patience_s: time after which a connected bridge counts as silent [s].
        kept: number of movements of the true motion that are kept.

    Raises:
        BridgeError: a number is negative or absurd.
    """

    def __init__(
        self,
        buses: SimulatedBuses,
        quantum_rad: float,
        time_scale: float = 1.0,
        patience_s: float = 1.0,
        kept: int = 20_000,
    ):
        check_number(time_scale, "time_scale", 0.0, _MOST_SCALE, BridgeError)
        check_number(patience_s, "patience_s", 0.0, _MOST_SCALE, BridgeError)
        check_number(kept, "kept", 1, 10_000_000, BridgeError, whole=True)
        self.buses, self.robots = buses, buses.positioners
        self.truth = TrueMotion(self.robots, quantum_rad, max(kept, 2 * self.robots.n))
        self.controller = 0  # number of the bridge that is or was connected, from 1
        self.connected = False
        self._orders = OrderWatch(self.robots)
        self._scale = time_scale
        self._patience_s = patience_s + (2 * _TICK_S / time_scale if time_scale else 0.0)
        self._heard_wall_s = self._heard_s = 0.0
        self._origin: list[tuple[int, bool]] = []  # controller and whether verified, per movement
        self._origin_from = 0
        self._observe()  # robots of an earlier plant may move

    @property
    def now_s(self) -> float:
        """Simulated time that all buses have reached [s]."""
        return self.buses.now_s

    @property
    def moving(self) -> int:
        """Number of robots that move or count down."""
        return int((self.robots.memory["state"] == RobotState.MOVING).sum())

    @property
    def waiting(self) -> int:
        """Number of robots with an order that will lapse."""
        memory = self.robots.memory
        return int(((memory["state"] == RobotState.LOADED) & (memory["watchdog_s"] > 0)).sum())

    def open(self, wall_s: float) -> None:
        """A bridge takes the buses."""
        self.run_on(wall_s)
        self.controller += 1
        self.connected = True
        self._heard(wall_s)

    def close(self) -> None:
        """The bridge is gone."""
        self.connected = False

    def transfer(
        self, frames: Frames, read_bytes: Ints, not_before_s: ArrayLike, wall_s: float
    ) -> Replies:
        """Carry a batch of the bridge; see BusBackend.transfer. `read_bytes` has shape (f,)."""
        replies = self.buses.transfer(frames, read_bytes, not_before_s)
        # most batches supervise a motion: looking at all robots each time would double their cost
        begins = _may_begin(frames)
        if begins or self._orders.unread:
            self._orders.observe(self.controller, frames, read_bytes, replies)
        if begins:
            self._observe()
        self._heard(wall_s)
        return replies

    def recover(self, bus: int, recovery: Recovery, t: float, wall_s: float) -> tuple[float, bool]:
        """Try to free the lines of a bus; see BusBackend.recover."""
        result = self.buses.recover(bus, recovery, t)
        self._observe()
        self._heard(wall_s)
        return result

    def alert_lines(self, t: float, wall_s: float) -> Ints:
        """Return the buses with a low alert line; see BusBackend.alert_lines."""
        low = self.buses.alert_lines(t)
        self._heard(wall_s)
        return low

    def run_on(self, wall_s: float) -> bool:
        """Let time go on if the bridge is silent; return whether it goes on by itself."""
        moving, waiting = self.moving, self.waiting
        if not moving and not waiting:
            return False
        if self.connected:
            patience_s = self._patience_s if moving else max(_ORDER_PATIENCE_S, self._patience_s)
            if wall_s < self._heard_wall_s + patience_s:
                return False
        if self._scale:
            t = self._heard_s + (wall_s - self._heard_wall_s) * self._scale
            self._advance(max(t, self.now_s))
            return True
        while self.moving or self.waiting:
            self._advance(self.now_s + _STEP_S)
        return True

    def true_movements(self, number: int) -> tuple[int, Counts, Movements, Ints, Bools]:
        """Return the movements from a number on, as TrueMotion.since, and what began them.

        Args:
            number: number of the first movement.

        Returns:
            As TrueMotion.since; then the controller of each movement, and whether it had loaded and
            read back the order, shape (r,) each.
        """
        self._observe()
        first, start, moves = self.truth.since(number)
        chosen = self._origin[first - self._origin_from :]
        table = np.array(chosen, dtype=np.int64).reshape(-1, 2)
        return first, start, moves, table[:, 0], table[:, 1] > 0

    def _advance(self, t: float) -> None:
        self.buses.run_until(t)
        self._observe()

    def _heard(self, wall_s: float) -> None:
        self._heard_wall_s, self._heard_s = wall_s, self.now_s

    def _observe(self) -> None:
        self.truth.observe()
        known = self._origin_from + len(self._origin)
        if self.truth.count > known:
            rows = self.truth.rows_from(known)
            verified = self._orders.verified(self.controller, rows)
            self._origin += [(self.controller, bool(each)) for each in verified]
        if self.truth.forgotten > self._origin_from:
            del self._origin[: self.truth.forgotten - self._origin_from]
            self._origin_from = self.truth.forgotten


def _may_begin(frames: Frames) -> bool:
    """Whether a frame of a batch can load an order or begin a movement."""
    first = frames.offsets[:-1][frames.lengths > 0]
    return bool((frames.data[first] >> 4 != _HEARTBEAT).any())
