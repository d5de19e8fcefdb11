# SPDX-License-Identifier: Apache-2.0
"""Runs that repeat what the two papers of Makarem et al. (2014) print, as plain rows.

Each function carries out one of them and returns its figures; bench/paper.py makes the page.
"""

import time
from dataclasses import replace
from typing import Any, TypeAlias

import numpy as np
from bus import carry_out
from discretizers import WAYS, of_chain
from dnf_family import VARIANTS, judged

from fiber_bus_bridge import TOPOLOGIES
from fiber_bus_bridge.simulation import Faults
from fiber_core import kinematics
from fiber_core.array_types import Floats
from fiber_core.metrics import lower_bound_s
from fiber_core.outcomes import Reason
from fiber_core.presets import preset
from fiber_core.problem import Problem
from fiber_planner import PlannedMotion, Planner, make_planner
from fiber_positioners import Reconfiguration, make_orders, random_problem, reconfigure

__all__ = [
    "LAWS", "SIZES", "Row", "arrivals_s", "bus_times", "discretizations", "laws", "swarm",
    "three_robots",
]  # fmt: skip

Row: TypeAlias = dict[str, Any]

SIZES = (7, 37, 169, 547, 1027, 5167)  # whole hexagons, as in the paper
SWARM = ("as printed", "sign corrected", "dnf", "dnf_priority", "direct")
_FIELDS = (1, 4)  # of the largest and of the smallest planes, at least and at most
_ROBOTS_IN_ALL = 2000  # of the fields of one size, about
# tips of three robots in a row at the start, and their targets [mm]
_THREE_STARTS = ((1.2, -2.5), (6.9, -5.6), (11.9, -1.1))
_THREE_TARGETS = ((1.9, -4.8), (2.3, 0.4), (12.8, -2.8))
_ARRIVED_MM = 0.1  # the papers' tolerance

THEOREM = "sign corrected, lambda1 = 0.04 lambda2"  # meets the condition of the theorem

# name -> (planner, parameters): the printed law, and one change at a time; no robot knows more
# than its neighbours' state, so priorities are not rehearsed
LAWS: dict[str, tuple[str, dict[str, Any]]] = {
    **VARIANTS,
    "dnf_priority": VARIANTS["dnf_priority, not rehearsed"],
    "sign corrected, steps of 1 ms": (
        "dnf", {"attraction": "tip", "adaptive": False, "dt_s": 1e-3}
    ),
    "sign corrected, no repulsion": (
        "dnf", {"attraction": "tip", "adaptive": False, "lambda2": 0.0}
    ),
    THEOREM: (
        "dnf", {"attraction": "tip", "adaptive": False, "lambda1": 0.002}
    ),
}  # fmt: skip
_ONE_CHANGE = (
    "as printed", "sign corrected", "sign corrected, steps of 1 ms",
    "sign corrected, no repulsion", THEOREM, "dnf", "dnf_priority",
)  # fmt: skip


def problem_of(robots: int, seed: int) -> Problem:
    """Return a random problem on the plane of the papers."""
    return random_problem(preset("paper", robots), seed)


def arrivals_s(problem: Problem, planned: PlannedMotion) -> Floats:
    """Return when each robot is at its target for good [s], inf if never, shape (n,).

    Args:
        problem: the problem that was planned.
        planned: the plan; its samples are the instants that are looked at.
    """
    motion = planned.motion
    last = np.full(problem.plane.n, -1)
    for k in range(len(motion.time_s)):
        tips = kinematics.forward(problem.plane, motion.angles[:, :, k])[1]
        last[np.linalg.norm(tips - problem.targets, axis=1) > _ARRIVED_MM] = k
    after = np.minimum(last + 1, len(motion.time_s) - 1)
    arrives = planned.reason == Reason.OK
    return np.where(arrives, motion.time_s[after], np.inf)


def _planner(law: str) -> Planner:
    name, parameters = LAWS[law]
    return make_planner(name, **parameters)


def _planned(law: str, problem: Problem) -> tuple[PlannedMotion, float]:
    planner = _planner(law)
    begin = time.process_time()
    planned = planner.plan(problem)
    return planned, time.process_time() - begin


def swarm(sizes: tuple[int, ...], fields: int | None = None) -> list[Row]:
    """Return a row for each law and number of robots: how many arrive, when, at what cost.

    Args:
        sizes: numbers of robots.
        fields: random fields of each size; by default 1 of the largest and 4 of small planes.
    """
    rows = []
    for law in SWARM:
        _planned(law, problem_of(7, 0))  # compile
    for robots in sizes:
        draws = fields or int(np.clip(_ROBOTS_IN_ALL // robots, *_FIELDS))
        problems = [problem_of(robots, seed) for seed in range(draws)]
        bound_s = float(np.median([lower_bound_s(problem) for problem in problems]))
        for law in SWARM:
            plans = [_planned(law, problem) for problem in problems]
            there = [arrivals_s(p, plan) for p, (plan, _) in zip(problems, plans)]
            rows.append(
                {
                    "robots": robots,
                    "law": law,
                    "fields": draws,
                    "reached": int(sum(np.isfinite(t).sum() for t in there)),
                    "asked": robots * draws,
                    "t90_s": _quantile(there, 0.9),
                    "t99_s": _quantile(there, 0.99),
                    "last_s": float(
                        np.median([t.max(initial=-np.inf, where=np.isfinite(t)) for t in there])
                    ),
                    "bound_s": bound_s,
                    "cpu_s": float(np.median([cpu_s for _, cpu_s in plans])),
                    "there_s": np.sort(there[0]),
                }
            )
    return rows


def _quantile(there: list[Floats], part: float) -> float:
    # median over the fields of the time at which a part of the robots has arrived; inf: fewer do
    return float(np.median([np.sort(t)[int(np.ceil(part * len(t))) - 1] for t in there]))


def laws(robots: int) -> list[Row]:
    """Return a row for each change of the printed law: arrivals and least distance of two tips.

    Args:
        robots: number of robots.
    """
    rows, problem = [], problem_of(robots, 0)
    for law in _ONE_CHANGE:
        found = judged(problem, _planned(law, problem)[0])
        rows.append({"law": law, "asked": found["robots"], **found})
    return rows


def three_robots() -> tuple[Reconfiguration, Row]:
    """Return a conflict of three robots in a row, as in Fig. 5 of the second paper.

    The middle one has to pass between its neighbours. Robots are 8 mm apart, theta turns once and
    phi half a turn: with the ranges of the plane of the papers they go around each other.

    Returns:
        The conflict as it is carried out with priorities, and how many arrive with each law.
    """
    few = preset("paper", 3)
    stops = np.deg2rad(np.tile([[-194.0, 194.0], [0.0, 180.0]], (3, 1, 1)))
    centers = np.array([[0.0, 0.0], [8.0, 0.0], [16.0, 0.0]])
    plane = replace(few, centers=centers, limits=stops, speeds=np.full((3, 2), np.pi))
    angles, valid = kinematics.inverse(plane, np.array(_THREE_STARTS))
    start = angles[np.arange(3), valid.argmax(axis=1)]
    problem = Problem(plane, start, np.array(_THREE_TARGETS))
    laws_of_three = ("as printed", "sign corrected", "dnf", "dnf_priority", "direct")
    arrive = {
        law: int((_planned(law, problem)[0].reason == Reason.OK).sum()) for law in laws_of_three
    }
    steps = make_orders(problem, planner=_planner("dnf_priority"), options=WAYS["makarem2014"])
    result = reconfigure(problem, planner=_planner("dnf_priority"))
    return result, {
        "arrive": arrive,
        "seven_steps": int((steps.reason == Reason.OK).sum()),
        "segments": result.motion.counts.tolist(),
        "reached": result.report["reached"],
        "makespan_s": result.report["makespan_s"],
        "bound_s": result.report["lower_bound_s"],
        "least_gap_mm": result.certificate.min_gap_mm,
    }


def discretizations(robots: int, planners: tuple[str, ...]) -> list[Row]:
    """Return a row for each planner and way of discretizing: segments and bits of a profile.

    Args:
        robots: number of robots.
        planners: names of LAWS.
    """
    rows = []
    for planner in planners:
        orders = make_orders(problem_of(robots, 0), planner=_planner(planner))
        bits = orders.units.velocity_bits + orders.units.duration_bits
        for way in ("makarem2014 as printed", "makarem2014", "sequential (default)"):
            row = of_chain(orders, way)
            rows.append({"planner": planner, **row, "bits": bits * row["mean"]})
    return rows


def bus_times(robots: int) -> list[Row]:
    """Return a row for each topology, and for a faster clock: time of load, verify and go.

    Args:
        robots: number of robots.
    """
    rows = []
    for topology, clock in (*((name, "1M") for name in TOPOLOGIES), ("10x500", "3.4M")):
        bus, address = TOPOLOGIES[topology].assign(robots)
        problem = problem_of(robots, 0)
        problem = replace(problem, plane=replace(problem.plane, bus=bus, address=address))
        orders = make_orders(problem)
        figures = carry_out(orders, Faults(), clock, 0)
        rows.append({"topology": topology, "clock": clock, **figures})
    return rows
