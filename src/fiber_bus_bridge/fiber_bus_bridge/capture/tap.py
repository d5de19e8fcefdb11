# SPDX-License-Identifier: Apache-2.0
"""A tap on buses: the traffic is kept and written to files."""

from pathlib import Path

from numpy.typing import ArrayLike

from fiber_bus_bridge.bus import BusBackend, BusTiming, Exchange, Recovery, Replies
from fiber_bus_bridge.capture.pcap import write_pcap
from fiber_bus_bridge.capture.vcd import write_vcd
from fiber_bus_bridge.wire import Frames
from fiber_core.array_types import Ints

__all__ = ["Tap"]


class Tap:
    """A bus backend that keeps the traffic and otherwise behaves as the backend behind it.

    Args:
        backend: the backend that carries the messages.
        timing: clock and times of the buses, for the waveforms.
        limit: largest number of messages kept between two writes; more are counted, not kept.
    """

    def __init__(self, backend: BusBackend, timing: BusTiming, limit: int = 20_000):
        self._backend, self._timing, self._limit = backend, timing, limit
        self.exchanges: list[Exchange] = []
        self.kept = self.dropped = 0

    def transfer(self, frames: Frames, read_bytes: ArrayLike, not_before_s: ArrayLike) -> Replies:
        """Carry a batch of messages and keep it; see BusBackend.transfer."""
        replies = self._backend.transfer(frames, read_bytes, not_before_s)
        if self.kept + len(frames) <= self._limit:
            self.exchanges.append(Exchange(frames, replies))
            self.kept += len(frames)
        else:
            self.dropped += len(frames)
        return replies

    def recover(self, bus: int, recovery: Recovery, t: float) -> tuple[float, bool]:
        """Try to free the lines of a bus; see BusBackend.recover."""
        return self._backend.recover(bus, recovery, t)

    def alert_lines(self, t: float) -> Ints:
        """Return the buses with a low alert line; see BusBackend.alert_lines."""
        return self._backend.alert_lines(t)

    def write(self, folder: Path) -> None:
        """Write buses.vcd and buses.pcap into a folder, created if needed, and drop the traffic."""
        folder.mkdir(parents=True, exist_ok=True)
        with open(folder / "buses.vcd", "w", encoding="ascii") as file:
            write_vcd(file, self.exchanges, self._timing)
        with open(folder / "buses.pcap", "wb") as file:
            write_pcap(file, self.exchanges)
        self.exchanges, self.kept, self.dropped = [], 0, 0
