# SPDX-License-Identifier: Apache-2.0
"""From a problem to certified orders: the planner and the discretizer, without buses."""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TypeAlias

from fiber_core.array_types import Codes, Counts, Points
from fiber_core.assignment import assign
from fiber_core.clearance import Safety
from fiber_core.focal_plane import FocalPlane
from fiber_core.problem import Problem
from fiber_core.wire_units import WireMotion, WireUnits
from fiber_discretizer import (
    Discretization,
    DiscretizeOptions,
    DiscretizeStageResult,
    discretize_trajectory,
)
from fiber_planner import (
    PlannedMotion,
    Planner,
    PlanStageResult,
    default_planner,
    make_planner,
    plan_assignment,
    spacing_of,
)

__all__ = ["Orders", "ProgressCallback", "make_orders"]

# Called from time to time with the fraction of the work that is done, 0..1, and a short text.
ProgressCallback: TypeAlias = Callable[[float, str], None]


@dataclass(frozen=True, eq=False)
class Orders:
    """A problem with its plan and its orders, and the results of the stages between.

    Args:
        problem: the problem as it was given.
        units: tick, quantum and field widths of the wire format.
        counts: encoder readings before the plan [quanta], shape (n, 2).
        safety: the margin and the timing errors that the orders were certified for.
        planner: name of the planner.
        plan_stage: the accepted targets, the motion of the planner, and reasons.
        discretize_stage: the orders in whole wire units, with their certificate, and reasons.
        seconds: wall time of the stages [s], by "plan_s" and "discretize_s".
        cpu_seconds: processor time of the stages [s], by the same names.
    """

    problem: Problem
    units: WireUnits
    counts: Counts
    safety: Safety
    planner: str
    plan_stage: PlanStageResult
    discretize_stage: DiscretizeStageResult
    seconds: dict[str, float]
    cpu_seconds: dict[str, float]

    @property
    def plane(self) -> FocalPlane:
        """The focal plane."""
        return self.problem.plane

    @property
    def targets(self) -> Points:
        """The targets as they were asked for [mm], shape (n, 2), nan without a target."""
        return self.problem.targets

    @property
    def start_problem(self) -> Problem:
        """The problem that the planner solved: starts on whole quanta, accepted targets only."""
        return self.plan_stage.problem

    @property
    def planned(self) -> PlannedMotion:
        """The motion of the planner."""
        return self.plan_stage.planned

    @property
    def discretization(self) -> Discretization:
        """The result of the discretizer: orders in whole wire units, with their certificate."""
        return self.discretize_stage.discretization

    @property
    def wire(self) -> WireMotion:
        """The orders of all robots, in whole ticks and quanta."""
        return self.discretization.wire

    @property
    def reason(self) -> Codes:
        """Reason of the first stage that held each robot, else OK or NO_TARGET, shape (n,)."""
        return self.discretize_stage.reason


def make_orders(
    problem: Problem,
    *,
    planner: str | Planner | None = None,
    safety: Safety | None = None,
    options: DiscretizeOptions | None = None,
    progress: ProgressCallback | None = None,
) -> Orders:
    """Assign targets, plan, and discretize the plan into certified orders.

    The robots start where their encoders read: the start angles of the problem are rounded
    to whole quanta first.

    Args:
        problem: the plane, the present joint angles and the targets.
        planner: name of a planner, or an object with the method `plan` of the planner
            interface; by default "direct", or "scheduled" for motors with listed speeds.
        safety: margin and timing errors; by default as `Safety` says.
        options: options of the discretizer; by default as `DiscretizeOptions` says.
        progress: called with the fraction of the work that is done, 0..1, and a short text.

    Raises:
        FiberError: the planner is unknown, or the problem does not suit it.
    """
    plane, safety = problem.plane, safety or Safety()
    chosen = default_planner(plane) if planner is None else make_planner(planner)
    units = WireUnits.for_plane(plane)
    counts = units.encoder_counts(plane, problem.start)
    start, asked = units.to_angles(counts), problem.asked
    spacing_mm = spacing_of(chosen, plane)
    assignment = assign(
        plane, start, plane.ids[asked], problem.targets[asked], spacing_mm=spacing_mm
    )
    times = _StageTimes()
    with times.of("plan_s"):
        progress_of_plan = part_of(progress, 0.0, 0.7, "plan")
        planned = plan_assignment(start, assignment, chosen, progress_of_plan)
    with times.of("discretize_s"):
        discretized = discretize_trajectory(
            plane,
            start,
            plane.ids,
            planned.planned.motion,
            units,
            safety,
            options=options,
            progress=part_of(progress, 0.7, 1.0, "discretize"),
            earlier=planned.reason,
        )
    return Orders(
        problem, units, counts, safety, chosen.name, planned, discretized, times.wall, times.cpu
    )


class _StageTimes:
    """Wall time and processor time of stages [s], by their names."""

    def __init__(self) -> None:
        self.wall: dict[str, float] = {}
        self.cpu: dict[str, float] = {}

    @contextmanager
    def of(self, stage: str) -> Iterator[None]:
        wall, cpu = time.perf_counter(), time.process_time()
        yield
        self.wall[stage] = round(time.perf_counter() - wall, 4)
        self.cpu[stage] = round(time.process_time() - cpu, 4)


def part_of(
    progress: ProgressCallback | None, begin: float, end: float, stage: str
) -> ProgressCallback | None:
    """Return a callback that reports one stage as the part begin..end of the whole work."""
    if progress is None:
        return None

    def report(fraction: float, text: str) -> None:
        progress(begin + (end - begin) * fraction, f"{stage}: {text}")

    return report
