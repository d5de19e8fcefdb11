# SPDX-License-Identifier: Apache-2.0
"""A plane of sectors in threads of this process, with queues for a network."""

import queue
import threading
import time
from dataclasses import replace

import numpy as np

from fiber_bus_bridge import Session, SessionConfig
from fiber_bus_bridge.bus import addresses_of
from fiber_bus_bridge.simulation import Positioners, SimulatedBuses
from fiber_core.clearance import Safety
from fiber_core.presets import preset
from fiber_core.wire_units import WireMotion, WireUnits
from fiber_sectors import Terms
from fiber_sectors.exchange import Pace
from fiber_sectors.paced import PacedBuses
from fiber_sectors.sector import Sector, certified_elsewhere
from fiber_sectors.sectored_session import SectoredSession
from fiber_sectors.shares import part_of, with_sectors

__all__ = ["PATIENCE_S", "PlaneOfSectors", "turning"]

PATIENCE_S = 3.0


def turning(session, rows=None, ticks=100, velocity=600):
    """Orders that turn theta of some robots, all by default."""
    n = session.plane.n
    chosen = np.zeros(n, dtype=bool)
    chosen[np.arange(n) if rows is None else rows] = True
    segments = np.stack([chosen, np.zeros(n, dtype=bool)], axis=1)
    offsets = np.append(0, np.cumsum(segments))
    m = int(chosen.sum())
    return WireMotion(
        session.units, session.counts, offsets, np.full(m, ticks), np.full(m, velocity)
    )


class PlaneOfSectors:
    """Sectors in threads, and the session of their coordinator.

    Args:
        faults: by sector, the faults of its buses.
        robots, on_bus, shares: the plane.
        slowly: seconds of the clocks in one of this machine; 0 for time that waits for the sectors.
        ahead_s: how far the clock of each sector is ahead.
        late_s: for which each message to a sector is under way, on the clocks.
        lossy: called with the sender (-1 the coordinator) and the bytes; whether they are lost.
    """

    def __init__(
        self, faults=None, robots=42, on_bus=7, shares="3", lossy=lambda *_: False, slowly=0.0,
        ahead_s=(0.0, 0.0, 0.0), late_s=0.0,
    ):  # fmt: skip
        plane = preset("desi", robots)
        rows = np.arange(robots)
        plane = replace(plane, bus=rows // on_bus, address=rows % on_bus + 8)
        plane = with_sectors(plane, shares)
        self.plane, self.units, self._lossy = plane, WireUnits.for_plane(plane), lossy
        # folded: arms are clear of each other at every theta
        self.start = np.stack([np.linspace(-1.0, 1.0, robots), np.full(robots, 3.1)], axis=1)
        self._slowly, self._late_s = slowly, late_s
        self._inbox = queue.SimpleQueue()
        self.dead, self._ended = set(), threading.Event()
        self.buses, self.sectors, self._threads = [], [], []
        self._ahead_s = ahead_s
        for k in range(int(plane.sector.max()) + 1):
            part, start = part_of(plane, k), self.start[plane.sector == k]
            counts = self.units.encoder_counts(part, start)
            robots_of = Positioners(addresses_of(part), part.ids, self.units.quantum_prad, counts)
            buses = SimulatedBuses(robots_of, faults=(faults or {}).get(k))
            self.buses.append(buses)
            self.sectors.append(self._new_sector(k, k + 1))
            sector = self.sectors[k]
            thread = threading.Thread(target=sector.serve, args=(self._gone(k),), daemon=True)
            self._threads.append(thread)
            thread.start()
        self.session = self.new_session()

    def _new_sector(self, k, boot):
        part, slowly = part_of(self.plane, k), self._slowly
        clock = self._clock(self._ahead_s[k]) if slowly else None
        backend = PacedBuses(self.buses[k], clock, self._wait) if clock else self.buses[k]
        start, config = self.start[self.plane.sector == k], SessionConfig(resumes=0)
        session = Session(part, self.units, Safety(), backend, start, config, certified_elsewhere)
        return Sector(
            k, session, Terms(), boot, self._sender(k), clock, PATIENCE_S, slowly or 1.0
        )  # fmt: skip

    def new_session(self, call_s=120.0):
        """The session of a coordinator that begins anew."""
        slowly, own = self._slowly, SessionConfig(tolerance_mm=1e-3)  # folded tips move little
        clock = self._clock(0.0) if slowly else None
        pace = Pace(clock, PATIENCE_S, call_s, scale=slowly or 1.0)
        return SectoredSession(
            self.plane, self.units, Safety(), self.start, own, Terms(), self, pace
        )

    def _clock(self, ahead_s):
        return lambda: ahead_s + self._slowly * time.monotonic()

    def _wait(self, clock_s):
        time.sleep(clock_s / self._slowly)

    def _gone(self, k):
        return lambda: self._ended.is_set() or k in self.dead

    def _sender(self, k):
        def send(data):
            if k not in self.dead and not self._lossy(k, data):
                self._inbox.put(data)

        return send

    # --- links ---------------------------------------------------------------

    def send(self, sector, data):
        if sector not in self.dead and not self._lossy(-1, data):
            put = self.sectors[sector].inbox.put
            if self._late_s:
                threading.Timer(self._late_s / self._slowly, put, [data]).start()
            else:
                put(data)

    def receive(self, wait_s):
        try:
            return [self._inbox.get(timeout=wait_s)]
        except queue.Empty:
            return []

    def left(self, sector):
        return sector in self.dead

    def kill(self, sector):
        """Cut a sector off for good: its messages and those to it are lost."""
        self.dead.add(sector)

    def revive(self, sector):
        """Connect a sector again that was cut off and has ended."""
        self.join(sector)
        self.dead.discard(sector)
        thread = threading.Thread(
            target=self.sectors[sector].serve, args=(self._gone(sector),), daemon=True
        )
        self._threads[sector] = thread
        thread.start()

    def begin_anew(self, sector):
        """Let another process take the place of a sector that was cut off and has ended."""
        self.join(sector)
        self.sectors[sector] = self._new_sector(sector, 100 + sector)
        self.revive(sector)

    def join(self, sector):
        """Wait until a sector that was cut off has ended."""
        self._threads[sector].join(60.0)

    def close(self):
        self._ended.set()
        for thread in self._threads:
            thread.join(10.0)

    def until_rest(self):
        """Go on until the plan has ended."""
        session, begin_s = self.session, time.monotonic()
        while session.state.name == "MOVING":
            assert time.monotonic() - begin_s < 120.0
            session.advance(max(session.transactions.now_s, session.sectors.now_s()) + 0.1)
