# SPDX-License-Identifier: Apache-2.0
"""Certificate of a plan during the search; only robots that changed are certified again."""

from dataclasses import replace

import numpy as np

from fiber_core.array_types import Bools, Floats
from fiber_core.clearance import gaps, smallest_gaps, unproven
from fiber_core.drive import carried_out
from fiber_core.focal_plane import FocalPlane
from fiber_planner.direct.parameters import DirectParameters
from fiber_planner.direct.pieces import pieces_of
from fiber_planner.direct.plan_state import PlanState
from fiber_planner.direct.scene import Scene, allowances_mm
from fiber_planner.direct.time_grid import TimeGrid

__all__ = ["MORE_MM", "require_more", "shortfall_mm"]

MORE_MM = 0.005  # added to a gap that the certificate finds missing
_EPS_MM = 1e-6  # far above the rounding of a gap
_MEASURED_MM = 1e-3  # resolution of a gap in the certificate, and a little more


def shortfall_mm(
    plane: FocalPlane,
    scene: Scene,
    parameters: DirectParameters,
    plan: PlanState,
    grid: TimeGrid,
    tangled: Bools,
    at_most: Bools,
) -> Floats:
    """Return by how much the gap of each pair falls short of the certificate's demand [mm], (p,).

    A pair that starts and ends with as much is required to keep half of the allowance too: the
    search may miss a graze, and rounding uses some. Pairs that start too close are required to
    keep the whole gap after the time in which they part. Motors with a ramp turn joints along true
    curves.

    Args:
        plane: the focal plane.
        scene: the same robots as the search sees them.
        parameters: clearance to keep.
        plan: the plan; robots are marked as unchanged unless one of their pairs falls short.
        grid: its instants.
        tangled: pairs that start too close, shape (p,).
        at_most: pairs that cannot be required to keep more, from require_more: to them half of the
            allowance is not granted, shape (p,).
    """
    a, b = scene.pairs.T
    shortfall = np.zeros(len(scene.pairs))
    which = (plan.changed[a] | plan.changed[b]) & (scene.movable[a] | scene.movable[b])
    shortfall[which] = _shortfall(plane, scene, parameters, plan, grid, which, at_most, 0)
    if tangled.any():
        parted = int(plan.release[tangled].max())
        later = _shortfall(plane, scene, parameters, plan, grid, tangled, at_most, parted)
        shortfall[tangled] = np.maximum(shortfall[tangled], later)
    plan.changed[:] = False
    plan.changed[scene.pairs[shortfall > 0.0]] = True
    return shortfall


def require_more(
    plane: FocalPlane, scene: Scene, plan: PlanState, missing: Floats, at_most: Bools
) -> None:
    """Require of pairs the gap that they were found to miss, and a little more.

    Of a robot beside a body that does not move, no more than the gap with which it starts: no
    motion has that, and the requirement would stay a conflict for ever.

    Args:
        plane: the focal plane.
        scene: the same robots as the search sees them.
        plan: the plan; the gaps required are written.
        missing: from shortfall_mm [mm], shape (p,).
        at_most: pairs that cannot be required to keep more; written, shape (p,).
    """
    short = np.flatnonzero(missing > 0.0)
    pairs, required = scene.pairs[short], plan.required[short]
    more = required + missing[short] + MORE_MM
    most = np.full(len(short), np.inf)
    static = ~scene.movable[pairs].all(axis=1) & (plan.release[short] == 0)
    at_start = gaps(plane, pairs[static], scene.start)
    most[static] = np.maximum(required[static], at_start - _EPS_MM)
    at_most[short] |= more > most
    plan.required[short] = np.minimum(more, most)


def _shortfall(
    plane: FocalPlane,
    scene: Scene,
    parameters: DirectParameters,
    plan: PlanState,
    grid: TimeGrid,
    which: Bools,
    at_most: Bools,
    first: int,
) -> Floats:
    # of the pairs in `which`, from the grid time `first` on
    pairs, safety = scene.pairs[which], parameters.safety
    involved = np.zeros(len(plan.q), dtype=bool)
    involved[pairs] = True
    motion = pieces_of(grid.time_s[first:], plan.q[: plane.n, :, first:], involved)
    if first == 0 and scene.ramp_s > 0.0:
        motion = carried_out(plane.drive, motion)
    start, fastest = motion.start, motion.fastest
    # the motion of all robots, not of these alone
    lasts_s = grid.time_s[-1] - grid.time_s[first] + scene.ramp_s
    more = replace(safety, margin_mm=safety.margin_mm + 0.5 * parameters.allowance_mm)
    required = more.required_from(plane, start, fastest, lasts_s, pairs)
    static = ~scene.movable[pairs].all(axis=1)  # no speed counts there
    with_allowance = safety.margin_mm + 0.5 * allowances_mm(scene, parameters)[which]
    required[static] = np.minimum(required, with_allowance)[static]
    doubtful = np.flatnonzero(unproven(scene.bodies, motion, pairs, required))
    shortfall = np.zeros(len(pairs))
    if len(doubtful):
        pairs, required = pairs[doubtful], required[doubtful]
        enough = at_most[which][doubtful]
        at_ends = np.minimum(gaps(plane, pairs, start), gaps(plane, pairs, motion.end))
        wanted = np.where(enough, 0.0, np.minimum(required, at_ends - _MEASURED_MM))
        least = safety.required_from(plane, start, fastest, lasts_s, pairs)
        gap = smallest_gaps(scene.bodies, motion, pairs, required)
        shortfall[doubtful] = np.maximum(np.maximum(wanted, least) - gap, 0.0)
    return shortfall
