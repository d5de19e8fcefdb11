#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Calibrate robots from a history of random or chosen points, and print one JSON line.

The robots have other centres, arms and zeros than the plane says, gears with scales by direction
and backlash, some linear, stuck and slipping ones, and a camera with its errors. Errors are those
of sound robots, rms; cpu_s is processor time of the fit alone.
"""

import argparse
import json
import sys
import time
from dataclasses import replace

import numpy as np

from fiber_bus_bridge.simulation import (
    MechanicalErrors,
    arms_at,
    arms_motion,
    draw_mechanics,
    true_angles,
)
from fiber_core import kinematics
from fiber_core.focal_plane import FocalPlane
from fiber_core.motion import SegmentMotion
from fiber_core.presets import preset
from fiber_metrology import GearVerdict, calibrate, calibration_points


def main() -> int:
    """Run it; return the exit code."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--preset", default="desi")
    parser.add_argument("--robots", type=int)
    parser.add_argument("--points", type=int, default=20)
    parser.add_argument("--chosen", action="store_true", help="points chosen for the zeros")
    parser.add_argument("--error-um", type=float, default=2.5, help="of a coordinate of a place")
    parser.add_argument("--wave-deg", type=float, default=0.0, help="non-linearity of the drives")
    parser.add_argument("--seed", type=int, default=0)
    print(json.dumps(run(parser.parse_args())))
    return 0


def run(options: argparse.Namespace) -> dict[str, float]:
    """Return the figures of one calibration."""
    plane, rng = preset(options.preset, options.robots), np.random.default_rng(options.seed)
    n, p = plane.n, options.points
    true = replace(
        plane,
        centers=plane.centers + rng.normal(0.0, 0.03, (n, 2)),
        arms=plane.arms + rng.normal(0.0, 0.03, (n, 2)),
    )
    zeros = np.deg2rad(rng.normal(0.0, 1.0, (n, 2)))
    errors = MechanicalErrors(
        scale=0.005, backlash_deg=0.3, wave_deg=options.wave_deg, stuck=0.01, slipping=0.01
    )
    drawn = draw_mechanics(n, errors, rng)
    linear = rng.random(n) < 0.1
    scale = drawn.scale.copy()
    scale[linear, 1] *= rng.uniform(0.63, 0.85, (int(linear.sum()), 1))
    drawn = drawn.with_(scale=scale)
    counters = _points(plane, p, rng, options)
    state = arms_at(drawn, counters[0] + zeros)
    places = np.empty((p, n, 2))
    for k in range(p):
        way = (counters[k + 1] - counters[k]).ravel()
        motion = SegmentMotion(
            counters[k], np.arange(2 * n + 1), np.maximum(np.abs(way), 1e-12), np.sign(way)
        )
        _, state = arms_motion(drawn, state, motion)
        places[k] = kinematics.forward(true, true_angles(drawn, state))[1]
    places += rng.normal(0.0, options.error_um * 1e-3, places.shape)
    calibrate(plane, counters[:, :1].repeat(n, 1), places * np.nan)  # compiles
    begin = time.process_time()
    found = calibrate(plane, counters, places, options.error_um)
    cpu_s = time.process_time() - begin
    sound = ~((drawn.stuck_from == 0) | (drawn.slip > 0.0)).any(axis=1)
    # the zero is that of the middle of the backlash
    zero = zeros + drawn.slack_rad - drawn.backlash_rad / 2
    verdict = found.verdict
    told = {
        "good": int(((verdict == GearVerdict.GOOD) & sound & ~linear).sum()),
        "linear": int(((verdict == GearVerdict.LINEAR) & sound & linear).sum()),
        "stuck": int(((verdict == GearVerdict.STUCK) & (drawn.stuck_from == 0).any(axis=1)).sum()),
        "slipping": int(((verdict == GearVerdict.SLIPPING) & (drawn.slip > 0.0).any(axis=1)).sum()),
    }
    return {
        "robots": n,
        "points": p,
        "cpu_s": round(cpu_s, 3),
        "arms_um": _rms(1e3 * (found.arms - true.arms)[sound]),
        "centres_um": _rms(1e3 * (found.centers - true.centers)[sound]),
        # what no unbiased fit can fall below with these points (Cramer and Rao)
        "zeros_bound_deg": _rms(np.rad2deg(found.errors[:, [4, 8]])[sound]),
        "zeros_deg": _rms(np.rad2deg(found.zeros - zero)[sound]),
        "scales_percent": _rms(100.0 * (found.scale - drawn.scale)[sound]),
        "backlash_deg": _rms(np.rad2deg(found.backlash_rad - drawn.backlash_rad)[sound]),
        "residual_um": _rms(found.rms_um[sound]),
        "sound": int(sound.sum()),
        "linear_robots": int((linear & sound).sum()),
        "stuck_robots": int((drawn.stuck_from == 0).any(axis=1).sum()),
        "slipping_robots": int((drawn.slip > 0.0).any(axis=1).sum()),
        **{f"told_{name}": count for name, count in told.items()},
    }


def _points(
    plane: FocalPlane, points: int, rng: np.random.Generator, options: argparse.Namespace
) -> np.ndarray:
    if options.chosen:
        return calibration_points(plane, points, rng, options.error_um)
    low, high = np.moveaxis(plane.limits, -1, 0)
    return low + (high - low) * rng.uniform(0.02, 0.98, (points + 1, plane.n, 2))


def _rms(values: np.ndarray) -> float:
    return round(float(np.sqrt(np.mean(values**2))), 4)


if __name__ == "__main__":
    sys.exit(main())
