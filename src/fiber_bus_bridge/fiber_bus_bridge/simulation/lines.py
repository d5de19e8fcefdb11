"""The lines of one simulated bus in time: messages in turn, lines that stick, slow clocks."""

import numpy as np
from numba import njit

from fiber_bus_bridge.bus.backend import Ack
from fiber_bus_bridge.bus.recovery import Recovery
from fiber_bus_bridge.simulation.faults import Faults, Line

__all__ = ["STRETCH_LIMIT_S", "BusLines", "take_in_turn"]

STRETCH_LIMIT_S = 25e-3  # SMBus: who holds the clock for longer is timed out
# plain numbers: members of an enumeration are slow to look up message by message
_OK, _LOST, _STUCK = int(Ack.OK), int(Ack.LOST), int(Ack.STUCK)
_TIMED_OUT, _NOT_SENT = int(Ack.TIMED_OUT), int(Ack.NOT_SENT)
_SDA_LOW, _BABBLE = int(Line.SDA_LOW), int(Line.BABBLE)
_RESET_S, _POWER_S = 1e-3, 50e-3


@njit(cache=True)
def take_in_turn(at, lasts, not_before_s, free_s, start_s, end_s):
    """Put messages on buses on which nothing is wrong, in turn on each.

    Args:
        at: place of the bus of each message, -1 for those left alone, shape (f,).
        lasts: how long each takes [s], shape (f,).
        not_before_s: earliest start of each [s], shape (f,).
        free_s: when each bus is free [s], shape (b,); brought up to date.
        start_s: filled in [s], shape (f,).
        end_s: filled in [s], shape (f,).
    """
    for f in range(len(at)):
        if at[f] >= 0:
            start_s[f] = max(free_s[at[f]], not_before_s[f])
            end_s[f] = free_s[at[f]] = start_s[f] + lasts[f]


class BusLines:
    """The lines of one bus, and what is wrong with them.

    Args:
        at: place of the bus among all.
        free_s: when each bus is free [s], shape (b,); this one's is kept up to date.
        bus: its number.
        faults: what will go wrong, on any bus.
        rows: robots on this bus, shape (k,).
        bit_s: one bit [s].
    """

    def __init__(self, at: int, free_s, bus: int, faults: Faults, rows, bit_s: float):
        self._at, self._free_s, self._bit_s = at, free_s, bit_s
        self._troubles = [trouble for trouble in faults.lines if trouble[1] == bus]
        here = set(np.asarray(rows).tolist())
        self._stretches = [stretch for stretch in faults.stretches if stretch[0] in here]

    @property
    def free_s(self) -> float:
        """When the bus is free [s]."""
        return float(self._free_s[self._at])

    @free_s.setter
    def free_s(self, t: float):
        self._free_s[self._at] = t

    @property
    def troubled_from_s(self) -> float:
        """From when on anything is wrong that is not over yet [s]; inf if nothing ever will be."""
        now = self._free_s[self._at]
        self._troubles = [x for x in self._troubles if x[3] > now]
        self._stretches = [x for x in self._stretches if x[2] > now]
        begins = [x[2] for x in self._troubles] + [x[1] for x in self._stretches]
        return min(begins, default=np.inf)

    def take(self, lasts, not_before_s, listeners):
        """Put messages on the bus in turn.

        Args:
            lasts: how long each takes when nothing is wrong [s], shape (k,).
            not_before_s: earliest start of each [s], shape (k,).
            listeners: function of i, the rows that listen to message i.

        Returns:
            Start and end [s], the Ack the lines allow, and whether targets hear it, (k,) each.
        """
        k = len(lasts)
        ack, heard = np.full(k, _OK, dtype=np.int64), np.ones(k, dtype=bool)
        start, end = np.empty(k), np.empty(k)
        broken = False
        for i in range(k):
            start[i] = max(self.free_s, not_before_s[i])
            if broken:
                ack[i], heard[i], end[i] = _NOT_SENT, False, start[i]
                continue
            ack[i], heard[i], end[i] = self._one(start[i], lasts[i], listeners(i))
            broken = ack[i] in (_STUCK, _TIMED_OUT)
            self.free_s = end[i]
        return start, end, ack, heard

    def _one(self, start, lasts, rows):
        stretch = max(
            (s[3] for s in self._stretches if s[0] in rows and s[1] <= start < s[2]), default=0.0
        )
        end = start + lasts + min(stretch, STRETCH_LIMIT_S)
        trouble = self._trouble(start, end)
        if trouble is None:
            if stretch > STRETCH_LIMIT_S:
                return _TIMED_OUT, False, start + STRETCH_LIMIT_S
            return _OK, True, end
        line, _, since, _, _ = trouble
        # whoever had all but the last acknowledge has heard the message
        heard = since >= end - self._bit_s
        if line == _BABBLE:
            return _LOST, heard, max(start, since) + 9 * self._bit_s
        if line == _SDA_LOW and since <= start:
            return _STUCK, False, start + STRETCH_LIMIT_S
        return _TIMED_OUT, heard, max(start, since) + STRETCH_LIMIT_S

    def _trouble(self, start, end):
        """The first trouble between two times, or None."""
        found = [t for t in self._troubles if t[2] < end and t[3] > start]
        return min(found, key=lambda t: t[2], default=None)

    def recover(self, cure: Recovery, t: float) -> tuple[float, bool]:
        """Try to free the lines; see BusBackend.recover."""
        start = max(t, self.free_s)
        took = {
            Recovery.CLOCKS: 11 * self._bit_s,
            Recovery.RESET: _RESET_S,
            Recovery.POWER: _POWER_S,
        }
        self.free_s = start + took[cure]
        healed = [x for x in self._troubles if x[2] <= start and x[4] <= cure]
        self._troubles = [x for x in self._troubles if x not in healed]
        return self.free_s, self._trouble(self.free_s, np.nextafter(self.free_s, np.inf)) is None
