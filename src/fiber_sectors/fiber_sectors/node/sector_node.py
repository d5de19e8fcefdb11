# SPDX-License-Identifier: Apache-2.0
"""A sector as a node: a share of the buses of a plane, on the orders of its coordinator."""

import threading
import time
from dataclasses import replace
from typing import Any

from std_msgs.msg import UInt8MultiArray

from fiber_bus_bridge import SessionConfig
from fiber_bus_bridge.bus import BusBackend
from fiber_bus_bridge.node.hardware import Hardware, declare_hardware, open_hardware
from fiber_bus_bridge.session import Session
from fiber_core.clearance import Safety
from fiber_core.focal_plane import FocalPlane
from fiber_msgs_py import topics
from fiber_node import PlaneNode, run
from fiber_sectors.errors import SectorError
from fiber_sectors.node.links import as_message
from fiber_sectors.node.settings import SectorsConfig
from fiber_sectors.paced import PacedBuses
from fiber_sectors.sector import Sector, certified_elsewhere
from fiber_sectors.shares import part_of, with_sectors
from fiber_sectors.terms import Terms

__all__ = ["SectorNode", "main"]

_ENDS_S = 30.0  # longest wait for the end of a run when the node is destroyed
_CHECK_S = 0.2


def _paced(hardware: Hardware, sectors: SectorsConfig) -> BusBackend:
    """The buses, in the time of this host where the parameters say so.

    Adapters live by it already. Robots of a plant outlive this process: their time is the clock,
    not the time since its begin.
    """
    clock = sectors.clock
    if clock is None or hardware.in_real_time:
        return hardware.buses
    origin_s = None if hardware.plant is None else 0.0
    return PacedBuses(hardware.buses, clock, sectors.wait, origin_s)


class SectorNode(PlaneNode):
    """Drives the buses of one sector, in the namespace of the sector.

    Args:
        options: keyword arguments of rclpy.node.Node.

    Raises:
        FiberError: the parameters describe no hardware, or the plane has no such sector.
    """

    def __init__(self, **options: Any):
        super().__init__("sector", **options)
        declared = declare_hardware(self.parameters)
        config = self.parameters.declare(SessionConfig, "session", read_only=True).value
        safety = self.parameters.declare(Safety, "safety", read_only=True).value
        own = self.parameters.declare(SectorsConfig, "sectors", read_only=True).value
        terms = self.parameters.declare(Terms, "terms", read_only=True).value
        self.parameters.finish()
        if declared.chosen.devices and own.clock_scale != 1.0:
            raise SectorError(
                f"devices {list(declared.chosen.devices)} with sectors.clock_scale "
                f"{own.clock_scale:g}: adapters live in real time, set it to 1 in all sectors and "
                "in their coordinator"
            )

        def part(plane: FocalPlane) -> FocalPlane:
            return part_of(with_sectors(plane, own.shares), own.number)

        self._hardware = open_hardware(declared, self.get_namespace(), self.pause, part)
        hardware, plane = self._hardware, self._hardware.plane
        # the coordinator decides whether the others resume after a stop
        session = Session(
            plane, hardware.units, safety, _paced(hardware, own), hardware.start,
            replace(config, resumes=0), certified_elsewhere,
        )  # fmt: skip
        self._publisher = topics.FROM_SECTOR.publisher(self)
        self.sector = Sector(
            own.number, session, terms, time.time_ns(), self._send,
            own.clock, own.patience_s, own.clock_scale or 1.0,
        )  # fmt: skip
        topics.TO_SECTOR.subscription(self, self._hear)
        self._ended, self._error = threading.Event(), None
        self.create_timer(_CHECK_S, self._check)
        self._thread = threading.Thread(target=self._serve, name="sector", daemon=True)
        self._thread.start()
        for line in hardware.lines:
            self.get_logger().info(line)
        self.get_logger().info(
            f"sector {own.number}: {plane.n} robots on {len(session.buses)} buses"
        )

    def _serve(self) -> None:
        try:
            self.sector.serve(self._ended.is_set)
        except BaseException as error:  # raised by _check, in the thread of the node
            self._error = error

    def _check(self) -> None:
        if self._error is not None:
            raise self._error

    def _send(self, data: bytes) -> None:
        if self.context.ok():
            self._publisher.publish(as_message(data))

    def _hear(self, message: UInt8MultiArray) -> None:
        self.sector.inbox.put(bytes(message.data))

    def destroy_node(self) -> None:
        """End the sector: robots that move are stopped."""
        self._ended.set()
        self.sector.end()
        self._thread.join(_ENDS_S)
        self._hardware.close()
        super().destroy_node()


def main(args: list[str] | None = None) -> int:
    """Run the sector until it is interrupted."""
    return run(SectorNode, args)


if __name__ == "__main__":
    raise SystemExit(main())
