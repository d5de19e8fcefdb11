#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Identify the fibres of many images, and print one JSON line.

Robots go from one random field to another with drive errors (54 um rms), as if nothing was in
their way: the images are those of `closed_loop.py` without its plans. Counted over all images:

- visible: fibres in one exposure or more; identified: told as certain; misidentified: wrongly so.
- merged: fibres that are known to be in a light, without a place.
- worst_um: the largest error of a measured place.
- non_movers: robots that most exposures show with a joint that stuck, which was told to move the
  fibre farther than a verdict needs: 0.3 mm, and 12 sigma of the drive for this move. of_ambiguous:
  those of them whose light is not surely theirs; another image tells. too_near: robots with a joint
  that stuck, and was told less than that; near_seen: those of them whose place is told.
- measure_cpu_s: median processor time from the spots to measured angles.

The images come in blocks of 20, each of a field of its own. With --journal each block is a line of
that file as soon as it is done, and a run that is begun again goes on after the last one.
"""

import argparse
import json
import sys
import time
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np
from closed_loop import DRIVE, told_mm

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
from fiber_metrology import DriveErrors, Expected, MeasureConfig, Verdict, measure
from fiber_metrology.camera import CameraConfig, SimulatedCamera, fiducial_places

_BLOCK = 20  # images of each pair of fields
_NAMES = (
    *("visible", "identified", "misidentified", "merged", "ambiguous", "non_movers"),
    *("non_movers_named", "of_ambiguous", "too_near", "near_seen", "healthy_blamed"),
)
_DARK, _NON_MOVERS = 0.02, 0.01


def main() -> int:
    """Run the campaign; return 1 if a fibre was told wrongly or a healthy robot was blamed."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--preset", default="desi")
    parser.add_argument("--robots", type=int)
    parser.add_argument("--images", type=int, default=200)
    parser.add_argument("--exposures", type=int, default=3)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--journal", type=Path, help="file of the blocks that are done")
    found = campaign(parser.parse_args())
    print(json.dumps(found))
    return int(found["misidentified"] > 0 or found["healthy_blamed"] > 0)


def campaign(options: argparse.Namespace) -> dict[str, float]:
    """Return the counts over all images."""
    plane = preset(options.preset, options.robots)
    about = {"robots": plane.n, "exposures": options.exposures, "seed": options.seed}
    done = _journal(options.journal, about)
    for number in range(-(-options.images // _BLOCK)):
        images = min(_BLOCK, options.images - number * _BLOCK)
        if done.get(number, {}).get("images") == images:
            continue
        done[number] = about | {"block": number} | _block(plane, images, options, number)
        if options.journal is not None:
            with open(options.journal, "a", encoding="utf-8") as file:
                file.write(json.dumps(done[number]) + "\n")
    lines = [done[number] for number in range(-(-options.images // _BLOCK))]
    total = {name: sum(int(line[name]) for line in lines) for name in ("images", *_NAMES)}
    return {
        **about, **total,
        "identified_share": round(total["identified"] / max(total["visible"], 1), 6),
        "worst_um": max(line["worst_um"] for line in lines),
        "measure_cpu_s": round(median(line["measure_cpu_s"] for line in lines), 3),
    }  # fmt: skip


def _journal(path: Path | None, about: dict[str, Any]) -> dict[int, dict[str, Any]]:
    """The blocks that an earlier run with the same settings has done."""
    if path is None or not path.exists():
        return {}
    lines = [line for line in path.read_text(encoding="utf-8").splitlines() if line.endswith("}")]
    blocks = [json.loads(line) for line in lines]
    return {each["block"]: each for each in blocks if about.items() <= each.items()}


def _block(
    plane: FocalPlane, images: int, options: argparse.Namespace, number: int
) -> dict[str, float]:
    rng = np.random.default_rng([options.seed, number])
    fiducials = fiducial_places(plane)
    radius_mm = float(np.hypot(*plane.centers.T).max() + plane.arms.sum(axis=1).max())
    camera = SimulatedCamera(radius_mm, CameraConfig(), rng)
    field = random_field(plane, rng)
    start, goal = field.problem.start, field.goal
    total, cpu_s, worst_mm = dict.fromkeys(_NAMES, 0), [], 0.0
    for _ in range(images):
        arms, stuck = _after_a_move(plane, start, goal, rng)
        sticks = stuck.any(axis=1)
        tips = kinematics.forward(plane, arms)[1]
        lit = rng.random(plane.n) >= _DARK
        taken = [camera.expose(tips, fiducials, lit, rng) for _ in range(options.exposures)]
        error_um = DriveErrors().after_um(plane, start, goal)
        expected = Expected(
            plane, goal, start, np.full((plane.n, 2), 3e-3), error_um,
            joints_rad=DriveErrors().joints_rad(plane, start, goal),
        )  # fmt: skip
        begin = time.process_time()
        image = measure(expected, [e.spots for e in taken], fiducials, camera.calibrated)
        cpu_s.append(time.process_time() - begin)
        rows = np.flatnonzero(image.certain)
        first = image.lights.first[image.light[rows]]
        owner = np.array([taken[k].owner[spot] for spot, k in first], dtype=np.int64)
        visible = np.isin(np.arange(plane.n), np.concatenate([e.owner for e in taken]))
        times = sum(np.isin(np.arange(plane.n), e.owner).astype(int) for e in taken)
        shown = sticks & (2 * times >= options.exposures)
        far = told_mm(plane, start, goal, stuck) > MeasureConfig().judged_mm(error_um)
        judged, near = shown & far, shown & ~far
        worst_mm = max(worst_mm, float(np.hypot(*(image.places - tips)[rows].T).max()))
        masks = (
            visible, image.certain & visible, owner != rows, image.verdict == Verdict.MERGED,
            image.verdict == Verdict.AMBIGUOUS, judged, judged & image.not_moved,
            judged & (image.verdict == Verdict.AMBIGUOUS), near, near & image.certain,
            image.not_moved & ~sticks,
        )  # fmt: skip
        for name, mask in zip(_NAMES, masks):
            total[name] += int(mask.sum())
    took_s = round(median(cpu_s), 4)
    return {
        **total, "images": images, "worst_um": round(1e3 * worst_mm, 1), "measure_cpu_s": took_s
    }  # fmt: skip


def _after_a_move(
    plane: FocalPlane, start: Angles, goal: Angles, rng: np.random.Generator
) -> tuple[Angles, np.ndarray]:
    """Angles of the true arms after a straight move, and the joints that stuck, shape (n, 2)."""
    mechanics = draw_mechanics(plane.n, MechanicalErrors(**DRIVE, non_movers=_NON_MOVERS), rng)
    way = (goal - start).ravel()
    speed = np.where(way >= 0.0, 1.0, -1.0)
    lasts = np.maximum(np.abs(way), 1e-12)
    motion = SegmentMotion(start, np.arange(2 * plane.n + 1), lasts, speed)
    _, state = arms_motion(mechanics, arms_at(mechanics, start), motion)
    return true_angles(mechanics, state), mechanics.still_in < NEVER


if __name__ == "__main__":
    sys.exit(main())
