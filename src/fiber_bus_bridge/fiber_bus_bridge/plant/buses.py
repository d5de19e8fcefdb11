# SPDX-License-Identifier: Apache-2.0
"""The bus backend of a bridge whose robots are in the process of a plant."""

import logging
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from fiber_bus_bridge.bus import Ack, BusTiming, Recovery, Replies
from fiber_bus_bridge.plant.link import PlantLink
from fiber_bus_bridge.plant.messages import Columns, Kind, PlantError
from fiber_bus_bridge.wire import Addresses, Frames
from fiber_core.array_types import Ids, Ints
from fiber_core.ragged import Parts

__all__ = ["PlantBuses"]

_LOG = logging.getLogger(__name__)
_ANSWER_S = 5.0
_BUSY_S = 2.0  # for which a bridge waits for the end of the bridge before it
_PAUSE_S = 0.05
_AGAIN_S = 0.5  # between two looks for a plant that is gone, and the longest wait of each


class PlantBuses:
    """Buses in the process of a plant; each call is one exchange on its socket.

    Without a plant no robot answers: every frame ends with NO_ADDRESS, and a call looks for a plant
    again, twice a second at most. The robots of a plant that began anew have booted, as after a
    power cut.

    Args:
        path: the socket of the plant.
        ids: robot ids, shape (n,).
        addresses: their addresses, n rows.
        timing: clock and times of the buses.
        wait_s: longest wait for the plant to appear [s].
        answer_s: longest wait for one answer [s]; then the plant counts as gone.
        pause: waits for a number of seconds.
        clock: returns the time of the machine [s].

    Raises:
        PlantError: there is no plant, another bridge is connected, or the plant has another plane.
    """

    def __init__(
        self,
        path: Path,
        ids: Ids,
        addresses: Addresses,
        timing: BusTiming,
        wait_s: float = 30.0,
        answer_s: float = _ANSWER_S,
        pause: Callable[[float], None] = time.sleep,
        clock: Callable[[], float] = time.monotonic,
    ):
        self._opening = {
            "ids": ids,
            "bus": addresses.bus,
            "address": addresses.address,
            "ten_bit": addresses.ten_bit,
            "clock_hz": timing.clock_hz,
        }
        self._timing, self._link = timing, PlantLink(path, answer_s)
        self._clock, self._again_s = clock, -np.inf  # not before this time is a plant looked for
        self._link.connect(wait_s, pause=pause)
        for _ in range(int(_BUSY_S / _PAUSE_S)):
            try:
                self._link.ask(Kind.OPEN, **self._opening)
                return
            except PlantError as error:
                if "in use" not in str(error):
                    raise
            pause(_PAUSE_S)
        self._link.ask(Kind.OPEN, **self._opening)

    def close(self) -> None:
        """Leave the plant; its robots stop by their own watchdogs."""
        self._link.close()

    def transfer(self, frames: Frames, read_bytes: ArrayLike, not_before_s: ArrayLike) -> Replies:
        """Carry a batch of messages; see BusBackend.transfer."""
        answer = self._ask(
            Kind.TRANSFER,
            bus=frames.to.bus, address=frames.to.address, ten_bit=frames.to.ten_bit,
            offsets=frames.offsets, data=frames.data,
            read_bytes=read_bytes, not_before_s=not_before_s,
        )  # fmt: skip
        if answer is None:
            return self._unanswered(frames, read_bytes, not_before_s)
        return Replies(
            answer["ack"], answer["start_s"], answer["end_s"], answer["offsets"], answer["data"]
        )

    def recover(self, bus: int, recovery: Recovery, t: float) -> tuple[float, bool]:
        """Try to free the lines of a bus; see BusBackend.recover."""
        answer = self._ask(Kind.RECOVER, bus=bus, recovery=int(recovery), t=t)
        return (t, True) if answer is None else (float(answer["end_s"][0]), bool(answer["free"][0]))

    def alert_lines(self, t: float) -> Ints:
        """Return the buses with a low alert line; see BusBackend.alert_lines."""
        answer = self._ask(Kind.ALERTS, t=t)
        return np.zeros(0, dtype=np.int64) if answer is None else answer["bus"]

    def _ask(self, kind: Kind, **columns: ArrayLike) -> Columns | None:
        """The answer to a request, None without a plant."""
        if not self._link.connected and not self._found_again():
            return None
        try:
            return self._link.ask(kind, **columns)
        except PlantError as error:
            self._link.close()  # what it refuses, it would refuse again
            self._again_s = self._clock()
            _LOG.warning("%s: no robot answers", error)
            return None

    def _found_again(self) -> bool:
        """Look for a plant in place of the one that is gone."""
        if self._clock() < self._again_s:
            return False
        try:
            self._link.connect(0.0)
            self._link.ask(Kind.OPEN, _AGAIN_S, **self._opening)
        except PlantError as error:
            self._link.close()
            self._again_s = self._clock() + _AGAIN_S
            _LOG.debug("%s", error)
            return False
        _LOG.warning("there is a plant again")
        return True

    def _unanswered(
        self, frames: Frames, read_bytes: ArrayLike, not_before_s: ArrayLike
    ) -> Replies:
        f = len(frames)
        read = np.broadcast_to(np.asarray(read_bytes, dtype=np.int64), (f,))
        start_s = np.array(np.broadcast_to(np.asarray(not_before_s, dtype=float), (f,)))
        offsets = Parts.from_counts(read).offsets
        end_s = start_s + self._timing.unanswered_s(frames.to.ten_bit)
        ack = np.full(f, int(Ack.NO_ADDRESS), dtype=np.int64)
        return Replies(ack, start_s, end_s, offsets, np.full(offsets[-1], 0xFF, dtype=np.uint8))
