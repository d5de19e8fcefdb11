# SPDX-License-Identifier: Apache-2.0
"""Settings of a simulated focal plane: robots, clocks, buses and faults."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike

from fiber_bus_bridge.bus import addresses_of, bus_timing
from fiber_bus_bridge.errors import BridgeError
from fiber_bus_bridge.simulation.buses import SimulatedBuses
from fiber_bus_bridge.simulation.faults import FaultKind, Faults, draw_faults
from fiber_bus_bridge.simulation.positioners import Positioners
from fiber_bus_bridge.wire import gear_counts
from fiber_core import bounds
from fiber_core.array_types import Angles
from fiber_core.focal_plane import FocalPlane
from fiber_core.wire_units import WireUnits
from fiber_formats import FoundProblem, problem_from

__all__ = ["SimulationConfig", "simulated_buses", "simulated_plane", "simulated_problem"]


_LATEST_FAULT_S = 1e6  # twelve days of simulated time
_MOST_FAULTS = 10_000  # of one kind


@dataclass(frozen=True)
class SimulationConfig:
    """The simulated plane, the errors of its clocks, and its faults.

    Args:
        problem: file problem.npz with plane and starts; takes precedence over layout,
            preset and robots.
        layout: files of robots, of any format of fiber_formats, joined by commas; the preset
            supplies what they lack.
        preset: name of an instrument; empty to derive it from the arms of the layout, else desi.
        robots: number of robots of the preset, 0 for all of them.
        starts: files with the present angles of all robots; random without one.
        spacing_mm: least distance between two targets [mm]; below 0 for that of the plane.
        drive: name of the drive, one of `fiber_core.DRIVES`; empty for that of the plane.
        motors_on: largest share of the motors of a supply that may turn at once; 0 for that of the
            plane.
        seed: seed of random starts and of the clock errors.
        clock: bus clock, as 100k, 400k, 1M, 1.7M or 3.4M.
        clock_ppm: largest error of a robot's clock, in both directions [1e-6].
        start_skew_s: largest delay of a robot's start after a GO [s].
        volatile: whether a loss of power sets the encoders of a robot to 0.
        faults: faults that the simulation has, with their numbers, as "stall:2,scl_stuck"; an
            unknown name is refused with those that exist.
        faults_from_s: earliest begin of a fault, simulated time [s].
        faults_until_s: latest begin of a fault [s]. The first plan of 5000 robots moves from
            0.6 s on.
    """

    RANGES: ClassVar = {
        "robots": bounds.Range(0, bounds.MAX_ROBOTS, whole=True),
        "spacing_mm": bounds.Range(-1.0, bounds.MAX_LENGTH_MM),
        "motors_on": bounds.Range(0.0, 1.0),
        "seed": bounds.Range(0, 2**64, whole=True),
        "clock_ppm": bounds.Range(0.0, bounds.MAX_CLOCK_PPM),
        "start_skew_s": bounds.Range(0.0, bounds.MAX_SKEW_S),
        "faults_from_s": bounds.Range(0.0, _LATEST_FAULT_S),
        "faults_until_s": bounds.Range(0.0, _LATEST_FAULT_S),
    }

    problem: str = ""
    layout: str = ""
    preset: str = ""
    robots: int = 0
    starts: str = ""
    spacing_mm: float = -1.0
    drive: str = ""
    motors_on: float = 0.0
    seed: int = 0
    clock: str = "1M"
    clock_ppm: float = 20.0
    start_skew_s: float = 20e-6
    volatile: bool = False
    faults: str = ""
    faults_from_s: float = 0.8
    faults_until_s: float = 2.0

    def __post_init__(self) -> None:
        if not isinstance(self.volatile, bool):
            raise BridgeError(f"volatile must be true or false, got {self.volatile!r}")
        self.fault_kinds()
        bus_timing(self.clock)
        bounds.check_ranges(self, self.RANGES, BridgeError)

    def fault_kinds(self) -> list[FaultKind]:
        """Return the requested kinds of faults, each as often as requested.

        Raises:
            BridgeError: a kind does not exist; names the kinds that exist.
        """
        kinds = []
        for part in filter(None, self.faults.split(",")):
            name, _, count = part.strip().partition(":")
            if name.upper() not in FaultKind.__members__ or not (count or "1").isdigit():
                names = ", ".join(kind.name.lower() for kind in FaultKind)
                raise BridgeError(
                    f"fault {part.strip()!r}: expected one of {names}, with :2 for two of them"
                )
            bounds.check_number(
                int(count or 1), f"number of faults {name!r}", 0, _MOST_FAULTS, BridgeError
            )
            kinds += [FaultKind[name.upper()]] * int(count or 1)
        return kinds


def simulated_problem(config: SimulationConfig) -> FoundProblem:
    """Return the plane that is asked for, where its robots stand, and what to tell about files.

    Raises:
        FiberError: no such preset, or a file is refused.
        OSError: problem.npz cannot be read.
    """
    return problem_from(
        config.problem,
        config.layout,
        config.preset,
        config.robots,
        config.seed,
        starts=config.starts,
        random_targets=False,
        spacing_mm=None if config.spacing_mm < 0.0 else config.spacing_mm,
        drive=config.drive or None,
        motors_on=config.motors_on or None,
    )


def simulated_plane(config: SimulationConfig) -> tuple[FocalPlane, Angles]:
    """Return the simulated plane and the starts of its robots [rad], shape (n, 2).

    Raises:
        FiberError: the preset does not exist, or a file is malformed.
    """
    problem = simulated_problem(config).problem
    return problem.plane, problem.start


def simulated_buses(
    plane: FocalPlane, units: WireUnits, start: ArrayLike, config: SimulationConfig
) -> SimulatedBuses:
    """Return simulated buses with a simulated positioner for each robot of a plane.

    Args:
        plane: the focal plane.
        units: units of the encoders.
        start: joint angles of the robots [rad], shape (n, 2).
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
        coupling=gear_counts(plane),
        volatile=config.volatile,
    )
    faults = Faults()
    if kinds := config.fault_kinds():
        faults = draw_faults(
            kinds, to.bus, to.address, config.faults_until_s, rng, config.faults_from_s
        )
    return SimulatedBuses(positioners, bus_timing(config.clock), faults, rng)
