#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Discretize the same trajectories in several ways and write tables: segments, safety, speed.

Four tables. *methods*: lines of each joint inside the same corridors, not rounded and not
certified. *chain*: orders as sent, certified on the motion that they decode to, with the number
of robots held. *min_link* and *certificate*: the speed of the line fits and of the certificate,
which is compared with a dense search. Times are processor times without compilation; those of
*methods*, *min_link* and *certificate* are medians.
"""

import argparse
import json
import sys
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TypeVar

import numpy as np

from fiber_core import kinematics
from fiber_core.array_types import Ints, Rows
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
    joint_shares,
    linearize,
    tip_distances_mm,
)
from fiber_positioners import Orders, make_orders, random_problem

__all__ = ["main"]

_Result = TypeVar("_Result")

_SAFETY = Safety()
_FRAME_BYTES = 4  # opcode, sequence and counts, CRC of an order
WAYS = {
    "makarem2014": DiscretizeOptions(sharing="makarem2014", method="douglas_peucker"),
    "makarem2014 as printed": DiscretizeOptions(
        sharing="makarem2014", method="douglas_peucker", rule="printed"
    ),
    "makarem2014, greedy": DiscretizeOptions(sharing="makarem2014", method="greedy"),
    "makarem2014, minimal": DiscretizeOptions(sharing="makarem2014", method="minimal"),
    "sequential, douglas_peucker": DiscretizeOptions(method="douglas_peucker"),
    "sequential, greedy": DiscretizeOptions(method="greedy"),
    "sequential (default)": DiscretizeOptions(),
    "sequential, 4 segments at most": DiscretizeOptions(max_segments=4),
}


def planned(plane: FocalPlane, planner: str, seed: int) -> Orders:
    """Return a random problem with its plan and its orders, discretized as by default."""
    return make_orders(random_problem(plane, seed), planner=planner)


def of_methods(plane: FocalPlane, motion: SampledMotion) -> list[dict]:
    """Return a row for each rule and method: lines of each joint, in the steps of the paper.

    The share of a robot is half of the free space to a neighbour, which is by rule: the gap
    less the required gap, the distance of the tips less d (half the envelope), or the
    whole distance of the tips, as printed.
    """
    pairs, every = neighbour_pairs(plane), np.ones(plane.n, dtype=bool)
    fastest = point_speeds(levers_of(plane), plane.speeds)
    required = _SAFETY.required_at(fastest, float(motion.time_s[-1]), pairs)[:, None]
    spaces = {
        "gap - required": lambda angles: sampled_gaps(plane, pairs, angles) - required,
        "tips - d": lambda angles: tip_distances_mm(plane, pairs, angles) - plane.envelope_mm / 2,
        "tips, as printed": lambda angles: tip_distances_mm(plane, pairs, angles),
    }
    rows = []
    for rule, space in spaces.items():
        for method in LINEARIZERS:
            angles, counts, cpu_s = motion.angles.copy(), [], 0.0
            for joint in (0, 1):
                share = joint_shares(plane, joint, pairs, space(angles), angles[:, 1], every)
                work = partial(
                    linearize,
                    motion.time_s,
                    angles[:, joint],
                    angles[:, joint] - share,
                    angles[:, joint] + share,
                    method,
                    plane.speeds[:, joint] * 1.01,
                )
                path, seconds = _timed(work)
                cpu_s += seconds
                counts.append(path.counts[path.counts > 0])
                angles[:, joint] = path(motion.time_s)
            by_joint = _by_joint(counts)
            rows.append(
                {"free_space": rule, "method": method, **by_joint, "cpu_s": round(cpu_s, 3)}
            )
    return rows


def of_chain(orders: Orders, way: str) -> dict:
    """Return the row of orders made in one way: robots held, segments, bytes, errors, times."""
    plane, units, plan = orders.plane, orders.units, orders.planned
    work = partial(discretize, plane, plan.motion, units, _SAFETY, orders.counts, WAYS[way])
    work()
    done, cpu_s = _timed(work, 1)
    motion = done.wire.decoded()
    certificate = certify(plane, motion, _SAFETY)
    arriving = plan.reason == Reason.OK
    reached = arriving & (done.reason == Reason.OK)
    by_joint = motion.counts
    segments = by_joint.sum(axis=1)
    error_um = 6e3 * np.abs(motion.end - plan.motion.end)[done.reason == Reason.OK].max(axis=1)
    tips = kinematics.forward(plane, motion.end)[1] - kinematics.forward(plane, plan.motion.end)[1]
    tip_um = 1e3 * np.hypot(*tips[done.reason == Reason.OK].T)
    one_each = (by_joint <= 1).all(axis=1) & (segments > 0)
    frames = _FRAME_BYTES + units.segment_bytes * segments
    moving = by_joint[by_joint > 0]
    return {
        "way": way,
        "planned": int(arriving.sum()),
        "reached": int(reached.sum()),
        "held": int((arriving & ~reached).sum()),
        "too_many": int((done.reason == Reason.TOO_MANY_SEGMENTS).sum()),
        "certified": bool(certificate.ok),
        "mean": round(float(moving.mean()), 4),
        **_by_joint([by_joint[by_joint[:, j] > 0, j] for j in (0, 1)]),
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
    """Return the number of lines and the time of each method in random corridors."""
    rng = np.random.default_rng(0)
    time_s = np.linspace(0.0, 2.5, samples)
    walks = np.cumsum(rng.normal(0.0, 0.02, (profiles, samples)), axis=1)
    rows = []
    for corridor, width in (("0.3 rad", 0.3), ("0 to 0.1 rad", rng.uniform(0.0, 0.1, walks.shape))):
        for method in LINEARIZERS:
            work = partial(linearize, time_s, walks, walks - width, walks + width, method)
            path, cpu_s = _timed(work, 5)
            counts = path.counts
            rows.append(
                {
                    "corridor": corridor,
                    "method": method,
                    "lines_mean": round(float(counts.mean()), 3),
                    "lines_max": int(counts.max()),
                    "cpu_s": cpu_s,
                    "ns_a_sample": round(1e9 * cpu_s / (profiles * samples), 1),
                }
            )
    return rows


def of_certificate(plane: FocalPlane, motion: SegmentMotion) -> dict:
    """Return the time of the certificate, and its bound compared with a dense search."""
    begin = time.perf_counter()
    certificate = certify(plane, motion, _SAFETY)
    wall_s = time.perf_counter() - begin
    _, cpu_s = _timed(lambda: certify(plane, motion, _SAFETY), 5)
    # the closest pairs at 20,001 instants, and at as many around the least gap of these
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


def _dense_minimum(plane: FocalPlane, motion: SegmentMotion, rows: Rows) -> float:
    two, least = plane.permuted(np.asarray(rows)), np.inf
    times = np.linspace(0.0, motion.makespan_s, 20_001)
    for _ in range(2):
        angles = np.empty((2, 2, len(times)))
        for k, row in enumerate(rows):
            for joint in (0, 1):
                profile = slice(*motion.offsets[2 * row + joint : 2 * row + joint + 2])
                knots = np.concatenate([[0.0], np.cumsum(motion.duration_s[profile])])
                steps = motion.duration_s[profile] * motion.velocity_rad_s[profile]
                reached = motion.start[row, joint] + np.concatenate([[0.0], np.cumsum(steps)])
                angles[k, joint] = np.interp(times, knots, reached)
        gaps = sampled_gaps(two, [[0, 1]], angles)[0]
        least = min(least, gaps.min())
        span = motion.makespan_s / 20_000
        around = times[np.argmin(gaps)] + np.linspace(-span, span, 20_001)
        times = np.clip(around, 0.0, motion.makespan_s)
    return float(least)


def _by_joint(counts: list[Ints]) -> dict[str, float]:
    names = ("theta", "phi")
    figures = {f"{n}_mean": round(float(c.mean()), 3) for n, c in zip(names, counts) if len(c)}
    return figures | {f"{n}_max": int(c.max()) for n, c in zip(names, counts) if len(c)}


def _timed(work: Callable[[], _Result], times: int = 3) -> tuple[_Result, float]:
    # the last result and the median of the processor times
    runs = [_run(work) for _ in range(times)]
    return runs[-1][0], round(float(np.median([cpu_s for _, cpu_s in runs])), 4)


def _run(work: Callable[[], _Result]) -> tuple[_Result, float]:
    begin = time.process_time()
    result = work()
    return result, time.process_time() - begin


def markdown(rows: list[dict]) -> str:
    """Return rows with the same columns as a table in markdown."""
    columns = list(rows[0])
    lines = [columns, ["---"] * len(columns)] + [[str(row[c]) for c in columns] for row in rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines) + "\n"


def main(argv: list[str] | None = None) -> int:
    """Run the command; return its exit code."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--plane", default="desi", help="name of a preset")
    parser.add_argument("--robots", type=int, help="number of robots; by default all")
    planners = ["direct", "dnf", "dnf_arms"]
    parser.add_argument("--planners", nargs="+", default=planners, help="names of planners")
    ways = list(WAYS)
    parser.add_argument("--ways", nargs="+", default=ways, choices=ways, help="rows of 'chain'")
    parser.add_argument("--seeds", type=int, default=1, help="number of random fields")
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
