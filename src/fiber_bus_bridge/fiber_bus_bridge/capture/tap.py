"""A tap on buses: everything that goes over them is kept, and written to files."""

from pathlib import Path

from fiber_bus_bridge.bus import BusBackend, BusTiming, Exchange
from fiber_bus_bridge.capture.pcap import write_pcap
from fiber_bus_bridge.capture.vcd import write_vcd

__all__ = ["Tap"]


class Tap:
    """Buses that keep what goes over them; otherwise as the buses they stand before.

    Args:
        backend: the buses.
        timing: clock and times, for the waveforms.
        limit: messages kept since the last write; later ones are counted and not kept.
    """

    def __init__(self, backend: BusBackend, timing: BusTiming, limit: int = 20_000):
        self._backend, self._timing, self._limit = backend, timing, limit
        self.exchanges: list[Exchange] = []
        self.kept = self.dropped = 0
        self.recover, self.alert_lines = backend.recover, backend.alert_lines

    def transfer(self, frames, read_bytes, not_before_s):
        """Carry a batch of messages and keep it; see BusBackend.transfer."""
        replies = self._backend.transfer(frames, read_bytes, not_before_s)
        if self.kept + len(frames) <= self._limit:
            self.exchanges.append(Exchange(frames, replies))
            self.kept += len(frames)
        else:
            self.dropped += len(frames)
        return replies

    def write(self, folder: Path) -> None:
        """Write buses.vcd and buses.pcap into a folder, which is made, and begin anew."""
        folder.mkdir(parents=True, exist_ok=True)
        with open(folder / "buses.vcd", "w", encoding="ascii") as file:
            write_vcd(file, self.exchanges, self._timing)
        with open(folder / "buses.pcap", "wb") as file:
            write_pcap(file, self.exchanges)
        self.exchanges, self.kept, self.dropped = [], 0, 0
