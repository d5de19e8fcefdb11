# SPDX-License-Identifier: Apache-2.0
"""The true motion of the robots, asked from a plant."""

from pathlib import Path
from types import TracebackType
from typing import NamedTuple

from fiber_bus_bridge.plant.link import PlantLink
from fiber_bus_bridge.plant.messages import Kind, PlantError
from fiber_bus_bridge.simulation import Mechanics, Movements, arms_at, arms_motion
from fiber_core.array_types import Bools, Codes, Counts, Ints
from fiber_core.clearance import Certificate, Safety, certify_arms, neighbour_pairs
from fiber_core.drive.curves import CurveMotion
from fiber_core.focal_plane import FocalPlane
from fiber_core.motion import SegmentMotion

__all__ = ["PlantTruth", "Truth", "touching"]

_ANSWER_S = 10.0
_BEFORE_S = 1e-3  # of the begin of a motion before its first movement
_EXACT = Safety(0.0, 0.0, 0.0, 0.0, 0.0, 0.0)  # outlines as they are, clocks as they ran


class Truth(NamedTuple):
    """The true movements of robots since a number.

    Args:
        now_s: time of the plant [s].
        bridge: number of the bridge that is or was connected, from 1, and 0 before the first.
        first: number of the first movement.
        quantum_rad: size of one encoder count [rad].
        start: encoders before the first movement [quanta], shape (n, 2).
        position: encoders at rest, or where a movement began [quanta], shape (n, 2).
        state: RobotState of each robot, shape (n,).
        moves: the movements, r rows.
        controller: number of the bridge that started each movement, shape (r,).
        verified: whether that bridge had loaded and read back the order, shape (r,).
    """

    now_s: float
    bridge: int
    first: int
    quantum_rad: float
    start: Counts
    position: Counts
    state: Codes
    moves: Movements
    controller: Ints
    verified: Bools

    @property
    def next(self) -> int:
        """Number of the movement that comes after these."""
        return self.first + len(self.moves.row)

    def motion(self, mechanics: Mechanics | None = None) -> SegmentMotion | CurveMotion:
        """Return the true joint angles of all robots over time, until now.

        Args:
            mechanics: the errors of the joints, of arms that stood where their counters read
                before the first movement of all; by default the arms have none.

        Raises:
            PlantError: with errors, the movements must begin with the first of all.
        """
        begin_s = min(self.moves.started_s.min(initial=self.now_s), self.now_s) - _BEFORE_S
        times = self.now_s, begin_s
        if mechanics is None:
            return self.moves.motion(self.start, self.quantum_rad, *times)
        if self.first != 0:
            raise PlantError(f"the arms are unknown before movement {self.first}: ask from 0 on")
        counters = self.moves.counters(self.start, self.quantum_rad, *times)
        state = arms_at(mechanics, self.start * self.quantum_rad)
        return arms_motion(mechanics, state, *counters)[0]


class PlantTruth:
    """Reads the truth from a plant; it changes nothing there. It finds a plant that began anew.

    Args:
        path: the socket of the plant.
        wait_s: longest wait for the plant to appear [s].

    Raises:
        PlantError: there is no plant.
    """

    def __init__(self, path: Path, wait_s: float = 30.0):
        self._link, self._wait_s = PlantLink(path, _ANSWER_S), wait_s
        self._link.connect(wait_s)

    def __enter__(self) -> "PlantTruth":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, _: TracebackType | None
    ) -> None:
        self._link.close()

    def since(self, number: int = 0) -> Truth:
        """Return the movements from a number on; those before it that go on are among them.

        A plant that began anew counts its movements from 0.

        Raises:
            PlantError: the plant is gone, and no other came in time.
        """
        try:
            got = self._link.ask(Kind.TRUTH, since=number)
        except PlantError:
            if self._link.connected:
                raise  # refused
            self._link.connect(self._wait_s)
            got = self._link.ask(Kind.TRUTH, since=number)
        r = len(got["row"])
        moves = Movements(
            got["row"], got["started_s"], got["ended_s"], got["tick_s"],
            got["counts"].reshape(r, 2), got["ticks"].reshape(r, 2, -1 if r else 0),
            got["velocity"].reshape(r, 2, -1 if r else 0),
            got["ramp_us"].reshape(r, 2, -1 if r else 0),
        )  # fmt: skip
        return Truth(
            float(got["now_s"][0]), int(got["bridge"][0]), int(got["first"][0]),
            float(got["quantum_rad"][0]), got["start"].reshape(-1, 2),
            got["position"].reshape(-1, 2), got["state"], moves, got["controller"], got["verified"],
        )  # fmt: skip


def touching(plane: FocalPlane, truth: Truth, mechanics: Mechanics | None = None) -> Certificate:
    """Return the certificate of the true motion: its unsafe pairs are robots that touched.

    Whole outlines are judged in continuous time, where the true arms were.

    Args:
        plane: the focal plane.
        truth: the true movements.
        mechanics: the errors of the joints, as for Truth.motion.
    """
    return certify_arms(plane, truth.motion(mechanics), _EXACT, neighbour_pairs(plane))
