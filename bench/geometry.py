#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Plans on planes with walls, fibres and gears, checked apart from the certificate.

Each field is planned and discretized as it would be sent, then judged twice: by the certificate,
and by samples of the decoded motion, in which outlines are polygons and every edge is measured
against every other. Pairs that start too close and rest are counted apart: no order can part
bodies that may not be moved. A field is planned again without walls, for the cost. One JSON line
for each field is appended to the results, and a table in markdown is made of all lines there.
"""

import argparse
import json
import os
import sys
from collections.abc import Callable
from dataclasses import replace
from itertools import groupby
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np

from fiber_core import kinematics
from fiber_core.array_types import Angles, Floats, Mask
from fiber_core.clearance import neighbour_pairs
from fiber_core.focal_plane import FocalPlane
from fiber_core.metrics import lower_bound_s
from fiber_core.motion import SegmentMotion
from fiber_core.motors import motors_of
from fiber_core.outcomes import Reason
from fiber_core.presets import PRESETS, preset
from fiber_core.problem import Problem
from fiber_formats import problem_from, read_layout
from fiber_planner import pair_bound
from fiber_planner.direct.reachability import reachable
from fiber_positioners import Orders, make_orders, random_problem

__all__ = ["least_gaps", "main", "run"]

_DATA = Path(os.environ.get("FIBER_DATA", Path(__file__).parents[2] / "shared" / "data"))
_RESULTS = Path(__file__).parent / "results"
_STEP_S = 0.02  # of the samples
_SMALL = 40  # robots of the plan that is made first, so that compilation is not counted


def _of_files(*names: str) -> Callable[[int], Problem]:
    return lambda seed: random_problem(read_layout([_DATA / name for name in names]).plane, seed)


def _of_preset(name: str) -> Callable[[int], Problem]:
    return lambda seed: random_problem(preset(name), seed)


def _desi_tile(seed: int) -> Problem:
    found = problem_from(
        layout=_DATA / "desi/fp-20260219.ecsv",
        starts=_DATA / "desi/fp-20260219.ecsv",
        targets=_DATA / "cases/desi_tile0.csv",
        seed=seed,
    )
    return found.problem


PLANES: dict[str, Callable[[int], Problem]] = {
    "desi_2026": _of_files("desi/calib-20260303.csv"),
    "desi_tile": _desi_tile,
    "sdss_v_apo": _of_files(
        *(
            f"sdss_v/apo_{k}.csv"
            for k in ("positionerTable", "wokCoords", "fiducialCoords", "gfaCoords")
        )
    ),
    **{
        name: _of_preset(name)
        for name in ("desi_petals", "spec_s5", "must", "wst_mixed")
        if name in PRESETS
    },
}


def run(name: str, seed: int, bare: bool) -> dict[str, object]:
    """Plan a field of one of PLANES and return its line of the results.

    Args:
        name: one of PLANES.
        seed: of the field.
        bare: whether it is planned without walls, too.
    """
    problem = PLANES[name](seed)
    orders = make_orders(problem)
    plane, motion, margin_mm = orders.plane, orders.wire.decoded(), orders.safety.margin_mm
    bound_s = lower_bound_s(orders.start_problem)
    at_once = pair_bound(orders.start_problem, margin_mm)
    can = reachable(orders.start_problem, neighbour_pairs(plane), margin_mm)
    reached = orders.reason == Reason.OK
    reached &= problem.asked
    moves = (motion.counts > 0).any(axis=1)
    certificate = orders.discretization.certificate
    unsafe = certificate.pairs[certificate.unsafe]
    with_motion = np.append(moves, np.zeros(plane.fixtures, dtype=bool))[unsafe].any(axis=1)
    broken = certificate.limits_broken | certificate.moved_disabled
    to_walls, to_arms = least_gaps(plane, motion)
    error_mm = kinematics.on_target(problem.plane, motion.end, problem.targets).error_mm
    line: dict[str, object] = {
        "plane": name,
        "seed": seed,
        "robots": plane.n,
        "enabled": int(plane.enabled.sum()),
        "walls": len(plane.walls),
        "fibres": len(plane.fibre_names),
        "asked": int(problem.asked.sum()),
        "reachable": int(can.sum()),
        "clear_ends": at_once.robots,
        "clear_ends_proven": at_once.proven,
        "reached": int(reached.sum()),
        "certified": not (with_motion.any() or broken.any()),
        "close_at_rest": int(np.count_nonzero(~with_motion) + certificate.close_at_rest.sum()),
        "wall_contacts": int((to_walls[moves] <= 0.0).sum()),
        "least_to_walls_mm": _rounded(to_walls[moves]),
        "least_between_arms_mm": _rounded(to_arms[moves]),
        "fastest_motor": _fastest_motor(plane, motion),
        "error_um": round(1e3 * float(error_mm[reached].max(initial=0.0)), 3),
        "makespan_s": round(motion.makespan_s, 4),
        "lower_bound_s": round(bound_s, 4),
        "ratio": round(motion.makespan_s / bound_s, 4),
        "cpu_s": _cpu_s(orders),
    }
    if bare and len(plane.walls):
        without = replace(problem, plane=replace(problem.plane, walls=None))
        line["cpu_without_walls_s"] = _cpu_s(make_orders(without))
    return line


def _cpu_s(orders: Orders) -> float:
    return round(sum(orders.cpu_seconds.values()), 3)


def _rounded(gaps: Floats) -> float | None:
    least = float(gaps.min(initial=np.inf))
    return round(least, 4) if np.isfinite(least) else None


def _fastest_motor(plane: FocalPlane, motion: SegmentMotion) -> float | None:
    # highest speed of a coupled motor by its limit, between two breaks of any joint of its robot
    if not plane.coupling.shape[1]:
        return None
    begins, ends = motion.begins_s, motion.begins_s + motion.duration_s
    times = np.unique(np.round(np.concatenate([begins, ends]), 6))
    fastest = 0.0
    for middle in 0.5 * (times[1:] + times[:-1]):
        speed = np.abs(motors_of(plane, motion.velocity(float(middle)))) / plane.motor_speeds
        fastest = max(fastest, float(speed.max(initial=0.0)))
    return round(fastest, 5)


# --- gaps, in samples of the motion and without the code of the certificate


def least_gaps(plane: FocalPlane, motion: SegmentMotion) -> tuple[Floats, Floats]:
    """Return how near each robot comes to walls and to other robots in samples of a motion [mm].

    Args:
        plane: the focal plane.
        motion: the motion.

    Returns:
        The least gap of each robot to the walls and to other robots, negative in contact, inf
        where nothing is near; both shape (n,).
    """
    pairs = neighbour_pairs(plane, 0.5).astype(np.int64)
    walls_from = plane.n + len(plane.obstacles)
    to_walls, to_arms = np.full(plane.n, np.inf), np.full(plane.n, np.inf)
    of_walls = pairs[pairs[:, 1] >= walls_from]
    of_arms = pairs[pairs[:, 1] < plane.n]
    samples = 1 + int(np.ceil(motion.makespan_s / _STEP_S))
    for t in np.linspace(0.0, motion.makespan_s, samples):
        links = _links(plane, motion(float(t)))
        for own, radius in links:
            walls = plane.walls[of_walls[:, 1] - walls_from]
            gap = _gaps(own[of_walls[:, 0]], walls, radius[of_walls[:, 0]])
            np.minimum.at(to_walls, of_walls[:, 0], gap)
            for other, other_radius in links:
                a, b = of_arms.T
                gap = _gaps(own[a], other[b], radius[a] + other_radius[b])
                np.minimum.at(to_arms, a, gap)
                np.minimum.at(to_arms, b, gap)
    return to_walls, to_arms


def _links(plane: FocalPlane, angles: Angles) -> list[tuple[Floats, Floats]]:
    # corners and rounding of both links of all robots in the focal plane [mm]
    theta, phi = angles.T
    elbow = kinematics.forward(plane, angles)[0]
    links = [(_placed(plane.phi_vertices, theta + phi, elbow), plane.phi_radius)]
    if plane.theta_vertices.shape[1]:
        links.append((_placed(plane.theta_vertices, theta, plane.centers), plane.theta_radius))
    return links


def _placed(vertices: Floats, angle: Floats, origin: Floats) -> Floats:
    along = np.stack([np.cos(angle), np.sin(angle)], axis=1)[:, None]
    across = np.stack([-np.sin(angle), np.cos(angle)], axis=1)[:, None]
    return origin[:, None] + vertices[..., :1] * along + vertices[..., 1:] * across


def _gaps(first: Floats, second: Floats, radius: Floats) -> Floats:
    # gaps of polygons with as many corners a row as the arrays have, less the rounding
    gap = np.full(len(first), np.inf)
    near = np.flatnonzero(_between_circles(first, second) < radius + 0.5)
    if len(near):
        a, b = first[near], second[near]
        outside = np.minimum(_corners_to_edges(a, b), _corners_to_edges(b, a))
        touching = _edges_cross(a, b) | _is_inside(a[:, 0], b) | _is_inside(b[:, 0], a)
        gap[near] = np.where(touching, 0.0, outside) - radius[near]
    return gap


def _between_circles(first: Floats, second: Floats) -> Floats:
    middles, reach = [], 0.0
    for polygon in (first, second):
        middle = 0.5 * (polygon.min(axis=1) + polygon.max(axis=1))
        middles.append(middle)
        reach = reach + np.linalg.norm(polygon - middle[:, None], axis=2).max(axis=1)
    return np.linalg.norm(middles[0] - middles[1], axis=1) - reach


def _corners_to_edges(points: Floats, polygon: Floats) -> Floats:
    begin, along = polygon[:, None], (np.roll(polygon, -1, axis=1) - polygon)[:, None]
    to = points[:, :, None] - begin
    length2 = (along**2).sum(axis=3)
    share = np.clip((to * along).sum(axis=3) / np.where(length2 > 0.0, length2, 1.0), 0.0, 1.0)
    return np.linalg.norm(to - share[..., None] * along, axis=3).min(axis=(1, 2))


def _cross(u: Floats, v: Floats) -> Floats:
    return u[..., 0] * v[..., 1] - u[..., 1] * v[..., 0]


def _edges_cross(first: Floats, second: Floats) -> Mask:
    p, q = first[:, :, None], second[:, None]
    r = np.roll(first, -1, axis=1)[:, :, None] - p
    s = np.roll(second, -1, axis=1)[:, None] - q
    ends_apart = _cross(r, q - p) * _cross(r, q + s - p) < 0.0
    crossing = ends_apart & (_cross(s, p - q) * _cross(s, p + r - q) < 0.0)
    return np.any(crossing, axis=(1, 2))


def _is_inside(points: Floats, polygon: Floats) -> Mask:
    edges = np.roll(polygon, -1, axis=1) - polygon
    side = _cross(edges, points[:, None] - polygon)
    area = _cross(polygon, np.roll(polygon, -1, axis=1)).sum(axis=1)
    return (np.abs(area) > 1e-9) & ((side >= 0.0).all(axis=1) | (side <= 0.0).all(axis=1))


# --- the table


def markdown(lines: list[dict]) -> str:
    """Return the table of all results, one row for each plane."""
    columns = (
        "plane | robots in use | walls | fields | reached of reachable, worst field | all fields | "
        "of those with ends clear of each other | "
        "certified | pairs that start too close and rest | wall contacts | "
        "least gap to a wall, between arms [mm] | fastest motor by its "
        "limit | end error, most [um] | makespan / lower bound, median and worst | plan and "
        "discretize, processor time [s], median | by that without walls, median"
    )
    rows = [columns, " | ".join("---" for _ in columns.split(" | "))]
    order = list(PLANES)
    lines = sorted(lines, key=lambda line: order.index(line["plane"]))
    for plane, several in groupby(lines, lambda line: line["plane"]):
        fields = list(several)
        of: dict[str, list[Any]] = {key: [line.get(key) for line in fields] for key in fields[0]}
        share = [reached / can for reached, can in zip(of["reached"], of["reachable"])]
        cost = [
            line["cpu_s"] / line["cpu_without_walls_s"]
            for line in fields
            if "cpu_without_walls_s" in line
        ]
        rows.append(
            f"{plane} | {of['enabled'][0]} of {of['robots'][0]} | {of['walls'][0]} | "
            f"{len(fields)} | {100 * min(share):.2f} % | "
            f"{100 * sum(of['reached']) / sum(of['reachable']):.3f} % | "
            f"{100 * sum(of['reached']) / max(sum(of['clear_ends']), 1):.3f} % | "
            f"{sum(of['certified'])} of {len(fields)} | {sum(of['close_at_rest'])} | "
            f"{sum(of['wall_contacts'])} | "
            f"{_least(of['least_to_walls_mm'])}, {_least(of['least_between_arms_mm'])} | "
            f"{_most(of['fastest_motor'])} | {max(of['error_um']):.2f} | "
            f"{median(of['ratio']):.3f}, {max(of['ratio']):.3f} | {median(of['cpu_s']):.1f} | "
            f"{f'{median(cost):.2f}' if cost else '-'}"
        )
    return "\n".join(f"| {row} |" for row in rows) + "\n"


def _least(values: list[float | None]) -> str:
    known = [value for value in values if value is not None]
    return f"{min(known):.3f}" if known else "-"


def _most(values: list[float | None]) -> str:
    known = [value for value in values if value is not None]
    return f"{max(known):.4f}" if known else "-"


def main(argv: list[str] | None = None) -> int:
    """Run the fields from the command line; returns the exit code."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.ArgumentDefaultsHelpFormatter
    )
    parser.add_argument("--planes", nargs="+", default=list(PLANES), choices=list(PLANES))
    parser.add_argument("--seeds", type=int, default=5, help="fields of each plane")
    parser.add_argument("--first-seed", type=int, default=100)
    parser.add_argument("--no-bare", action="store_true", help="do not plan without walls, too")
    parser.add_argument("--out", type=Path, default=_RESULTS, help="folder of the results")
    options = parser.parse_args(argv)
    options.out.mkdir(parents=True, exist_ok=True)
    path = options.out / "geometry.jsonl"
    lines = [json.loads(line) for line in path.read_text().splitlines()] if path.exists() else []
    for name in options.planes:
        first = PLANES[name](options.first_seed)
        rows = np.arange(min(_SMALL, first.plane.n))
        make_orders(Problem(first.plane.permuted(rows), first.start[rows], first.targets[rows]))
        fields = 1 if name == "desi_tile" else options.seeds
        for seed in range(options.first_seed, options.first_seed + fields):
            line = run(name, seed, not options.no_bare)
            print(json.dumps(line), flush=True)
            lines = [x for x in lines if (x["plane"], x["seed"]) != (name, seed)] + [line]
            path.write_text("".join(json.dumps(each) + "\n" for each in lines))
    (options.out / "geometry.md").write_text(markdown(lines))
    return 0


if __name__ == "__main__":
    sys.exit(main())
