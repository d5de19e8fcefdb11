#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Move blind, take an image and correct, without ROS, and print one JSON line.

Drives and camera are simulated and seeded; the judge knows the true arms. Errors are distances
of true fibres from their targets in the focal plane.

- asked: robots with a target. healthy: those that are lit, whose drive does not stick, and that the
  blind plan moves to their targets.
- identified: fibres in an image whose light is told to be theirs; misidentified: told and wrong.
- non_movers: lit robots with a joint that sticks, which was told to move the fibre by more than
  what a verdict needs; healthy_blamed: robots said not to have moved whose joints did.
- contacts: pairs of true arms that touched, those with a robot that stuck apart.
- image_s: from the pixels of one exposure to its spots, null without --pixels; measure_s: from
  spots to measured angles; correct_s: from spots to a certified correction; wall time of this
  machine, and processor time with cpu in the name. A small plane goes before, so that no loop is
  compiled in these times.
- simulated_s: both moves and what the buses take, without the exposures.
"""

import argparse
import json
import sys
import time

import numpy as np

from fiber_bus_bridge.simulation import NEVER, MechanicalErrors, draw_mechanics
from fiber_core import kinematics
from fiber_core.array_types import Angles, Floats
from fiber_core.errors import FiberError
from fiber_core.fields import random_field
from fiber_core.focal_plane import FocalPlane
from fiber_core.outcomes import Reason
from fiber_core.presets import preset
from fiber_metrology import DriveErrors, MeasureConfig, Verdict
from fiber_metrology.camera import CameraConfig, SimulatedCamera, fiducial_places
from fiber_positioners import ClosedLoop, LoopConfig, closed_loop, read_layout

# 54 um rms after a blind move of robots with arms of 3 mm
DRIVE = {"scale": 0.0041, "backlash_deg": 0.08, "wave_deg": 0.12, "speed_noise": 0.002}


def main() -> int:
    """Run the loop; return the exit code."""
    options = _options()
    try:
        print(json.dumps(run(options)), flush=True)
    except (FiberError, OSError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    return 0


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--layout", help="files of robots")
    parser.add_argument("--preset", default="desi", help="instrument (default: %(default)s)")
    parser.add_argument("--robots", type=int, help="robots of the preset, all by default")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--corrections", type=int, default=1)
    parser.add_argument(
        "--exposures", type=int, default=LoopConfig().exposures, help="of an image (%(default)s)"
    )
    parser.add_argument(
        "--pixels", action="store_true", help="find spots in the pixels of images, not in lists"
    )
    parser.add_argument("--gap", type=float, default=0.5, help="gap of random targets [mm]")
    parser.add_argument("--non-movers", type=float, default=0.01, help="share of silent non-movers")
    parser.add_argument("--dark", type=float, default=0.02, help="share of fibres without light")
    parser.add_argument("--missing", type=float, default=CameraConfig.missing)
    parser.add_argument("--merged", type=float, default=CameraConfig.merged)
    return parser.parse_args()


def run(options: argparse.Namespace) -> dict[str, object]:
    """Return the figures of one loop."""
    if options.layout:
        plane = read_layout(options.layout)
    else:
        plane = preset(options.preset, options.robots)
    _loop(preset("desi", 37), options)  # compiles
    begin = time.perf_counter()
    loop, stuck = _loop(plane, options)
    wall_s = time.perf_counter() - begin
    return {"seed": options.seed, **figures(loop, stuck), "wall_s": round(wall_s, 2)}


def _loop(plane: FocalPlane, options: argparse.Namespace) -> tuple[ClosedLoop, np.ndarray]:
    """A closed loop of a plane, and the joints that stick in the blind move, shape (n, 2)."""
    rng = np.random.default_rng(options.seed)
    problem = random_field(plane, rng, options.gap).problem
    errors = MechanicalErrors(**DRIVE, non_movers=options.non_movers)
    mechanics = draw_mechanics(plane.n, errors, rng)
    lit = rng.random(plane.n) >= options.dark
    fiducials = fiducial_places(plane)
    radius_mm = float(np.hypot(*plane.centers.T).max() + plane.arms.sum(axis=1).max())
    config = CameraConfig(missing=options.missing, merged=options.merged)
    camera = SimulatedCamera(radius_mm, config, rng)
    loop = closed_loop(
        problem, mechanics, camera, fiducials, lit,
        corrections=options.corrections, seed=options.seed,
        config=LoopConfig(exposures=options.exposures, pixels=options.pixels),
    )  # fmt: skip
    return loop, mechanics.still_in < NEVER


def told_mm(plane: FocalPlane, start: Angles, goal: Angles, stuck: np.ndarray) -> Floats:
    """Return how far from where it should be a fibre is if some joints stick [mm], shape (n,).

    Args:
        plane: the focal plane.
        start, goal: joint angles before and after the move [rad], shape (n, 2).
        stuck: joints that stick, shape (n, 2).
    """
    ends = [kinematics.forward(plane, a)[1] for a in (np.where(stuck, start, goal), goal)]
    return np.hypot(*(ends[1] - ends[0]).T)


def figures(loop: ClosedLoop, stuck: np.ndarray) -> dict[str, object]:
    """Return what the judge finds.

    Args:
        loop: the moves.
        stuck: joints that stick in the blind move, shape (n, 2).
    """
    sticks = stuck.any(axis=1)
    problem, moves = loop.problem, loop.moves
    blind, last = moves[0], moves[-1]
    asked = problem.asked
    planned = np.isin(blind.orders.reason, (Reason.OK, Reason.NO_TARGET)) & asked
    healthy = planned & loop.lit & ~sticks
    before, after = loop.errors_mm(0) * 1e3, loop.errors_mm(len(moves) - 1) * 1e3
    visible, told, wrong = 0, 0, 0
    for move in moves:
        counts = _identified(move)
        visible, told, wrong = visible + counts[0], told + counts[1], wrong + counts[2]
    ordered = blind.orders.units.to_angles(blind.run.counts)
    error_um = DriveErrors().after_um(problem.plane, problem.start, ordered)
    far = told_mm(problem.plane, problem.start, ordered, stuck) > MeasureConfig().judged_mm(
        error_um
    )
    judged = sticks & planned & loop.lit & far
    pairs = np.concatenate([m.touches.pairs[m.touches.unsafe] for m in moves])
    of_stuck = np.append(sticks, np.zeros(problem.plane.fixtures, dtype=bool))[pairs].any(axis=1)
    verdicts = last.measurement.verdict
    corrected = moves[1:2]
    correct_s = blind.measure_s + sum(move.plan_s for move in corrected)
    correct_cpu_s = blind.measure_cpu_s + sum(move.plan_cpu_s for move in corrected)
    return {
        "robots": problem.plane.n,
        "asked": int(asked.sum()),
        "healthy": int(healthy.sum()),
        "blind_rms_um": round(_rms(before[healthy]), 2),
        "corrected_rms_um": round(_rms(after[healthy]), 2),
        "corrected_p99_um": round(float(np.percentile(after[healthy], 99)), 2),
        "within_15_um": round(float(np.mean(after[healthy] <= 15.0)), 5),
        "visible": visible,
        "identified": told,
        "misidentified": wrong,
        "non_movers": int(judged.sum()),
        "non_movers_named": int((judged & loop.not_moved).sum()),
        "healthy_blamed": int((loop.not_moved & ~sticks).sum()),
        "contacts": int((~of_stuck).sum()),
        "contacts_of_non_movers": int(of_stuck.sum()),
        "verdicts": {v.name.lower(): int((verdicts == v).sum()) for v in Verdict},
        "held_blind": int((asked & ~planned).sum()),
        "image_s": _of_one(blind.image_s, len(blind.exposures)),
        "measure_s": round(blind.measure_s, 3),
        "measure_cpu_s": round(blind.measure_cpu_s, 3),
        "correct_s": round(correct_s, 3),
        "correct_cpu_s": round(correct_cpu_s, 3),
        "simulated_s": round(sum(m.simulated_s for m in moves), 3),
    }


def _of_one(seconds: float, exposures: int) -> float | None:
    return None if np.isnan(seconds) else round(seconds / exposures, 3)


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2))) if len(values) else float("nan")


def _identified(move) -> tuple[int, int, int]:
    """Fibres in some exposure, those told to be seen, and those told wrongly."""
    image = move.measurement
    seen = np.zeros(image.plane.n, dtype=bool)
    for exposure in move.exposures:
        seen[exposure.owner[exposure.owner >= 0]] = True
    told = image.certain
    rows = np.flatnonzero(told)
    first = image.lights.first[image.light[rows]]
    owner = np.array([move.exposures[k].owner[spot] for spot, k in first], dtype=np.int64)
    return int(seen.sum()), int((told & seen).sum()), int((owner != rows).sum())


if __name__ == "__main__":
    sys.exit(main())
