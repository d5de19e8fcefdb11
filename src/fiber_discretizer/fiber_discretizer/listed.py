# SPDX-License-Identifier: Apache-2.0
"""Orders of motors with listed speeds: the segments that a trajectory is made of, as they are."""

import numba as nb
import numpy as np

from fiber_core.array_types import Codes, Counts, Floats, Ints
from fiber_core.drive import Breaches, MotorRule, rules_broken
from fiber_core.focal_plane import FocalPlane
from fiber_core.motion import SampledMotion
from fiber_core.outcomes import Reason
from fiber_core.wire_units import WireMotion, WireUnits
from fiber_discretizer.options import DiscretizeOptions
from fiber_discretizer.validate import peak_speeds

__all__ = ["discretize_listed"]

_WHOLE = 1e-3  # of a tick or quantum: what times and angles may be off a whole number


def discretize_listed(
    plane: FocalPlane,
    trajectory: SampledMotion,
    start: Counts,
    units: WireUnits,
    options: DiscretizeOptions,
    reason: Codes,
) -> tuple[WireMotion, Codes, Breaches]:
    """Return a trajectory as segments without changing it.

    Motors with listed speeds cannot follow a fitted line, so a robot whose profile is not made of
    whole ticks at speeds of its motors rests.

    Args:
        plane: the focal plane; its motors have a list of speeds.
        trajectory: joint profiles of all its robots.
        start: encoder counts at the start [quanta], shape (n, 2).
        units: size of tick and quantum, and the widths of the fields.
        options: for max_segments.
        reason: Reason of each robot, shape (n,); those with another one than OK rest.

    Returns:
        The orders; the Reason of each robot: BAD_TRAJECTORY where the motors cannot carry out
        the profile, TOO_MANY_SEGMENTS where an order cannot; and the rules that are broken, with
        the values.
    """
    reason = reason.copy()
    ticks = trajectory.time_s / units.tick_s
    whole_ticks = np.rint(ticks).astype(np.int64)
    most = options.max_segments + 1
    counts, lasts, velocity = _segments(
        whole_ticks, trajectory.angles, start, units.quantum_rad, units.max_ticks, most
    )
    if (np.abs(ticks - whole_ticks) > _WHOLE).any():
        counts[:] = np.where(np.ptp(trajectory.angles, axis=2) > 0.0, -1, 0)
    bad = (counts < 0).any(axis=1)
    long = ~bad & (counts > options.max_segments).any(axis=1)
    reason[bad & (reason == Reason.OK)] = Reason.BAD_TRAJECTORY
    reason[long & (reason == Reason.OK)] = Reason.TOO_MANY_SEGMENTS
    kept = np.where((reason == Reason.OK)[:, None], counts, 0).ravel()
    used = np.arange(most) < kept[:, None]
    offsets = np.concatenate([[0], np.cumsum(kept)])
    wire = WireMotion(units, start, offsets, lasts[used], velocity[used])
    breaches = rules_broken(plane.drive, wire.decoded())
    broken = breaches.robots(plane.n)
    reason[broken] = Reason.BAD_TRAJECTORY
    breaches = Breaches.joined([_not_whole(trajectory, counts), breaches])
    return wire.without(broken), reason, breaches


def _not_whole(trajectory: SampledMotion, counts: Ints) -> Breaches:
    # each joint whose profile is not made of whole units, and how fast it is to turn
    speed = peak_speeds(trajectory)
    return Breaches.of(MotorRule.WHOLE_UNITS, counts < 0, speed, np.nan, np.nan)


@nb.njit(cache=True)
def _segments(
    ticks: Ints, angles: Floats, start: Counts, quantum: float, longest: int, most: int
) -> tuple[Ints, Ints, Ints]:
    # The number of segments of each profile, shape (n, 2), -1 where it is not made of whole units,
    # and at most `most`; their ticks and velocities, shape (2 n, most).
    n = len(angles)
    counts = np.zeros((n, 2), dtype=np.int64)
    lasts = np.zeros((2 * n, most), dtype=np.int64)
    velocity = np.zeros((2 * n, most), dtype=np.int64)
    for i in range(n):
        for joint in range(2):
            row, used, at, rest = 2 * i + joint, 0, start[i, joint], 0
            for k in range(1, len(ticks)):
                exact = angles[i, joint, k] / quantum
                now = np.int64(np.rint(exact))
                passed = ticks[k] - ticks[k - 1]
                if abs(exact - now) > _WHOLE or passed <= 0 or (now - at) % passed != 0:
                    used = -1
                    break
                speed, at = (now - at) // passed, now
                if speed == 0:
                    rest += passed  # the rest at the end is no segment
                    continue
                while rest > 0 and used < most:
                    lasts[row, used] = min(rest, longest)
                    rest -= lasts[row, used]
                    used += 1
                if used > 0 and velocity[row, used - 1] == speed:
                    more = min(passed, longest - lasts[row, used - 1])
                    lasts[row, used - 1] += more
                    passed -= more
                while passed > 0 and used < most:
                    lasts[row, used], velocity[row, used] = min(passed, longest), speed
                    passed -= lasts[row, used]
                    used += 1
                if used == most:
                    break
            counts[i, joint] = used
    return counts, lasts, velocity
