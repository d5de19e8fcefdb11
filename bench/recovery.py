#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Recover a plane whose robots are all at unknown places, and print one JSON line.

Images before and after a small turn of all robots tell which light is of which robot; then a first
plan is certified with what is known. Robots that are not found, their neighbours, and robots
of which another turn of theta is in range stay. Drives, dark fibres and camera are simulated.

- found, wrong: robots told as certain, and those of which that is not true; lit: fibres with light;
  visible: fibres that both images show, in one exposure or more.
- outside: robots found with another elbow, or whose true angles are not in their intervals.
- turn_unknown: robots found of which another turn of theta is in range; turn_wrong: robots told
  with another turn than the true one.
- closest_um: smallest gap of the true outlines in the test turn, as certified.
- planned, held: robots with a target that the first plan moves, or holds; resting: robots that have
  none, for the causes above. Robots that are not found may be anywhere: what can reach them rests.
- contacts: pairs of true arms that touch in the first plan, which is certified without them.
- simulated_s: the turn and the first move with what the buses take, without exposures: for the turn
  they take what they take for the move.
"""

import argparse
import json
import sys
import time
from dataclasses import replace

import numpy as np

from fiber_bus_bridge.simulation import (
    ArmState,
    MechanicalErrors,
    Mechanics,
    arms_at,
    arms_motion,
    draw_mechanics,
    true_angles,
)
from fiber_core import kinematics
from fiber_core.arm_bounds import both_elbows, grown
from fiber_core.clearance import Certificate, Safety, certify_arms, neighbour_pairs
from fiber_core.drive.curves import CurveMotion
from fiber_core.fields import random_field
from fiber_core.focal_plane import FocalPlane
from fiber_core.motion import SegmentMotion
from fiber_core.outcomes import Reason
from fiber_core.presets import preset
from fiber_core.problem import Problem
from fiber_metrology import Recovered, RecoveryConfig, combine, recover, turn_within_margin
from fiber_metrology.camera import CameraConfig, SimulatedCamera, fiducial_places
from fiber_positioners.orders import make_orders
from fiber_positioners.simulated_run import run_on_simulated_buses

_DARK = 0.02
_DRIVE = {"scale": 0.0041, "backlash_deg": 0.08, "wave_deg": 0.12}
_SPEED = 0.2  # of the joints in a test turn, as a share of their limits


def main() -> int:
    """Run it; return 1 if a robot or its turn was told wrongly, or true arms touch."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--preset", default="desi")
    parser.add_argument("--robots", type=int)
    parser.add_argument("--exposures", type=int, default=9)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--no-plan", action="store_true", help="find the robots, and plan nothing")
    found = run(parser.parse_args())
    print(json.dumps(found))
    wrong = ("wrong", "outside", "turn_wrong", "contacts")
    return int(any(found.get(each) for each in wrong))


def run(options: argparse.Namespace) -> dict[str, object]:
    """Return the figures of one recovery."""
    plane, rng = preset(options.preset, options.robots), np.random.default_rng(options.seed)
    n, config = plane.n, RecoveryConfig()
    start = random_field(plane, rng).problem.start
    mechanics = draw_mechanics(n, MechanicalErrors(**_DRIVE), rng)
    fiducials = fiducial_places(plane)
    radius_mm = float(np.hypot(*plane.centers.T).max() + plane.arms.sum(axis=1).max())
    camera = SimulatedCamera(radius_mm, CameraConfig(), rng)
    lit = rng.random(n) >= _DARK
    half = turn_within_margin(plane, config)
    # robots with both elbows in range turn from one end of what neighbours allow to the other
    back = np.where(both_elbows(plane)[:, None], half, 0.0)
    counters = np.array(start) - back
    state, turned = arms_at(mechanics, counters), half + back
    way = turned
    lasts = np.maximum(np.abs(way) / (_SPEED * plane.speeds), 1e-9)
    motion = SegmentMotion(counters, np.arange(2 * n + 1), lasts.ravel(), (way / lasts).ravel())
    lights, exposures, closest_um = [], [], np.inf
    for image in range(2):
        if image:
            arms, state = arms_motion(mechanics, state, motion)
            closest_um = 1e3 * _touch(plane, arms).min_gap_mm
        tips = kinematics.forward(plane, true_angles(mechanics, state))[1]
        shots = [camera.expose(tips, fiducials, lit, rng) for _ in range(options.exposures)]
        lights.append(combine([each.spots for each in shots], fiducials, camera.calibrated))
        exposures.append(shots)
    recover(plane, lights[0], lights[1], turned, config)  # compiles
    begin = time.process_time()
    found = recover(plane, lights[0], lights[1], turned, config)
    cpu_s = time.process_time() - begin
    rows = np.flatnonzero(found.certain)
    first = lights[-1].first[found.light[rows]]
    owner = np.array([exposures[-1][k].owner[spot] for spot, k in first], dtype=np.int64)
    visible = np.ones(n, dtype=bool)
    for shots in exposures:
        visible &= np.isin(np.arange(n), np.concatenate([e.owner for e in shots]))
    true = true_angles(mechanics, state)
    off = np.abs((found.angles - true + np.pi) % (2 * np.pi) - np.pi)
    outside = found.certain & (off > found.interval_rad + 1e-9).any(axis=1)
    about = {
        "preset": options.preset, "robots": n, "seed": options.seed, "exposures": options.exposures,
        "lit": int(lit.sum()), "visible": int(visible.sum()),
        "found": len(rows), "wrong": int((owner != rows).sum()), "outside": int(outside.sum()),
        "turn_unknown": int((found.certain & ~found.turn_known).sum()),
        "turn_wrong": int((found.turn_known & (np.abs(found.angles - true) > np.pi)[:, 0]).sum()),
        "closest_um": round(float(closest_um), 1), "recover_cpu_s": round(cpu_s, 3),
    }  # fmt: skip
    if options.no_plan:
        return about
    return about | _first_plan(plane, found, (mechanics, state), rng, float(lasts.max()))


def _touch(plane: FocalPlane, arms: SegmentMotion | CurveMotion) -> Certificate:
    return certify_arms(plane, arms, Safety(*np.zeros(6)), neighbour_pairs(plane))


def _first_plan(
    plane: FocalPlane,
    found: Recovered,
    true: tuple[Mechanics, ArmState],
    rng: np.random.Generator,
    turn_s: float,
) -> dict[str, object]:
    """Plan from what is known, let the true arms follow, and return what came of it."""
    known = found.certain
    pairs = neighbour_pairs(plane)
    pairs = pairs[(pairs < plane.n).all(axis=1)]
    beside = np.zeros(plane.n, dtype=bool)
    for one, other in (pairs.T, pairs.T[::-1]):
        beside[one[~known[other]]] = True
    moves = known & found.turn_known & ~beside & plane.enabled
    # a robot that is not known is drawn anywhere: its neighbours rest wherever it is
    angles = np.where(known[:, None], found.angles, plane.limits.mean(axis=2))
    half = np.where(known[:, None], found.interval_rad, 0.0)
    wider = replace(grown(plane, half, np.nan_to_num(found.error_mm)), enabled=moves)
    targets = random_field(wider, rng, start=angles).problem.targets
    begin = time.process_time()
    orders = make_orders(Problem(wider, angles, targets))
    plan_cpu_s = time.process_time() - begin
    run = run_on_simulated_buses(orders, observe=True)
    assert run.counters is not None  # it was observed
    arms, _ = arms_motion(*true, *run.counters)
    asked = np.isfinite(targets).all(axis=1)
    buses_s = run.costs["bus_time_s"] + run.costs["countdown_s"]
    return {
        "planned": int((asked & (orders.reason == Reason.OK)).sum()),
        "held": int((asked & (orders.reason != Reason.OK)).sum()),
        "resting": int((~moves).sum()),
        "contacts": int(_touch(plane, arms).unsafe.sum()),
        "plan_cpu_s": round(plan_cpu_s, 2),
        "simulated_s": round(2 * buses_s + turn_s + run.motion.makespan_s, 2),
    }


if __name__ == "__main__":
    sys.exit(main())
