#!/usr/bin/env python3
"""Discretize the same trajectories in several ways and write tables: segments, safety, speed.

Three tables. *Methods*: lines of each motor inside the same margins, nothing rounded, nothing
certified. *Chain*: orders as sent, certified on what they decode to, and who was held.
*Speed*: the minimum-link path and the certificate, with the bounds they are held against.
Times are processor times, of methods and certificate medians; everything is compiled before.
"""

import argparse
import json
import sys
import time
from functools import partial
from pathlib import Path

import numpy as np

from fiber_core import kinematics
from fiber_core.clearance import (
    Safety,
    certify,
    levers_of,
    neighbour_pairs,
    point_speeds,
    sampled_gaps,
)
from fiber_core.focal_plane import FocalPlane
from fiber_core.metrics import ORDER_BYTES_BOUND
from fiber_core.motion import SampledMotion, SegmentMotion
from fiber_core.outcomes import Reason
from fiber_core.presets import preset
from fiber_discretizer import (
    LINEARIZERS,
    DiscretizeOptions,
    discretize,
    joint_margins,
    linearize,
    tip_distances_mm,
)
from fiber_positioners import Orders, make_orders, random_problem

__all__ = ["main"]

_SAFETY = Safety()
_FRAME_BYTES = 4  # opcode, sequence and counts, CRC of an order
WAYS = {
    "paper": DiscretizeOptions(sharing="halves", method="paper"),
    "paper, margin as printed": DiscretizeOptions(sharing="halves", method="paper", rule="printed"),
    "halves, greedy": DiscretizeOptions(sharing="halves", method="greedy"),
    "halves, minimal": DiscretizeOptions(sharing="halves", method="minimal"),
    "turns, paper": DiscretizeOptions(method="paper"),
    "turns, greedy": DiscretizeOptions(method="greedy"),
    "turns (default)": DiscretizeOptions(),
    "turns, 4 segments at most": DiscretizeOptions(max_segments=4),
}


def planned(plane: FocalPlane, planner: str, seed: int) -> Orders:
    """Return a random problem with its plan and its orders, discretized as by default."""
    return make_orders(random_problem(plane, seed), planner=planner)


def of_methods(plane: FocalPlane, motion: SampledMotion) -> list[dict]:
    """Return a row per margin and method: lines of each motor, in the steps of the paper.

    Margins are half of what two neighbours have beside each other: of their gap less the gap
    required, of the distance of their tips less d (half the spacing of targets), and of the
    whole distance of their tips, as printed.
    """
    pairs, every = neighbour_pairs(plane), np.ones(plane.n, dtype=bool)
    fastest = point_speeds(levers_of(plane), plane.speeds)
    required = _SAFETY.required_at(fastest, float(motion.time_s[-1]), pairs)[:, None]
    spaces = {
        "gap - required": lambda angles: sampled_gaps(plane, pairs, angles) - required,
        "tips - d": lambda angles: tip_distances_mm(plane, pairs, angles) - plane.spacing_mm / 2,
        "tips, as printed": lambda angles: tip_distances_mm(plane, pairs, angles),
    }
    rows = []
    for margin, space in spaces.items():
        for method in LINEARIZERS:
            angles, counts, cpu_s = motion.angles.copy(), [], 0.0
            for joint in (0, 1):
                room = joint_margins(plane, joint, pairs, space(angles), angles[:, 1], every)
                work = partial(
                    linearize,
                    motion.time_s,
                    angles[:, joint],
                    angles[:, joint] - room,
                    angles[:, joint] + room,
                    method,
                    plane.speeds[:, joint] * 1.01,
                )
                path, seconds = _timed(work)
                cpu_s += seconds
                counts.append(path.counts[path.counts > 0])
                angles[:, joint] = path(motion.time_s)
            by_motor = _by_motor(counts)
            rows.append({"margin": margin, "method": method, **by_motor, "cpu_s": round(cpu_s, 3)})
    return rows


def of_chain(orders: Orders, way: str) -> dict:
    """Return what orders made in one way come to."""
    plane, units, plan = orders.plane, orders.units, orders.planned
    work = partial(discretize, plane, plan.motion, units, _SAFETY, orders.counts, WAYS[way])
    work()
    done, cpu_s = _timed(work, 1)
    motion = done.wire.decoded()
    certificate = certify(plane, motion, _SAFETY)
    meant = plan.reason == Reason.OK
    reached = meant & (done.reason == Reason.OK)
    by_motor = motion.counts
    segments = by_motor.sum(axis=1)
    error_um = 6e3 * np.abs(motion.end - plan.motion.end)[done.reason == Reason.OK].max(axis=1)
    tips = kinematics.forward(plane, motion.end)[1] - kinematics.forward(plane, plan.motion.end)[1]
    tip_um = 1e3 * np.hypot(*tips[done.reason == Reason.OK].T)
    one_each = (by_motor <= 1).all(axis=1) & (segments > 0)
    frames = _FRAME_BYTES + units.segment_bytes * segments
    moving = by_motor[by_motor > 0]
    return {
        "way": way,
        "planned": int(meant.sum()),
        "reached": int(reached.sum()),
        "held": int((meant & ~reached).sum()),
        "too_many": int((done.reason == Reason.TOO_MANY_SEGMENTS).sum()),
        "certified": bool(certificate.ok),
        "mean": round(float(moving.mean()), 4),
        **_by_motor([by_motor[by_motor[:, j] > 0, j] for j in (0, 1)]),
        "bytes_mean": round(float(frames[segments > 0].mean()), 2),
        "bytes_one_each": int(frames[one_each].max(initial=0)),
        "bytes_bound": ORDER_BYTES_BOUND,
        "end_um_rms": round(float(np.sqrt(np.mean(tip_um**2))), 3),
        "end_um_max": round(float(max(tip_um.max(initial=0.0), error_um.max(initial=0.0))), 3),
        "clearance_mm": round(certificate.min_gap_mm, 4),
        "makespan_s": round(motion.makespan_s, 3),
        "cpu_s": round(cpu_s, 3),
    }


def of_min_link(profiles: int = 10_000, samples: int = 250) -> list[dict]:
    """Return how long methods take on random tubes, and what they come to."""
    rng = np.random.default_rng(0)
    time_s = np.linspace(0.0, 2.5, samples)
    walks = np.cumsum(rng.normal(0.0, 0.02, (profiles, samples)), axis=1)
    rows = []
    for tube, width in (("0.3 rad", 0.3), ("0 to 0.1 rad", rng.uniform(0.0, 0.1, walks.shape))):
        for method in LINEARIZERS:
            work = partial(linearize, time_s, walks, walks - width, walks + width, method)
            path, cpu_s = _timed(work, 5)
            counts = path.counts
            rows.append(
                {
                    "tube": tube,
                    "method": method,
                    "lines_mean": round(float(counts.mean()), 3),
                    "lines_max": int(counts.max()),
                    "cpu_s": cpu_s,
                    "ns_a_sample": round(1e9 * cpu_s / (profiles * samples), 1),
                }
            )
    return rows


def of_certificate(plane: FocalPlane, motion: SegmentMotion) -> dict:
    """Return how long the certificate takes and how its bound compares with dense search."""
    begin = time.perf_counter()
    certificate = certify(plane, motion, _SAFETY)
    wall_s = time.perf_counter() - begin
    _, cpu_s = _timed(lambda: certify(plane, motion, _SAFETY), 5)
    # the closest pairs, looked at 20,001 times, and as often about the least of these
    close = np.argsort(certificate.gap_mm)[:50]
    close = close[(certificate.pairs[close] < plane.n).all(axis=1)]
    over = [
        _dense_minimum(plane, motion, certificate.pairs[k]) - certificate.gap_mm[k] for k in close
    ]
    tight = certificate.gap_mm[close] < certificate.required_mm[close]
    tight[0] = True  # the smallest is always resolved
    return {
        "pairs": len(certificate.pairs),
        "cpu_s": cpu_s,
        "wall_s": round(wall_s, 4),
        "smallest_mm": round(certificate.min_gap_mm, 5),
        "robots": [int(plane.ids[row]) for row in certificate.min_pair if row < plane.n],
        "when_s": round(certificate.min_time_s, 4),
        "above_bound_um_min": round(1e3 * float(np.min(over)), 3),
        "above_bound_um_of_smallest": round(1e3 * float(np.array(over)[tight].max()), 3),
    }


def _dense_minimum(plane, motion, rows):
    two, least = plane.permuted(np.asarray(rows)), np.inf
    times = np.linspace(0.0, motion.makespan_s, 20_001)
    for _ in range(2):
        angles = np.empty((2, 2, len(times)))
        for k, row in enumerate(rows):
            for joint in (0, 1):
                mine = slice(*motion.offsets[2 * row + joint : 2 * row + joint + 2])
                knots = np.concatenate([[0.0], np.cumsum(motion.duration_s[mine])])
                steps = motion.duration_s[mine] * motion.velocity_rad_s[mine]
                there = motion.start[row, joint] + np.concatenate([[0.0], np.cumsum(steps)])
                angles[k, joint] = np.interp(times, knots, there)
        gaps = sampled_gaps(two, [[0, 1]], angles)[0]
        least = min(least, gaps.min())
        span = motion.makespan_s / 20_000
        around = times[np.argmin(gaps)] + np.linspace(-span, span, 20_001)
        times = np.clip(around, 0.0, motion.makespan_s)
    return least


def _by_motor(counts):
    names = ("theta", "phi")
    figures = {f"{n}_mean": round(float(c.mean()), 3) for n, c in zip(names, counts) if len(c)}
    return figures | {f"{n}_max": int(c.max()) for n, c in zip(names, counts) if len(c)}


def _timed(work, times=3):
    seconds = []
    for _ in range(times):
        begin = time.process_time()
        result = work()
        seconds.append(time.process_time() - begin)
    return result, round(float(np.median(seconds)), 4)


def markdown(rows: list[dict]) -> str:
    """Return the rows as a table in markdown."""
    columns = list(rows[0])
    lines = [columns, ["---"] * len(columns)] + [[str(row[c]) for c in columns] for row in rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines) + "\n"


def main(argv=None) -> int:
    """Run the tables from the command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--plane", default="desi", help="preset")
    parser.add_argument("--robots", type=int, default=None)
    parser.add_argument("--planners", nargs="+", default=["direct", "dnf", "dnf_arms"])
    parser.add_argument("--ways", nargs="+", default=list(WAYS), choices=list(WAYS))
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("--out", type=Path, default=None, help="folder for the tables")
    options = parser.parse_args(argv)
    tables = {"methods": [], "chain": [], "min_link": of_min_link(), "certificate": []}
    plane = preset(options.plane, options.robots)
    for planner in options.planners:
        for seed in range(options.seeds):
            name = {"plane": options.plane, "planner": planner, "seed": seed}
            orders = planned(plane, planner, seed)
            if seed == 0:
                tables["methods"] += [
                    name | row for row in of_methods(plane, orders.planned.motion)
                ]
            for way in options.ways:
                tables["chain"].append(name | of_chain(orders, way))
                print(json.dumps(tables["chain"][-1]), flush=True)
            tables["certificate"].append(name | of_certificate(plane, orders.wire.decoded()))
    text = "\n".join(f"## {name}\n\n{markdown(rows)}" for name, rows in tables.items() if rows)
    print(text)
    if options.out is not None:
        options.out.mkdir(parents=True, exist_ok=True)
        file = f"discretizers_{options.plane}"
        lines = [
            json.dumps({"table": name, **row}) for name, rows in tables.items() for row in rows
        ]
        (options.out / f"{file}.jsonl").write_text("\n".join(lines) + "\n")
        (options.out / f"{file}.md").write_text(text)
    return 0


if __name__ == "__main__":
    sys.exit(main())
