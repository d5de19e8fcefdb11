# SPDX-License-Identifier: Apache-2.0
"""The lines of one simulated bus over time: messages in turn, stuck lines, stretched clocks."""

from collections.abc import Callable

import numpy as np
from numba import njit

from fiber_bus_bridge.bus.backend import Ack
from fiber_bus_bridge.bus.recovery import Recovery
from fiber_bus_bridge.simulation.faults import Faults, LineFault, LineTrouble
from fiber_core.array_types import Bools, Codes, Floats, Ints, Rows

__all__ = ["STRETCH_LIMIT_S", "BusLines", "carry_in_turn"]

STRETCH_LIMIT_S = 25e-3  # SMBus: a target that holds the clock for longer is timed out
# plain numbers: members of an enumeration are slow to look up message by message
_OK, _LOST, _STUCK = int(Ack.OK), int(Ack.LOST), int(Ack.STUCK)
_TIMED_OUT, _NOT_SENT = int(Ack.TIMED_OUT), int(Ack.NOT_SENT)
_SDA_LOW, _BABBLE = int(LineFault.SDA_LOW), int(LineFault.BABBLE)
_RESET_S, _POWER_S = 1e-3, 50e-3


@njit(cache=True)
def carry_in_turn(
    at: Ints, lasts_s: Floats, not_before_s: Floats, free_s: Floats, start_s: Floats, end_s: Floats
) -> None:
    """Put messages on buses without faults, one after the other on each bus.

    Args:
        at: place of the bus of each message, -1 for messages left out, shape (f,).
        lasts_s: duration of each message [s], shape (f,).
        not_before_s: earliest start of each message [s], shape (f,).
        free_s: time at which each bus is free [s], shape (b,), updated in place.
        start_s: result: start of each message [s], shape (f,).
        end_s: result: end of each message [s], shape (f,).
    """
    for f in range(len(at)):
        if at[f] >= 0:
            start_s[f] = max(free_s[at[f]], not_before_s[f])
            end_s[f] = free_s[at[f]] = start_s[f] + lasts_s[f]


class BusLines:
    """The lines of one bus and their faults.

    Args:
        at: place of the bus among all buses.
        free_s: time at which each bus is free [s], shape (b,); this bus's entry is updated.
        bus: number of the bus.
        faults: faults of all buses.
        rows: robots on this bus, shape (k,).
        bit_s: duration of one bit [s].
    """

    def __init__(self, at: int, free_s: Floats, bus: int, faults: Faults, rows: Rows, bit_s: float):
        self._at, self._free_s, self._bit_s = at, free_s, bit_s
        self._troubles = [trouble for trouble in faults.lines if trouble[1] == bus]
        on_bus = set(np.asarray(rows).tolist())
        self._stretches = [stretch for stretch in faults.stretches if stretch[0] in on_bus]

    @property
    def free_s(self) -> float:
        """Time at which the bus is free [s]."""
        return float(self._free_s[self._at])

    @free_s.setter
    def free_s(self, t: float) -> None:
        self._free_s[self._at] = t

    @property
    def troubled_from_s(self) -> float:
        """Begin of the first fault that is not over [s], inf when no fault is left."""
        now = self._free_s[self._at]
        self._troubles = [trouble for trouble in self._troubles if trouble[3] > now]
        self._stretches = [stretch for stretch in self._stretches if stretch[2] > now]
        begins = [trouble[2] for trouble in self._troubles]
        begins += [stretch[1] for stretch in self._stretches]
        return min(begins, default=np.inf)

    def carry(
        self, lasts_s: Floats, not_before_s: Floats, listeners: Callable[[int], Rows]
    ) -> tuple[Floats, Floats, Codes, Bools]:
        """Put messages on the bus, one after the other.

        Args:
            lasts_s: duration of each message without faults [s], shape (k,).
            not_before_s: earliest start of each message [s], shape (k,).
            listeners: function of i that returns the rows of the targets of message i.

        Returns:
            Start [s], end [s], the Ack that the lines allow, and whether the targets receive the
            message, shape (k,) each.
        """
        k = len(lasts_s)
        ack, delivered = np.full(k, _OK, dtype=np.int64), np.ones(k, dtype=bool)
        start, end = np.empty(k), np.empty(k)
        broken = False
        for i in range(k):
            start[i] = max(self.free_s, not_before_s[i])
            if broken:
                ack[i], delivered[i], end[i] = _NOT_SENT, False, start[i]
                continue
            ack[i], delivered[i], end[i] = self._carry_one(start[i], lasts_s[i], listeners(i))
            broken = ack[i] in (_STUCK, _TIMED_OUT)
            self.free_s = end[i]
        return start, end, ack, delivered

    def _carry_one(self, start_s: float, lasts_s: float, rows: Rows) -> tuple[int, bool, float]:
        """Ack, whether the targets receive the message, and its end [s]."""
        stretch_s = max(
            (s[3] for s in self._stretches if s[0] in rows and s[1] <= start_s < s[2]), default=0.0
        )
        end_s = start_s + lasts_s + min(stretch_s, STRETCH_LIMIT_S)
        trouble = self._first_trouble(start_s, end_s)
        if trouble is None:
            if stretch_s > STRETCH_LIMIT_S:
                return _TIMED_OUT, False, start_s + STRETCH_LIMIT_S
            return _OK, True, end_s
        line, _, since_s, _, _ = trouble
        # a target that has everything but the last acknowledge has received the message
        delivered = since_s >= end_s - self._bit_s
        if line == _BABBLE:
            return _LOST, delivered, max(start_s, since_s) + 9 * self._bit_s
        if line == _SDA_LOW and since_s <= start_s:
            return _STUCK, False, start_s + STRETCH_LIMIT_S
        return _TIMED_OUT, delivered, max(start_s, since_s) + STRETCH_LIMIT_S

    def _first_trouble(self, start_s: float, end_s: float) -> LineTrouble | None:
        """The first line fault between two times [s], or None."""
        found = [t for t in self._troubles if t[2] < end_s and t[3] > start_s]
        return min(found, key=lambda trouble: trouble[2], default=None)

    def recover(self, recovery: Recovery, t: float) -> tuple[float, bool]:
        """Try to free the lines; see BusBackend.recover."""
        start_s = max(t, self.free_s)
        took_s = {
            Recovery.CLOCKS: 11 * self._bit_s,
            Recovery.RESET: _RESET_S,
            Recovery.POWER: _POWER_S,
        }
        self.free_s = start_s + took_s[recovery]
        freed = [x for x in self._troubles if x[2] <= start_s and x[4] <= recovery]
        self._troubles = [x for x in self._troubles if x not in freed]
        free = self._first_trouble(self.free_s, float(np.nextafter(self.free_s, np.inf))) is None
        return self.free_s, free
