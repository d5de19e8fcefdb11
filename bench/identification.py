#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Identify the fibres of many images, and print one JSON line.

Robots go from one random field to another with drive errors (54 um rms), as if nothing was in
their way: the images are those of `closed_loop.py` without its plans. Counted over all images:

- visible: fibres in one exposure or more; identified: told as certain; misidentified: wrongly so.
- merged: fibres that are known to be in a light, without a place.
- worst_um: the largest error of a measured place.
- non_movers: visible robots with a joint that stuck, 0.3 mm or more from where they should be.
- measure_cpu_s: median processor time from the spots to measured angles.
"""

import argparse
import json
import sys
import time
from statistics import median

import numpy as np
from closed_loop import DRIVE

from fiber_bus_bridge.simulation import (
    NEVER,
    MechanicalErrors,
    arms_at,
    arms_motion,
    draw_mechanics,
    true_angles,
)
from fiber_core import kinematics
from fiber_core.array_types import Angles
from fiber_core.fields import random_field
from fiber_core.focal_plane import FocalPlane
from fiber_core.motion import SegmentMotion
from fiber_core.presets import preset
from fiber_metrology import Expected, MeasureConfig, Verdict, measure
from fiber_metrology.camera import CameraConfig, SimulatedCamera, fiducial_places

_REDRAWN = 20  # images of each pair of fields
_DARK, _NON_MOVERS = 0.02, 0.01


def main() -> int:
    """Run the campaign; return 1 if a fibre was told wrongly or a healthy robot was blamed."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--preset", default="desi")
    parser.add_argument("--robots", type=int)
    parser.add_argument("--images", type=int, default=200)
    parser.add_argument("--exposures", type=int, default=3)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    found = campaign(
        preset(options.preset, options.robots), options.images, options.exposures, options.seed
    )
    print(json.dumps(found))
    return int(found["misidentified"] > 0 or found["healthy_blamed"] > 0)


def campaign(plane: FocalPlane, images: int, exposures: int, seed: int) -> dict[str, float]:
    """Return the counts over all images."""
    rng = np.random.default_rng(seed)
    fiducials = fiducial_places(plane)
    radius_mm = float(np.hypot(*plane.centers.T).max() + plane.arms.sum(axis=1).max())
    camera = SimulatedCamera(radius_mm, CameraConfig(), rng)
    names = "visible identified misidentified merged ambiguous non_movers non_movers_named"
    total = dict.fromkeys([*names.split(), "healthy_blamed"], 0)
    cpu_s, worst_mm = [], 0.0
    start = goal = np.zeros((plane.n, 2))
    for number in range(images):
        if number % _REDRAWN == 0:
            field = random_field(plane, rng)
            start, goal = field.problem.start, field.goal
        arms, sticks = _after_a_move(plane, start, goal, rng)
        tips = kinematics.forward(plane, arms)[1]
        lit = rng.random(plane.n) >= _DARK
        taken = [camera.expose(tips, fiducials, lit, rng) for _ in range(exposures)]
        expected = Expected(plane, goal, start, np.full((plane.n, 2), 3e-3), 40.0)
        begin = time.process_time()
        image = measure(expected, [e.spots for e in taken], fiducials, camera.calibrated)
        cpu_s.append(time.process_time() - begin)
        rows = np.flatnonzero(image.certain)
        first = image.lights.first[image.light[rows]]
        owner = np.array([taken[k].owner[spot] for spot, k in first], dtype=np.int64)
        visible = np.isin(np.arange(plane.n), np.concatenate([e.owner for e in taken]))
        away = np.hypot(*(tips - kinematics.forward(plane, goal)[1]).T)
        judged = sticks & visible & (away > 1.05e-3 * MeasureConfig().moved_um)
        worst_mm = max(worst_mm, float(np.hypot(*(image.places - tips)[rows].T).max()))
        for name, mask in (
            ("visible", visible),
            ("identified", image.certain & visible),
            ("misidentified", owner != rows),
            ("merged", image.verdict == Verdict.MERGED),
            ("ambiguous", image.verdict == Verdict.AMBIGUOUS),
            ("non_movers", judged),
            ("non_movers_named", judged & image.not_moved),
            ("healthy_blamed", image.not_moved & ~sticks),
        ):
            total[name] += int(mask.sum())
    about = {"images": images, "robots": plane.n, "exposures": exposures, "seed": seed}
    share = total["identified"] / max(total["visible"], 1)
    return {
        **about, **total, "identified_share": round(share, 6),
        "worst_um": round(1e3 * worst_mm, 1), "measure_cpu_s": round(median(cpu_s), 3),
    }  # fmt: skip


def _after_a_move(
    plane: FocalPlane, start: Angles, goal: Angles, rng: np.random.Generator
) -> tuple[Angles, np.ndarray]:
    """Angles of the true arms after a straight move, and the robots of which a joint stuck."""
    mechanics = draw_mechanics(plane.n, MechanicalErrors(**DRIVE, non_movers=_NON_MOVERS), rng)
    way = (goal - start).ravel()
    speed = np.where(way >= 0.0, 1.0, -1.0)
    lasts = np.maximum(np.abs(way), 1e-12)
    motion = SegmentMotion(start, np.arange(2 * plane.n + 1), lasts, speed)
    _, state = arms_motion(mechanics, arms_at(mechanics, start), motion)
    return true_angles(mechanics, state), np.any(mechanics.still_in < NEVER, axis=1)


if __name__ == "__main__":
    sys.exit(main())
