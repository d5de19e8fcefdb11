# SPDX-License-Identifier: Apache-2.0
"""The judge of planes of sectors: what their robots really did, and the promises about it."""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from fiber_bus_bridge.simulation import Movements
from fiber_core.array_types import Bools, Counts, Floats, Ints, Rows
from fiber_core.clearance import Safety, certify_arms, neighbour_pairs
from fiber_core.focal_plane import FocalPlane
from fiber_core.wire_units import WireUnits

__all__ = ["Moved", "Start", "Verdict", "broken", "broken_off", "judge", "starts_of"]

_EXACT = Safety(0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
_EARLY_S = 20e-3  # by which a start may be early and is still that start; countdowns last longer


class Start(NamedTuple):
    """A start that the coordinator has told.

    Args:
        at_s: its instant, in the time of the robots [s].
        sectors: the sectors that take part.
        rows: the robots that are started: one of them that stands still is seen, also where others
            of its sector move.
    """

    at_s: float
    sectors: tuple[int, ...]
    rows: tuple[int, ...]


class Moved(NamedTuple):
    """The true movements of the robots of a sector.

    Args:
        rows: rows of its robots in the plane, shape (m,).
        start: encoders before the first movement [quanta], shape (m, 2).
        moves: the movements; their rows are those of the sector.
        verified: whether the order of each was loaded and read back, shape (r,).
        now_s: the present [s].
    """

    rows: Rows
    start: Counts
    moves: Movements
    verified: Bools
    now_s: float


class Verdict(NamedTuple):
    """What is judged.

    Args:
        contacts: pairs of robots that have touched.
        unverified: movements of orders that were not read back, or of no start.
        start_skew_ms: largest difference between two robots in one start [ms].
        stop_ms: largest time from the first robot that is broken off in a start, or stands still
            in it, until the last of that start rests [ms].
    """

    contacts: int
    unverified: int
    start_skew_ms: float
    stop_ms: float


def broken_off(moves: Movements, now_s: float) -> Bools:
    """Return the movements that ended before their orders did, shape (r,).

    Args:
        moves: the movements; what lies beyond their segments is of earlier orders.
        now_s: the present [s].
    """
    of_order = np.arange(moves.ticks.shape[2]) < moves.counts[:, :, None]
    lasts_s = (moves.ticks * of_order).sum(axis=2).max(axis=1) * moves.tick_s
    return np.minimum(moves.ended_s, now_s) < moves.started_s + lasts_s - 1e-4


def starts_of(started_s: Floats, told: Sequence[Start]) -> Ints:
    """Return the number of the start to which each movement belongs, -1 for none, shape (r,).

    It is the last one told before: a sector that is late is late in it, by any time.
    """
    told_s = np.array([each.at_s for each in told])
    return np.searchsorted(told_s - _EARLY_S, started_s, side="right") - 1


def judge(
    plane: FocalPlane, units: WireUnits, found: Sequence[Moved], told: Sequence[Start]
) -> Verdict:
    """Judge what all robots have done.

    Args:
        plane: the focal plane.
        units: quantum of the encoders.
        found: the movements of each sector.
        told: the starts of all coordinators, in order of time.
    """
    moves, verified = _merged(found)
    if len(moves.row) == 0:
        return Verdict(0, 0, 0.0, 0.0)
    start = np.zeros((plane.n, 2), dtype=np.int64)
    for each in found:
        start[each.rows] = each.start
    now_s = max(each.now_s for each in found)
    motion = moves.motion(start, units.quantum_rad, now_s, float(moves.started_s.min()) - 1e-3)
    certificate = certify_arms(plane, motion, _EXACT, neighbour_pairs(plane))
    of = starts_of(moves.started_s, told)
    ended_s = np.where(np.isnan(moves.ended_s), now_s, np.minimum(moves.ended_s, now_s))
    went = ended_s > moves.started_s  # else its countdown was ended, and it has not moved
    early, skew_s, stop_s = broken_off(moves, now_s), 0.0, 0.0
    for k in np.unique(of[of >= 0]):
        mine = (of == k) & went
        if not mine.any():
            continue  # no lease was given
        skew_s = max(skew_s, float(np.ptp(moves.started_s[mine])))
        still = set(told[k].rows) - set(moves.row[mine].tolist())
        stands_s = [*ended_s[mine & early], *([moves.started_s[mine].min()] * bool(still))]
        if stands_s:
            stop_s = max(stop_s, float(ended_s[mine].max() - min(stands_s)))
    untold = (of < 0) | ~verified
    contacts = int(certificate.unsafe.sum())
    return Verdict(contacts, int(untold.sum()), 1e3 * skew_s, 1e3 * stop_s)


def _merged(found: Sequence[Moved]) -> tuple[Movements, Bools]:
    # the movements of all sectors with the rows of the plane, in order of time
    most = max(each.moves.ticks.shape[2] for each in found)
    merged: dict[str, Any] = {}
    for name in Movements._fields:
        parts = [getattr(each.moves, name) for each in found]
        if name == "row":
            parts = [each.rows[part] for each, part in zip(found, parts)]
        elif parts[0].ndim == 3:
            parts = [np.pad(p, [(0, 0), (0, 0), (0, most - p.shape[2])]) for p in parts]
        merged[name] = np.concatenate(parts)
    order = np.argsort(merged["started_s"], kind="stable")
    verified = np.concatenate([each.verified for each in found])[order]
    return Movements(**{name: values[order] for name, values in merged.items()}), verified


def broken(line: Mapping[str, Any]) -> list[str]:
    """Return the promises that a line of results breaks."""
    found = [name for name in ("contacts", "unverified", "without_outcome") if line[name]]
    for name in ("start_skew", "stop"):
        if not line[f"{name}_ms_max"] <= line[f"{name}_bound_ms"]:
            found.append(name)
    return found
