"""What the certificate misses in a draft; only robots that changed are looked at again."""

from dataclasses import replace

import numpy as np

from fiber_core.clearance import gaps, profiles_of, smallest_gaps, unproven
from fiber_core.focal_plane import FocalPlane
from fiber_planner.direct.parameters import DirectParameters
from fiber_planner.direct.pieces import pieces_of
from fiber_planner.direct.plan_state import Draft
from fiber_planner.direct.scene import Scene
from fiber_planner.direct.time_grid import TimeGrid

__all__ = ["missing_mm"]

_MEASURED_MM = 1e-3  # how closely the certificate resolves a gap, and a little more


def missing_mm(
    plane: FocalPlane,
    crowd: Scene,
    parameters: DirectParameters,
    draft: Draft,
    grid: TimeGrid,
    tangled: np.ndarray,
) -> np.ndarray:
    """Return by how much the gap of each pair falls short of what the certificate asks [mm], (p,).

    Half of the allowance is asked for as well where the pair starts and ends with as much:
    the search may overlook a graze, and rounding needs it. Pairs that start too close are
    asked for all of their gap once they had time to get apart.

    Args:
        plane: the focal plane.
        crowd: the same as the search sees it.
        parameters: what to keep apart.
        draft: the plan; robots are marked as unchanged unless one of their pairs falls short.
        grid: its instants.
        tangled: pairs that start closer than they should be, shape (p,).
    """
    a, b = crowd.pairs.T
    missing = np.zeros(len(crowd.pairs))
    which = (draft.changed[a] | draft.changed[b]) & (crowd.movable[a] | crowd.movable[b])
    missing[which] = _missing(plane, crowd, parameters, draft, grid, which, 0)
    if tangled.any():
        apart = draft.release[tangled].max()
        later = _missing(plane, crowd, parameters, draft, grid, tangled, apart)
        missing[tangled] = np.maximum(missing[tangled], later)
    draft.changed[:] = False
    draft.changed[crowd.pairs[missing > 0.0]] = True
    return missing


def _missing(plane, crowd, parameters, draft, grid, which, first):
    # of the pairs in question, from a grid time on
    pairs, safety = crowd.pairs[which], parameters.safety
    seen = np.zeros(len(draft.q), dtype=bool)
    seen[pairs] = True
    pieces = pieces_of(grid.time_s[first:], draft.q[: plane.n, :, first:], seen)
    profiles = profiles_of(pieces)
    start, fastest = pieces.start, profiles.fastest
    lasts_s = grid.time_s[-1] - grid.time_s[first]  # of the motion of all, not of these alone
    more = replace(safety, margin_mm=safety.margin_mm + 0.5 * parameters.allowance_mm)
    required = more.required_from(plane, start, fastest, lasts_s, pairs)
    doubtful = np.flatnonzero(unproven(crowd.bodies, profiles, pairs, required))
    missing = np.zeros(len(pairs))
    if len(doubtful):
        pairs, required = pairs[doubtful], required[doubtful]
        at_ends = np.minimum(gaps(plane, pairs, start), gaps(plane, pairs, pieces.end))
        wanted = np.minimum(required, at_ends - _MEASURED_MM)
        least = safety.required_from(plane, start, fastest, lasts_s, pairs)
        gap = smallest_gaps(crowd.bodies, profiles, pairs, required)
        missing[doubtful] = np.maximum(np.maximum(wanted, least) - gap, 0.0)
    return missing
