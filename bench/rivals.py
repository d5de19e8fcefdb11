#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Our planners and the planner of SDSS-V on the same problems, in one run and one table.

All arms of a plane of SDSS-V are folded, as its planner wants them, and every robot gets a target:
random fields. The speeds, arms and half widths are the same for all. Every answer is judged alike:
its constant-velocity segments, as they would be sent, in continuous time with whole outlines.

    pip install sdss-kaiju         # in an environment of its own, it needs numpy 1
    python3 bench/rivals.py --kaiju-python PATH/bin/python
"""

import argparse
import json
import subprocess
import sys
import tempfile
from pathlib import Path
from statistics import median
from typing import Any, TypeAlias

import numpy as np

from fiber_core.clearance import Safety, certify
from fiber_core.fields import Field, random_field
from fiber_core.focal_plane import FocalPlane
from fiber_core.kinematics import forward
from fiber_core.metrics import lower_bound_s
from fiber_core.motion import SegmentMotion
from fiber_core.outcomes import Reason
from fiber_core.presets import preset
from fiber_planner import pair_bound
from fiber_positioners import make_orders

__all__ = ["main", "motion_of", "ours", "theirs"]

FOLD_DEG = (0.0, 180.0)
OURS = ("direct", "dnf_arms_priority")
THEIRS = ("greedy", "mdp")
_TOUCH = Safety(0.0, 0.0, 0.0, 0.0, 0.0, 0.0)  # outlines alone: no margin, no errors of timing
_ADAPTER = Path(__file__).with_name("kaiju_adapter.py")

Row: TypeAlias = dict[str, Any]


def field_of(robots: int, seed: int) -> Field:
    """Return a random field of a plane of SDSS-V whose arms are all folded."""
    plane = preset("sdss_v", robots)
    start = np.tile(np.radians(FOLD_DEG), (plane.n, 1))
    return random_field(plane, np.random.default_rng(seed), start=start)


def ours(planner: str, field: Field) -> Row:
    """Return the row of one of our planners, down to the bytes.

    Args:
        planner: its name.
        field: a problem.
    """
    orders = make_orders(field.problem, planner=planner)
    motion = orders.wire.decoded()
    cpu_s = orders.cpu_seconds["plan_s"] + orders.cpu_seconds["discretize_s"]
    return {"planner": planner} | _judged(
        field, motion, orders.reason == Reason.OK, cpu_s, orders.safety
    )


def theirs(algorithm: str, field: Field, seed: int, python: str) -> Row:
    """Return the row of sdss-kaiju, run in the Python that has it.

    Args:
        algorithm: one of THEIRS.
        field: a problem whose plane has one length and half width for all arms.
        seed: of its own random choices.
        python: an interpreter that imports kaiju.

    Raises:
        RuntimeError: the adapter failed, or its kinematics are not ours.
    """
    plane, goal_deg = field.problem.plane, np.degrees(field.goal)
    with tempfile.TemporaryDirectory() as folder:
        problem, answer = Path(folder) / "problem.npz", Path(folder) / "answer.npz"
        np.savez(
            problem, centre_mm=plane.centers, arms_mm=plane.arms[0], radius_mm=plane.phi_radius[0],
            goal_deg=goal_deg, fold_deg=FOLD_DEG, speed_deg_s=np.degrees(plane.speeds[0, 0]),
            algorithm=algorithm, seed=seed,
        )  # fmt: skip
        done = subprocess.run([python, str(_ADAPTER), str(problem), str(answer)],
                              capture_output=True, text=True, check=False)  # fmt: skip
        if done.returncode:
            raise RuntimeError(f"sdss-kaiju: {done.stderr.strip().splitlines()[-1]}")
        with np.load(answer) as arrays:
            points, reached = arrays["points"], arrays["reached"]
            tips_mm, cpu_s = arrays["tips_mm"], float(arrays["cpu_s"])
    if np.abs(tips_mm - forward(plane, field.goal)[1]).max() > 1e-6:
        raise RuntimeError("sdss-kaiju puts the fibres elsewhere at the same angles")
    motion = motion_of(plane, points)
    return {"planner": f"sdss-kaiju, {algorithm}"} | _judged(field, motion, reached, cpu_s, _TOUCH)


def motion_of(plane: FocalPlane, points: np.ndarray) -> SegmentMotion:
    """Return the motion along the points of every joint, at constant velocity between two.

    Args:
        plane: the focal plane.
        points: robot, joint, time [s] and angle [deg] of each point, shape (p, 4), in the order
            of robots, joints and times.
    """
    joint = (2 * points[:, 0] + points[:, 1]).astype(int)
    counts = np.bincount(joint, minlength=2 * plane.n)
    first = np.concatenate([[0], np.cumsum(counts)[:-1]])
    start = np.radians(points[first, 3]).reshape(-1, 2)
    same = joint[1:] == joint[:-1]
    duration_s = np.diff(points[:, 2])[same]
    velocity = np.radians(np.diff(points[:, 3])[same]) / duration_s
    offsets = np.concatenate([[0], np.cumsum(counts - 1)])
    return SegmentMotion(start, offsets, duration_s, velocity)


def _judged(
    field: Field, motion: SegmentMotion, reached: np.ndarray, cpu_s: float, safety: Safety
) -> Row:
    problem = field.problem
    plane = problem.plane
    at_goal = np.abs(motion.end - field.goal).max(axis=1) < np.radians(0.05)
    touched = certify(plane, motion, _TOUCH)
    segments = motion.counts[motion.counts > 0]
    return {
        "robots": plane.n,
        "reached": int((reached & at_goal).sum()),
        "asked": int(problem.asked.sum()),
        "ratio": motion.makespan_s / lower_bound_s(problem),
        "pair_ratio": motion.makespan_s / pair_bound(problem, 0.0).time_s,
        "segments_mean": float(segments.mean()),
        "segments_max": int(segments.max()),
        "overlaps": int(touched.unsafe.sum()),
        "least_gap_mm": touched.min_gap_mm,
        "certified": "yes" if certify(plane, motion, safety).ok else "no",
        "cpu_s": cpu_s,
    }


def has_kaiju(python: str) -> bool:
    """Return whether a Python imports sdss-kaiju."""
    asked = [python, "-c", "import kaiju.robotGrid"]
    try:
        return subprocess.run(asked, capture_output=True, check=False).returncode == 0
    except OSError:
        return False


_PREFACE = """# Rivals on the same problems

Made by `make rivals KAIJU=python`: `bench/rivals.py`, which fails if a plan of ours is not
certified with the margin of `Safety`. Arms of SDSS-V, all folded at first, one target for each
robot. Ours are down to the bytes; the answers of sdss-kaiju are the simplified paths that its own
program sends, with its defaults (steps of 0.1 deg). Where a robot of it is in a deadlock its
makespan is its limit of steps. Gaps are those of whole outlines in continuous time. Each field is
a line of `rivals.jsonl`.

"""


def markdown(rows: list[Row]) -> str:
    """Return the table: one line a planner, medians over the fields, the worst where it says so."""
    heads = (
        "planner | robots | fields | reached, all fields | makespan / bound: median, worst | "
        "/ pair bound | segments a moving motor: mean, most | overlapping pairs, all fields | "
        "least gap [mm] | compute [s]"
    )
    lines = [heads, " | ".join("---" for _ in heads.split(" | "))]
    for planner in dict.fromkeys(row["planner"] for row in rows):
        of = [row for row in rows if row["planner"] == planner]
        column = {key: [row[key] for row in of] for key in of[0]}
        lines.append(
            f"{planner} | {of[0]['robots']} | {len(of)} | "
            f"{sum(column['reached'])} of {sum(column['asked'])} | "
            f"{median(column['ratio']):.3f}, {max(column['ratio']):.3f} | "
            f"{median(column['pair_ratio']):.3f} | "
            f"{np.mean(column['segments_mean']):.2f}, {max(column['segments_max'])} | "
            f"{sum(column['overlaps'])} | {min(column['least_gap_mm']):.3f} | "
            f"{median(column['cpu_s']):.2f}"
        )
    return "\n".join(f"| {line} |" for line in lines) + "\n"


def main(argv: list[str] | None = None) -> int:
    """Run all planners from the command line; returns the exit code."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--robots", type=int, default=547)
    parser.add_argument("--fields", type=int, default=3)
    parser.add_argument("--first-seed", type=int, default=300)
    parser.add_argument("--kaiju-python", default=sys.executable,
                        help="Python that has sdss-kaiju (this one)")  # fmt: skip
    parser.add_argument("--out", type=Path, help="file for the table")
    options = parser.parse_args(argv)
    theirs_too = has_kaiju(options.kaiju_python)
    if not theirs_too:
        print(
            f"SKIPPED: sdss-kaiju, as {options.kaiju_python} has no module kaiju "
            "(pip install sdss-kaiju in a Python of its own, --kaiju-python)",
            file=sys.stderr,
        )
    make_orders(field_of(37, 0).problem, planner="direct")  # compile
    rows: list[Row] = []
    for seed in range(options.first_seed, options.first_seed + options.fields):
        field = field_of(options.robots, seed)
        found = [ours(planner, field) for planner in OURS]
        if theirs_too:
            found += [theirs(each, field, seed, options.kaiju_python) for each in THEIRS]
        rows += [{"seed": seed} | row for row in found]
        for row in rows[-len(found) :]:
            print(json.dumps(row), flush=True)
    table = markdown(rows)
    print(table)
    if options.out:
        options.out.write_text(_PREFACE + table)
        lines = options.out.with_suffix(".jsonl")
        lines.write_text("".join(json.dumps(row) + "\n" for row in rows))
    return int(any(row["certified"] == "no" for row in rows if row["planner"] in OURS))


if __name__ == "__main__":
    sys.exit(main())
