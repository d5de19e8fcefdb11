# SPDX-License-Identifier: Apache-2.0
"""The processes of a plane of sectors that meets faults: plants, sectors, and their coordinator."""

import multiprocessing
import os
import time
import traceback
from collections.abc import Callable
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from sector_hosts import Faults, HostClock, Namespaces, Socket, Trouble, TrueBuses, enter
from sector_judge import Start

from fiber_bus_bridge import Session, SessionConfig, SessionState, addresses_of
from fiber_bus_bridge.plant import PlantBuses
from fiber_bus_bridge.plant.plant import Plant
from fiber_bus_bridge.plant.server import PlantServer, listen
from fiber_bus_bridge.simulation import EVENT, Event, SimulationConfig, simulated_buses
from fiber_bus_bridge.simulation import Faults as RobotFaults
from fiber_core.array_types import Angles
from fiber_core.clearance import Safety, gaps, neighbour_pairs
from fiber_core.focal_plane import FocalPlane
from fiber_core.kinematics import forward
from fiber_core.problem import Problem
from fiber_core.wire_units import WireUnits
from fiber_positioners import Orders, make_orders
from fiber_sectors import Stage, Terms
from fiber_sectors.exchange import Pace
from fiber_sectors.inbox import Inbox
from fiber_sectors.sector import Sector, certified_elsewhere
from fiber_sectors.sectored_session import SectoredSession
from fiber_sectors.shares import part_of

__all__ = [
    "CONTEXT", "COORDINATOR", "Setting", "coordinate", "near_problem", "run_plant", "run_sector",
    "logged", "start_of",
]  # fmt: skip

CONTEXT, COORDINATOR = multiprocessing.get_context("fork"), -1
_TURN_RAD, _APART_MM = 0.4, 0.5
_CALL_S, _END_S = 1.5, 60.0  # of the clocks, of this machine
_REST_S = 0.05  # in which robots without a host come to rest
_NEVER_S = 1e12
_Line: TypeAlias = dict[str, Any]


class Setting(NamedTuple):
    """What all processes of a run share.

    Args:
        problem: the first problem.
        spaces: the network namespaces of the sectors.
        line: what is drawn for the run.
        scale: seconds of the clocks in one of this machine.
        trouble: what happens to the victim.
    """

    problem: Problem
    spaces: Namespaces
    line: _Line
    scale: float
    trouble: Trouble

    def clock(self, host: int) -> HostClock:
        """Return the clock of a sector, or of the coordinator."""
        ahead_s, rate_ppm = (self.line[name][host] for name in ("ahead_s", "rate_ppm"))
        mine = self.trouble if self.line["victim"] == host else Trouble()
        return HostClock(self.scale, ahead_s, rate_ppm, mine)

    def socket(self, own: str, other: str, host: int) -> Socket:
        """Return the end of a connection, of a sector or of the coordinator."""
        rng = np.random.default_rng([self.line["number"], host + 1, os.getpid()])
        faults = Faults(*self.line["faults"])
        return Socket(own, other, faults, rng, self.scale, self.trouble)


def near_problem(plane: FocalPlane, start: Angles, rng: np.random.Generator) -> Problem:
    """Draw targets that are soon reached, for all robots that can end a little away.

    Args:
        plane: the focal plane; robots that are not enabled get no targets.
        start: joint angles, clear of each other [rad], shape (n, 2).
        rng: source of randomness.
    """
    turn = rng.uniform(-_TURN_RAD, _TURN_RAD, start.shape) * plane.enabled[:, None]
    low, high = np.moveaxis(plane.limits, -1, 0)
    ends = np.clip(start + turn, low, high)
    pairs = neighbour_pairs(plane, _APART_MM).astype(np.int64)
    pairs = pairs[(pairs < plane.n).all(axis=1)]
    stays = ~plane.enabled
    while True:
        close = (gaps(plane, pairs, ends) < _APART_MM) & ~stays[pairs].all(axis=1)
        if not close.any():
            break
        stays[pairs[close]] = True
        ends[stays] = start[stays]
    targets = np.where(stays[:, None], np.nan, forward(plane, ends)[1])
    return Problem(plane, start, targets)


def start_of(session: SectoredSession, at_s: float) -> Start:
    """Return the start that a coordinator is about to tell.

    Args:
        session: of the coordinator.
        at_s: its instant, in the time of the robots [s].
    """
    conductor = session.sectors.conductor
    sectors = tuple(k for k in conductor.part if conductor.stage(k) is Stage.READY)
    starts = session.robots["verified"] & np.isin(session.plane.sector, sectors)
    return Start(at_s, sectors, tuple(np.flatnonzero(starts).tolist()))


def logged(target: Callable[..., None], log: Path, *given: Any) -> None:
    """Be a process of a run: what it says about errors goes to a file."""
    with log.open("a", encoding="utf-8") as file:
        os.dup2(file.fileno(), 2)
        try:
            target(*given)
        except BaseException:
            file.write(f"{target.__name__}: {traceback.format_exc()}")
            raise SystemExit(1) from None


def run_plant(path: Path, k: int, setting: Setting) -> None:
    """Serve the buses and robots of a sector; one of the victim's robots jams when it is told."""
    plane, problem = setting.problem.plane, setting.problem
    part, units = part_of(plane, k), WireUnits.for_plane(plane)
    robots = simulated_buses(
        part, units, problem.start[plane.sector == k], SimulationConfig(seed=k)
    )
    later = np.array([(0, _NEVER_S, int(Event.JAM_THETA), 0)], dtype=EVENT)
    buses = type(robots)(robots.positioners, robots.timing, RobotFaults(events=later))
    plant, jams = Plant(buses, units.quantum_rad, setting.scale), setting.line["victim"] == k

    def jam() -> bool:
        nonlocal jams
        if jams and setting.trouble.jams:
            jams = False
            buses.positioners.schedule([(0, plant.now_s, int(Event.JAM_THETA), 0)])
        return False

    listener, _ = listen(path)
    PlantServer(plant, part.ids, listener, time.monotonic).serve(jam)


def run_sector(path: Path, k: int, setting: Setting) -> None:
    """Be the host of a sector until this process is killed."""
    spaces, plane = setting.spaces, setting.problem.plane
    enter(spaces.name(k))
    part, units = part_of(plane, k), WireUnits.for_plane(plane)
    begin = setting.problem.start[plane.sector == k]
    timing = simulated_buses(part, units, begin, SimulationConfig()).timing
    buses, clock = PlantBuses(path, part.ids, addresses_of(part), timing), setting.clock(k)
    session = Session(
        part, units, Safety(), TrueBuses(buses, clock, setting.scale), begin,
        SessionConfig(resumes=0), certified_elsewhere,
    )  # fmt: skip
    link = setting.socket(spaces.address(k), spaces.address(k, ours=True), k)
    sector = Sector(k, session, Terms(), time.time_ns(), link.send, clock, scale=setting.scale)
    link.listen(sector.inbox.put)
    sector.serve(lambda: False)


class _Links:
    """The connections of the coordinator with its sectors, by datagrams."""

    def __init__(self, setting: Setting):
        spaces, self._came = setting.spaces, Inbox()
        self._links = [
            setting.socket(spaces.address(k, ours=True), spaces.address(k), COORDINATOR)
            for k in range(spaces.number)
        ]
        for link in self._links:
            link.listen(self._came.put)

    def send(self, sector: int, data: bytes) -> None:
        self._links[sector].send(data)

    def receive(self, wait_s: float) -> list[bytes]:
        return self._came.take(wait_s)

    def left(self, sector: int) -> bool:
        return False


def coordinate(pipe: Connection, orders: Orders | None, setting: Setting) -> None:
    """Be the host of the coordinator, which tells each stage; without orders, of a later one."""
    problem, clock = setting.problem, setting.clock(COORDINATOR)
    session = SectoredSession(
        problem.plane, WireUnits.for_plane(problem.plane), Safety(), problem.start,
        SessionConfig(), Terms(), _Links(setting),
        Pace(clock, 5.0, _CALL_S / setting.scale, setting.scale),
    )  # fmt: skip
    conductor, go = session.sectors.conductor, session.sectors.conductor.go

    def counting(start_s: float, *more: float) -> None:
        go(start_s, *more)
        pipe.send(("counting", start_of(session, clock.true_s() + start_s - clock())))

    conductor.go = counting  # type: ignore[method-assign]
    if orders is not None:
        pipe.send(("configuring", None))
        session.configure(clock())
        pipe.send(("loading", None))
        pipe.send(("ended", _carry_out(session, orders, clock, pipe)))
    pipe.recv()  # all hosts are back
    time.sleep(_REST_S / setting.scale)
    for _ in range(3):
        if session.state is not SessionState.UNCONFIGURED:
            session.clear(clock())
        session.configure(clock())
        if session.known.all():
            break
    if session.state is SessionState.STOPPED:
        session.clear(clock())
    session.enable(session.known & ~session.robots["lost"])
    rng = np.random.default_rng([setting.line["number"], 7])
    orders = make_orders(near_problem(session.plane, session.angles, rng))
    outcome = _carry_out(session, orders, clock, pipe)
    pipe.send(("next", (_going(orders), outcome, session.sectors.why)))


def _going(orders: Orders) -> list[bool]:
    # robots that the orders bring to a target
    return (orders.problem.asked & (orders.reason == 0)).tolist()


def _carry_out(
    session: SectoredSession, orders: Orders, clock: HostClock, pipe: Connection
) -> list[int] | str:
    """Submit orders and carry them out; return the outcomes, or why they were refused."""
    try:
        session.submit(orders.wire, orders.targets)
    except Exception as error:  # robots of a lost sector, a stop: the next one begins anew
        return str(error)[:80]
    session.start(clock())
    if session.state is SessionState.MOVING:
        pipe.send(("moving", None))
    until_s = time.monotonic() + _END_S
    while session.state is SessionState.MOVING and time.monotonic() < until_s:
        session.advance(clock() + 0.1)
    return [] if session.result is None else session.result.outcome.tolist()
