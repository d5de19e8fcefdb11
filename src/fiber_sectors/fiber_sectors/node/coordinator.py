# SPDX-License-Identifier: Apache-2.0
"""The coordinator of sectors as a node: the bridge of the plane, for all other nodes."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from fiber_bus_bridge import Session, SessionConfig
from fiber_bus_bridge.bus import BusBackend
from fiber_bus_bridge.errors import BridgeError
from fiber_bus_bridge.node import BridgeNode
from fiber_bus_bridge.node.hardware import DeclaredHardware, Hardware, simulated_hardware
from fiber_core.clearance import Safety
from fiber_msgs_py import Level, Status
from fiber_node import run
from fiber_sectors.exchange import Pace
from fiber_sectors.node.links import TopicLinks
from fiber_sectors.node.settings import SectorsConfig
from fiber_sectors.sectored_session import SectoredSession
from fiber_sectors.shares import with_sectors
from fiber_sectors.terms import Terms

__all__ = ["CoordinatorNode", "main"]

_SLICE_S = 0.01  # time of the buses after which a waiting stop is served
_POLLS = 1200  # a minute, for sectors that compile their loops


@dataclass(frozen=True, eq=False)
class _SectoredHardware(Hardware):
    links: TopicLinks | None = None
    terms: Terms = Terms()
    sectors: SectorsConfig = SectorsConfig()

    @property
    def robots_outlive(self) -> bool:
        """No: sectors have simulated robots, also on the clocks of their hosts."""
        return False

    def session(self, safety: Safety, config: SessionConfig, tap: BusBackend | None) -> Session:
        if tap is not None:
            raise BridgeError("a coordinator has no buses to capture: give capture to the sectors")
        assert self.links is not None  # made with the hardware
        return SectoredSession(
            self.plane, self.units, safety, self.start, config, self.terms, self.links,
            Pace(self.sectors.clock, self.sectors.patience_s, self.sectors.call_s,
                 self.sectors.clock_scale or 1.0),
        )  # fmt: skip

    def close(self) -> None:
        if self.links is not None:
            self.links.close()


class CoordinatorNode(BridgeNode):
    """The bridge of a plane whose buses are driven by sectors.

    Its topics, services and parameters are those of the bridge.

    Args:
        options: keyword arguments of rclpy.node.Node.
    """

    own_parameters: ClassVar[dict[str, type]] = {"sectors": SectorsConfig, "terms": Terms}

    def open_hardware(
        self, declared: DeclaredHardware, namespace: str, pause: Callable[[float], None]
    ) -> Hardware:
        """Return the plane with its sectors, and connections with these.

        Raises:
            FiberError: the plane does not exist, or cannot be shared out like that.
            BridgeError: buses of the coordinator's own are given.
        """
        if declared.chosen.devices or declared.chosen.plant != "none":
            raise BridgeError("a coordinator has no buses: give the plant to the sectors")
        own = self._parameters_given.own
        found = simulated_hardware(declared.plane)
        plane = with_sectors(found.plane, own["sectors"].shares)
        links = TopicLinks(self, int(plane.sector.max(initial=0)) + 1)
        try:
            missing = links.wait(pause, _POLLS)
            if missing:
                raise BridgeError(f"sectors {missing} are not in the graph")
        except BaseException:  # also an interrupt
            links.close()
            raise
        clock = own["sectors"].clock
        follows = {} if clock is None else {"clock": clock, "slice_s": _SLICE_S}
        return _SectoredHardware(
            plane, found.units, found.start, found.buses, found.timing, lines=found.lines,
            links=links, terms=own["terms"], sectors=own["sectors"], **follows,
        )  # fmt: skip

    def statuses(self) -> Iterable[Status]:
        """Return the diagnostics of the bridge, and of every sector."""
        yield from super().statuses()
        if self._calls.open and isinstance(self._session, SectoredSession):
            yield from _of_sectors(self._session)


def _of_sectors(session: SectoredSession) -> Iterable[Status]:
    sectors = session.sectors
    for k, rows in enumerate(sectors.rows):
        gone, clock = k in sectors.gone, sectors.conductor.clocks[k]
        figures = {
            "robots": len(rows),
            "found": int(session.known[rows].sum()),
            "buses": len(np.unique(session.plane.bus[rows])),
            "stage": sectors.conductor.stage(k).name.lower(),
            "clock_ahead_s": round(clock.newest.middle_s, 6),
            "clock_bound_ms": round(1e3 * clock.newest.bound_s, 4),
            "clock_jumps": clock.jumps,
        }
        level, text = (Level.ERROR, "does not answer") if gone else (Level.OK, "good")
        yield Status(f"bridge: sector {k}", level, text, figures, f"sector_{k}")


def main(args: list[str] | None = None) -> int:
    """Run the coordinator until it is interrupted."""
    return run(CoordinatorNode, args)


if __name__ == "__main__":
    raise SystemExit(main())
