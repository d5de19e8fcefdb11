#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Tell swapped and lost robots by code words, over many planes, and print one JSON line.

In each image phi of every robot is turned up or down by its code word, within half of the margin.
Drives, dark fibres, joints that do not turn, and camera are simulated; nothing is known of where
the robots stand.

- told, wrong: robots of which it is told which fibre their orders move, and those of which that is
  not true; tellable: robots whose orders move a lit fibre.
- swapped, swapped_told: robots at the place of another one, half of them of a neighbour;
  swapped_still: those of which the orders move no lit fibre.
- pairs_told: swapped pairs of which both are told.
- ambiguous, not_seen: robots that are told so; still: robots whose orders move no lit fibre.
"""

import argparse
import json
import sys
import time

import numpy as np

from fiber_bus_bridge.simulation import (
    MechanicalErrors,
    arms_at,
    arms_motion,
    draw_mechanics,
    true_angles,
)
from fiber_core import kinematics
from fiber_core.array_types import Ints, Mask
from fiber_core.clearance import neighbour_pairs
from fiber_core.fields import random_field
from fiber_core.focal_plane import FocalPlane
from fiber_core.motion import SegmentMotion
from fiber_core.presets import preset
from fiber_metrology import WiringConfig, WiringVerdict, code_words, combine, tell_wiring
from fiber_metrology.camera import CameraConfig, SimulatedCamera, fiducial_places

_DARK = 0.02
_DRIVE = MechanicalErrors(scale=0.0041, backlash_deg=0.08, wave_deg=0.12, stuck=0.01)


def main() -> int:
    """Run it; return 1 if a robot was told wrongly."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--preset", default="desi")
    parser.add_argument("--robots", type=int)
    parser.add_argument("--swaps", type=int, default=20, help="pairs of swapped robots")
    parser.add_argument("--images", type=int, default=32)
    parser.add_argument("--exposures", type=int, default=3)
    parser.add_argument("--planes", type=int, default=1)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    total: dict[str, float] = {}
    for seed in range(options.seed, options.seed + options.planes):
        for name, value in run(options, seed).items():
            total[name] = round(total.get(name, 0) + value, 3)
    print(json.dumps(vars(options) | total))
    return int(total["wrong"] > 0)


def run(options: argparse.Namespace, seed: int) -> dict[str, float]:
    """Return the figures of one plane."""
    plane, rng = preset(options.preset, options.robots), np.random.default_rng(seed)
    n, words = plane.n, code_words(plane, rng, options.images)
    moves = _swapped(plane, options.swaps, rng)
    mechanics = draw_mechanics(n, _DRIVE, rng)
    lit = rng.random(n) >= _DARK
    counters = np.array(random_field(plane, rng).problem.start)
    state = arms_at(mechanics, counters)
    fiducials = fiducial_places(plane)
    radius_mm = float(np.hypot(*plane.centers.T).max() + plane.arms.sum(axis=1).max())
    camera = SimulatedCamera(radius_mm, CameraConfig(), rng)
    images, at = [], counters
    for turned in words.turned_rad.T:
        end = np.array(counters)
        end[moves, 1] += turned
        way = (end - at).ravel()
        lasts = np.maximum(np.abs(way), 1e-9)
        motion = SegmentMotion(at, np.arange(2 * n + 1), lasts, way / lasts)
        _, state = arms_motion(mechanics, state, motion)
        at = end
        tips = kinematics.forward(plane, true_angles(mechanics, state))[1]
        shots = [camera.expose(tips, fiducials, lit, rng).spots for _ in range(options.exposures)]
        images.append(combine(shots, fiducials, camera.calibrated))
    config = WiringConfig(error_um=8.0 / np.sqrt(options.exposures))
    begin = time.process_time()
    found = tell_wiring(plane, words, images, config)
    cpu_s = time.process_time() - begin
    told = found.at >= 0
    moving = lit[moves] & ~(mechanics.stuck_from[moves, 1] == 0)
    swapped = moves != np.arange(n)
    both = told & swapped & told[moves]
    verdict = found.verdict
    return {
        "tellable": int(moving.sum()),
        "told": int(told.sum()),
        "wrong": int((told & (found.at != moves)).sum()),
        "swapped": int(swapped.sum()),
        "swapped_still": int((swapped & ~moving).sum()),
        "swapped_told": int((told & swapped).sum()),
        "pairs_told": int(both.sum()) // 2,
        "still": int((~moving).sum()),
        "not_seen": int((verdict == WiringVerdict.NOT_SEEN).sum()),
        "ambiguous": int((verdict == WiringVerdict.AMBIGUOUS).sum()),
        "ambiguous_still": int(((verdict == WiringVerdict.AMBIGUOUS) & ~moving).sum()),
        "cpu_s": cpu_s,
    }


def _swapped(plane: FocalPlane, swaps: int, rng: np.random.Generator) -> Ints:
    """Whose arm the orders for each robot move: half of the pairs are neighbours, half any two."""
    moves, free = np.arange(plane.n), np.ones(plane.n, dtype=bool)
    pairs = neighbour_pairs(plane)
    near = rng.permutation(pairs[(pairs < plane.n).all(axis=1)])
    far = rng.permutation(plane.n)[: plane.n // 2 * 2].reshape(-1, 2)
    _swap(moves, free, near, swaps // 2)
    _swap(moves, free, far, swaps - swaps // 2)
    return moves


def _swap(moves: Ints, free: Mask, pairs: Ints, number: int) -> None:
    for a, b in pairs:
        if number and free[a] and free[b]:
            moves[[a, b]] = b, a
            free[[a, b]] = False
            number -= 1


if __name__ == "__main__":
    sys.exit(main())
