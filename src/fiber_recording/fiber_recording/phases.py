# SPDX-License-Identifier: Apache-2.0
"""The phases of a plan, and the motion that robots executed in them.

A phase is the part of a plan between a start and the next stop.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fiber_core.array_types import Counts, Ints, Mask
from fiber_core.motion import SegmentMotion
from fiber_core.ragged import Parts
from fiber_core.validation import frozen_array
from fiber_core.wire_units import WireMotion
from fiber_recording.errors import RecordingError

__all__ = ["SETTLING_S", "Phase", "counts_at", "executed_motion"]

_SAME_INSTANT_S = 1e-7  # instants this close to each other are the same
SETTLING_S = 1e-4  # time in which a robot moves from the cut of its orders to where it stopped


@dataclass(frozen=True, eq=False)
class Phase:
    """Orders that were started together, and how far each robot got with them.

    A plan without faults has one phase. After a stop, the orders for the remaining motion are
    the next phase.

    Args:
        motion: the orders as sent, from the encoders before them; robots that were not started
            have no segments.
        begin_us: time at which the robots began to move, from the begin of the first phase [us].
        stop_us: time at which a robot stopped before the end of its orders, from the begin of
            the first phase [us], shape (n,); -1 for a robot that did not.
        stop_counts: encoders of the stopped robots from then on [quanta], shape (n, 2).

    Raises:
        RecordingError: a shape does not fit; names the array.
    """

    motion: WireMotion
    begin_us: int
    stop_us: Ints
    stop_counts: Counts

    def __post_init__(self):
        n = len(self.motion.start)
        for name, shape in (("stop_us", (n,)), ("stop_counts", (n, 2))):
            value = frozen_array(getattr(self, name), np.int64, shape, name, RecordingError)
            object.__setattr__(self, name, value)

    @classmethod
    def whole(cls, motion: WireMotion, begin_us: int = 0) -> "Phase":
        """Return the phase in which all robots executed their orders to the end.

        Args:
            motion: the orders.
            begin_us: time at which the robots began to move, as in Phase [us].
        """
        return cls(motion, begin_us, np.full(len(motion.start), -1), np.zeros_like(motion.start))

    @property
    def stopped(self) -> Mask:
        """Robots that stopped before the end of their orders, shape (n,)."""
        return self.stop_us >= 0

    @property
    def end(self) -> Counts:
        """Encoders after the phase [quanta], shape (n, 2)."""
        return np.where(self.stopped[:, None], self.stop_counts, self.motion.end)

    def counts_at(self, row: ArrayLike, time_us: ArrayLike) -> Counts:
        """Return encoders of robots at some times [quanta], shape (m, 2).

        Args:
            row: rows of robots, shape (m,).
            time_us: a time for each, from the begin of the first phase [us], shape (m,).
        """
        row, time_us = np.asarray(row), np.asarray(time_us)
        counts = _ordered_counts(self.motion, row, time_us - self.begin_us)
        over = self.stopped[row] & (time_us >= self.stop_us[row])
        return np.where(over[:, None], self.stop_counts[row], counts)


def _ordered_counts(motion: WireMotion, row: Ints, time_us: Ints) -> Counts:
    """Encoders that orders lead to, some time after their begin; in whole numbers only."""
    profile = 2 * np.asarray(row, dtype=np.int64)[:, None] + [0, 1]
    left = np.repeat(np.maximum(np.asarray(time_us, dtype=np.int64), 0)[:, None], 2, axis=1)
    counts = motion.start.ravel()[profile]
    segment, last = motion.offsets[profile], motion.offsets[profile + 1]
    tick_us = motion.units.tick_us
    while (inside := segment < last).any():
        at = np.where(inside, segment, 0)
        spent = np.where(inside, np.minimum(left, motion.ticks[at] * tick_us), 0)
        counts = counts + np.where(inside, motion.velocity[at] * spent // tick_us, 0)
        left, segment = left - spent, segment + 1
    return counts


def counts_at(phases: Sequence[Phase], row: ArrayLike, time_us: ArrayLike) -> Counts:
    """Return encoders of robots at some times of a plan [quanta], shape (m, 2).

    Args:
        phases: the phases of the plan, in the order in which they began.
        row: rows of robots, shape (m,).
        time_us: a time for each, from the begin of the first phase [us], shape (m,).
    """
    counts = phases[0].counts_at(row, time_us)
    for phase in phases[1:]:
        later = np.asarray(time_us) >= phase.begin_us
        counts = np.where(later[:, None], phase.counts_at(row, time_us), counts)
    return counts


def executed_motion(phases: Sequence[Phase]) -> SegmentMotion:
    """Return the motion that robots executed in all phases, with the rests between them.

    The instant of a stop is known to a microsecond, the encoders after it exactly. So a stopped
    robot reaches the encoders of its stop 0.1 ms after it.

    Args:
        phases: the phases of a plan, in the order in which they began.
    """
    pieces = [_executed_pieces(phase) for phase in phases]
    for k, phase in enumerate(phases):
        until_s = 1e-6 * phases[k + 1].begin_us if k + 1 < len(phases) else np.inf
        pieces.append(_settling_pieces(phase, pieces[k], until_s))
    profile, begin_s, lasts_s, velocity = (np.concatenate(column) for column in zip(*pieces))
    order = np.lexsort([begin_s, profile])
    profile, begin_s, lasts_s, velocity = (
        column[order] for column in (profile, begin_s, lasts_s, velocity)
    )
    # a rest before each piece that begins after the end of the piece before it
    end_s = np.zeros(len(profile))
    follows = np.flatnonzero(profile[1:] == profile[:-1]) + 1
    end_s[follows] = (begin_s + lasts_s)[follows - 1]
    rests = np.flatnonzero(begin_s - end_s > _SAME_INSTANT_S)
    lasts_s = np.insert(lasts_s, rests, (begin_s - end_s)[rests])
    velocity = np.insert(velocity, rests, 0.0)
    profile = np.insert(profile, rests, profile[rests])
    start = phases[0].motion.decoded().start
    lengths = np.bincount(profile, minlength=start.size)
    return SegmentMotion(start, Parts.from_counts(lengths).offsets, lasts_s, velocity)


class _Pieces(NamedTuple):
    """Pieces of constant velocity of some profiles; 2 row is theta and 2 row + 1 is phi."""

    profile: Ints
    begin_s: NDArray[np.floating]
    lasts_s: NDArray[np.floating]
    velocity_rad_s: NDArray[np.floating]


def _executed_pieces(phase: Phase) -> _Pieces:
    """Return the segments of a phase, cut where robots stopped."""
    motion = phase.motion.decoded()
    profile = motion.parts.owner
    ends_s = np.cumsum(motion.duration_s)
    before = np.concatenate([[0.0], ends_s])[motion.offsets[:-1]]
    begin_s = ends_s - motion.duration_s - before[profile] + 1e-6 * phase.begin_us
    stop_s = np.where(phase.stopped, 1e-6 * phase.stop_us, np.inf)[profile // 2]
    lasts_s = np.minimum(motion.duration_s, stop_s - begin_s)
    kept = lasts_s > 0.0
    return _Pieces(profile[kept], begin_s[kept], lasts_s[kept], motion.velocity_rad_s[kept])


def _settling_pieces(phase: Phase, executed: _Pieces, until_s: float) -> _Pieces:
    """Return the pieces from where the orders were cut to the encoders of the stop.

    Args:
        phase: the phase.
        executed: its segments, cut where robots stopped.
        until_s: begin of the next phase [s].
    """
    units, n = phase.motion.units, len(phase.motion.start)
    turned = executed.lasts_s * executed.velocity_rad_s
    travelled = np.bincount(executed.profile, turned, minlength=2 * n)
    off = units.to_angles(phase.stop_counts - phase.motion.start).ravel() - travelled
    moved = np.flatnonzero(np.repeat(phase.stopped, 2) & (np.abs(off) > 1e-3 * units.quantum_rad))
    begin_s = 1e-6 * phase.stop_us[moved // 2]
    lasts_s = np.minimum(SETTLING_S, until_s - begin_s)
    return _Pieces(moved, begin_s, lasts_s, off[moved] / lasts_s)
