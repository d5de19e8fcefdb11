# SPDX-License-Identifier: Apache-2.0
"""A blind move, an image, a correction, and the image that judges it, with simulated arms."""

import time
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial import cKDTree

from fiber_bus_bridge.simulation import Mechanics, arms_at, arms_motion, true_angles
from fiber_core import bounds, kinematics
from fiber_core.arm_bounds import grown
from fiber_core.array_types import Angles, Floats, Mask, Points
from fiber_core.clearance import Certificate, Safety, certify_arms, neighbour_pairs
from fiber_core.drive.curves import CurveMotion
from fiber_core.errors import LayoutError
from fiber_core.motion import SegmentMotion
from fiber_core.problem import Problem
from fiber_metrology import (
    DriveErrors,
    Knowledge,
    MeasureConfig,
    Measurement,
    MetrologyError,
    correction_problem,
    find_spots,
    measure,
)
from fiber_metrology.camera import Exposure, SimulatedCamera
from fiber_planner import StraightPlanner
from fiber_positioners.orders import Orders, make_orders
from fiber_positioners.simulated_run import SimulatedRun, run_on_simulated_buses

__all__ = ["ClosedLoop", "LoopConfig", "Move", "closed_loop"]

_OWN_PX = 3.0  # between a spot and the light that a judge takes it for
_TOUCH = Safety(0.0, 0.0, 0.0, 0.0, 0.0, 0.0)  # outlines as they are, clocks as they ran


@dataclass(frozen=True)
class LoopConfig:
    """How the loop is closed.

    Args:
        exposures: exposures of one image.
        blind_um: error of one coordinate of a fibre after a blind move, 1 sigma [um].
        corrected_um: the same after a correction of a measured robot [um].
        sigmas: errors at which the interval of a blind move ends. At 2 the arms of a pair stay
            apart unless both are off by more, towards each other.
        tolerance_um: a fibre so close to its target is not corrected [um].
        pixels: whether spots are found in the pixels of images; else the camera gives lists.
        measure: errors of camera and air.

    Raises:
        MetrologyError: a value is out of range; names it.
    """

    RANGES: ClassVar = {
        "exposures": bounds.Range(1, 100, whole=True),
        "blind_um": bounds.Range(1e-3, 1e5),
        "corrected_um": bounds.Range(1e-3, 1e5),
        "sigmas": bounds.Range(0.0, 10.0),
        "tolerance_um": bounds.Range(0.0, 1e5),
    }

    exposures: int = 3
    blind_um: float = 40.0
    corrected_um: float = 10.0
    sigmas: float = 2.0
    tolerance_um: float = 0.0
    pixels: bool = False
    measure: MeasureConfig = field(default_factory=MeasureConfig)

    def __post_init__(self) -> None:
        bounds.check_ranges(self, self.RANGES, MetrologyError)


@dataclass(frozen=True, eq=False)
class Move:
    """One move of the loop, carried out, and the image after it.

    Args:
        orders: the orders, certified for outlines that hold the intervals of the arms.
        run: their course on the simulated buses.
        arms: the true motion of the arms.
        angles: joint angles of the true arms after the move [rad], shape (n, 2).
        touches: certificate of the true arms: its unsafe pairs touched.
        exposures: the exposures, with what a judge knows about their spots.
        measurement: what the metrology says about them.
        plan_s, measure_s: wall time of the orders, and from spots to measured angles [s].
        image_s: wall time from the pixels of all exposures to spots [s], nan without pixels.
        plan_cpu_s, measure_cpu_s: processor time of the same [s].
    """

    orders: Orders
    run: SimulatedRun
    arms: SegmentMotion | CurveMotion
    angles: Angles
    touches: Certificate
    exposures: list[Exposure]
    measurement: Measurement
    plan_s: float
    measure_s: float
    plan_cpu_s: float
    measure_cpu_s: float
    image_s: float

    @property
    def simulated_s(self) -> float:
        """Time from the first order on the buses to the end of the motion [s]."""
        costs = self.run.costs
        return costs["bus_time_s"] + costs["countdown_s"] + self.run.motion.makespan_s


@dataclass(frozen=True, eq=False)
class ClosedLoop:
    """The moves of a closed loop.

    Args:
        problem: the problem as it was given.
        moves: the blind move and the corrections, each with its image.
        lit: fibres that give light, shape (n,).
    """

    problem: Problem
    moves: list[Move]
    lit: Mask

    def errors_mm(self, move: int) -> Floats:
        """Return the distance of each true fibre from its target after a move [mm], shape (n,)."""
        tips = kinematics.forward(self.problem.plane, self.moves[move].angles)[1]
        return np.hypot(*(tips - self.problem.targets).T)

    @property
    def not_moved(self) -> Mask:
        """Robots that an image found not to have moved, shape (n,)."""
        return np.any([move.measurement.not_moved for move in self.moves], axis=0)


def closed_loop(
    problem: Problem,
    mechanics: Mechanics,
    camera: SimulatedCamera,
    fiducials: ArrayLike,
    lit: ArrayLike,
    *,
    corrections: int = 1,
    seed: int = 0,
    config: LoopConfig | None = None,
) -> ClosedLoop:
    """Move blind, take an image, correct, and take the image that judges the correction.

    Every move goes the same way: planner, discretizer, certificate, bytes on simulated buses; the
    planner of a correction is `StraightPlanner`. The orders of a correction are relative to the
    measured angles; between two moves the counters are set to them. A robot that does not follow,
    or whose light is not found, stays as an obstacle with its interval.

    Args:
        problem: the plane, the joint angles, at which arms and counters stand, and the targets.
        mechanics: the errors of the arms, which nothing but the camera sees.
        camera: the camera.
        fiducials: places of the fiducials [mm], shape (k, 2).
        lit: whether light comes out of each fibre, shape (n,).
        corrections: number of corrections.
        seed: seed of clocks, air and noise.
        config: how the loop is closed.

    Raises:
        FiberError: the problem cannot be planned, an image cannot be used, or robots have fibres
            beside their tips.
    """
    config = config or LoopConfig()
    plane, n = problem.plane, problem.plane.n
    rng = np.random.default_rng(seed)
    lit = np.asarray(lit, dtype=bool)
    state = arms_at(mechanics, problem.start)
    drive = DriveErrors(config.blind_um, config.corrected_um, config.sigmas)
    knowledge = Knowledge(plane, drive, np.zeros((n, 2)))
    if plane.fibres.shape[1]:
        names = ", ".join(plane.fibre_names)
        raise LayoutError(f"the closed loop sees one fibre at each tip, the plane has {names}")
    moved_plane = grown(plane, np.where(plane.enabled[:, None], drive.interval_rad(plane), 0.0))
    now = Problem(moved_plane, problem.start, problem.targets)
    moves: list[Move] = []
    for number in range(corrections + 1):
        knowledge.begin(now.start, straight=number > 0)
        begin, cpu = time.perf_counter(), time.process_time()
        orders = make_orders(now, planner=StraightPlanner() if number else None)
        plan = time.perf_counter() - begin, time.process_time() - cpu
        run = run_on_simulated_buses(orders, seed=seed + number, observe=True)
        assert run.counters is not None  # it was observed
        arms, state = arms_motion(mechanics, state, *run.counters)
        angles = true_angles(mechanics, state)
        counters = orders.units.to_angles(run.counts)
        tips = kinematics.forward(plane, angles)[1]
        exposures, image_s = _expose(camera, tips, fiducials, lit, rng, config)
        expected = knowledge.expected(counters)
        spots = [exposure.spots for exposure in exposures]
        begin, cpu = time.perf_counter(), time.process_time()
        image = measure(expected, spots, fiducials, camera.calibrated, config.measure)
        took = time.perf_counter() - begin, time.process_time() - cpu
        touches = certify_arms(plane, arms, _TOUCH, neighbour_pairs(plane))
        moves.append(
            Move(
                orders,
                run,
                arms,
                angles,
                touches,
                exposures,
                image,
                plan[0],
                took[0],
                plan[1],
                took[1],
                image_s,
            )
        )
        off_mm = knowledge.outlines_off_mm(image)
        knowledge.learn(image)
        now = correction_problem(image, problem.targets, off_mm, config.tolerance_um)
    return ClosedLoop(problem, moves, lit)


def _expose(
    camera: SimulatedCamera,
    tips: Points,
    fiducials: ArrayLike,
    lit: Mask,
    rng: np.random.Generator,
    config: LoopConfig,
) -> tuple[list[Exposure], float]:
    """The exposures of an image, and the time in which spots were found in their pixels [s]."""
    if not config.pixels:
        made = [camera.expose(tips, fiducials, lit, rng) for _ in range(config.exposures)]
        return made, float("nan")
    exposures, took_s = [], 0.0
    for _ in range(config.exposures):
        shot = camera.photograph(tips, fiducials, lit, rng)
        begin = time.perf_counter()
        spots = find_spots(shot.pixels)
        took_s += time.perf_counter() - begin
        apart, nearest = cKDTree(shot.place_px).query(spots.place_px)
        owner = np.where(apart < _OWN_PX, shot.owner[nearest], SimulatedCamera.STRAY)
        exposures.append(Exposure(spots, owner))
    return exposures, took_s
