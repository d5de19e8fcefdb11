"""A simulated focal plane to put a session on: robots, their clocks, their buses, their faults."""

from dataclasses import dataclass

import numpy as np

from fiber_bus_bridge.bus import addresses_of, bus_timing
from fiber_bus_bridge.errors import BridgeError
from fiber_bus_bridge.simulation.buses import SimulatedBuses
from fiber_bus_bridge.simulation.faults import FaultKind, Faults, draw_faults
from fiber_bus_bridge.simulation.positioners import Positioners
from fiber_core.focal_plane import FocalPlane
from fiber_core.problem_sources import problem_from
from fiber_core.wire_units import WireUnits

__all__ = ["SimulationConfig", "simulated_buses", "simulated_plane"]


@dataclass(frozen=True)
class SimulationConfig:
    """Which plane is simulated, and how well its hardware keeps time.

    Args:
        problem: problem.npz to take plane and starts from; stands before the others.
        layout: table of robots (CSV, ECSV, FITS); the preset fills what it lacks.
        preset: name of an instrument; empty for what the layout's arms tell, else desi.
        robots: how many robots of the preset, 0 for its own number.
        seed: of random starts and of the clocks' errors.
        clock: bus clock, as 100k, 400k, 1M, 1.7M or 3.4M.
        clock_ppm: robots' clocks are off by up to this much, either way [1e-6].
        start_skew_s: robots start up to this late after a GO [s].
        faults: what shall go wrong, as "stall:2,scl_stuck": names of FaultKind, how many of each.
        faults_from_s: they begin at random times from here on, simulated time [s],
        faults_until_s: until here [s]. The first plan of 5000 robots moves from 0.6 s on.
    """

    problem: str = ""
    layout: str = ""
    preset: str = ""
    robots: int = 0
    seed: int = 0
    clock: str = "1M"
    clock_ppm: float = 20.0
    start_skew_s: float = 20e-6
    faults: str = ""
    faults_from_s: float = 0.8
    faults_until_s: float = 2.0

    def __post_init__(self):
        self.fault_kinds()
        for name in ("robots", "seed", "clock_ppm", "start_skew_s"):
            if getattr(self, name) < 0:
                raise BridgeError(f"{name} is {getattr(self, name)}, expected zero or more")

    def fault_kinds(self) -> list[FaultKind]:
        """Return the faults asked for, repeated for more of one.

        Raises:
            BridgeError: one of them does not exist; names those that do.
        """
        kinds = []
        for part in filter(None, self.faults.split(",")):
            name, _, count = part.strip().partition(":")
            if name.upper() not in FaultKind.__members__ or not (count or "1").isdigit():
                names = ", ".join(kind.name.lower() for kind in FaultKind)
                raise BridgeError(
                    f"fault {part.strip()!r}: expected {names}, with :2 for two of it"
                )
            kinds += [FaultKind[name.upper()]] * int(count or 1)
        return kinds


def simulated_plane(config: SimulationConfig) -> tuple[FocalPlane, np.ndarray]:
    """Return the plane asked for and where its robots stand [rad], shape (n, 2).

    Raises:
        FiberError: no such preset, or a file is not what it should be.
    """
    problem = problem_from(config.problem, config.layout, config.preset, config.robots, config.seed)
    return problem.plane, problem.start


def simulated_buses(
    plane: FocalPlane, units: WireUnits, start, config: SimulationConfig
) -> SimulatedBuses:
    """Return buses with a simulated positioner for every robot of a plane.

    Args:
        plane: the focal plane.
        units: what one count of their encoders is.
        start: where they stand [rad], shape (n, 2).
        config: bus clock, errors of the robots' clocks, faults.
    """
    rng = np.random.default_rng(config.seed)
    to = addresses_of(plane)
    positioners = Positioners(
        to,
        plane.ids,
        units.quantum_prad,
        units.encoder_counts(plane, start),
        clock_ppm=rng.uniform(-config.clock_ppm, config.clock_ppm, plane.n),
        start_skew_s=rng.uniform(0.0, config.start_skew_s, plane.n),
    )
    faults = Faults()
    if kinds := config.fault_kinds():
        faults = draw_faults(
            kinds, to.bus, to.address, config.faults_until_s, rng, config.faults_from_s
        )
    return SimulatedBuses(positioners, bus_timing(config.clock), faults, rng)
