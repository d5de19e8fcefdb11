"""Orders that were started together, how far robots got with them, and the motion of it all."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fiber_core.motion import SegmentMotion
from fiber_core.validation import frozen_array
from fiber_core.wire_units import WireMotion
from fiber_recording.errors import RecordingError

__all__ = ["Phase", "counts_at", "executed"]

_SAME_S = 1e-7  # instants this near to each other are one
_SETTLING_S = 1e-4  # in which a robot comes from where its orders were cut to where it stood


@dataclass(frozen=True, eq=False)
class Phase:
    """Orders that were started together, and how far each robot got with them.

    A plan in which nothing goes wrong has one phase. Where all were stopped and some went on,
    what these were sent for the rest of their way is the next.

    Args:
        motion: the orders as sent, from where encoders were; robots not started rest.
        begin_us: when robots began to move, from the begin of the first phase on [us].
        stop_us: when a robot stopped before the end of its orders, counted alike, shape (n,);
            -1: it did not.
        stop: where those robots stood from then on [quanta], shape (n, 2).
    """

    motion: WireMotion
    begin_us: int
    stop_us: np.ndarray
    stop: np.ndarray

    def __post_init__(self):
        n = len(self.motion.start)
        for name, shape in (("stop_us", (n,)), ("stop", (n, 2))):
            value = frozen_array(getattr(self, name), np.int64, shape, name, RecordingError)
            object.__setattr__(self, name, value)

    @classmethod
    def whole(cls, motion: WireMotion, begin_us: int = 0) -> "Phase":
        """Return the phase of orders that were all carried out."""
        return cls(motion, begin_us, np.full(len(motion.start), -1), np.zeros_like(motion.start))

    @property
    def stopped(self) -> np.ndarray:
        """Robots that stopped before the end of their orders, shape (n,)."""
        return self.stop_us >= 0

    @property
    def end(self) -> np.ndarray:
        """Where robots stand after it [quanta], shape (n, 2)."""
        return np.where(self.stopped[:, None], self.stop, self.motion.end)

    def counts_at(self, row, time_us) -> np.ndarray:
        """Return where robots, shape (m,), are at times [us], shape (m,): [quanta], (m, 2)."""
        row, time_us = np.asarray(row), np.asarray(time_us)
        counts = _ordered(self.motion, row, time_us - self.begin_us)
        over = self.stopped[row] & (time_us >= self.stop_us[row])
        return np.where(over[:, None], self.stop[row], counts)


def _ordered(motion, row, time_us):
    # where orders put robots some time after they began, in whole numbers only
    profile = 2 * np.asarray(row, dtype=np.int64)[:, None] + [0, 1]
    left = np.repeat(np.maximum(np.asarray(time_us, dtype=np.int64), 0)[:, None], 2, axis=1)
    counts = motion.start.ravel()[profile]
    segment, stop = motion.offsets[profile], motion.offsets[profile + 1]
    tick_us = motion.units.tick_us
    while (inside := segment < stop).any():
        at = np.where(inside, segment, 0)
        spent = np.where(inside, np.minimum(left, motion.ticks[at] * tick_us), 0)
        counts = counts + np.where(inside, motion.velocity[at] * spent // tick_us, 0)
        left, segment = left - spent, segment + 1
    return counts


def counts_at(phases: Sequence[Phase], row, time_us) -> np.ndarray:
    """Return where the phases of a plan put robots at some times [quanta], shape (m, 2).

    Args:
        phases: in the order in which they began.
        row: robots, shape (m,).
        time_us: times from the begin of the first phase on [us], shape (m,).
    """
    counts = phases[0].counts_at(row, time_us)
    for phase in phases[1:]:
        later = np.asarray(time_us) >= phase.begin_us
        counts = np.where(later[:, None], phase.counts_at(row, time_us), counts)
    return counts


def executed(phases: Sequence[Phase]) -> SegmentMotion:
    """Return the motion of all phases one after the other, with the rests between them.

    A robot that was stopped is 0.1 ms later at the very place where it stood: the instant of
    its stop is known to a microsecond only.

    Args:
        phases: in the order in which they began.
    """
    pieces = [_pieces(phase) for phase in phases]
    for k, phase in enumerate(phases):
        until_s = 1e-6 * phases[k + 1].begin_us if k + 1 < len(phases) else np.inf
        pieces.append(_settling(phase, pieces[k], until_s))
    profile, begin_s, lasts_s, velocity = (np.concatenate(column) for column in zip(*pieces))
    order = np.lexsort([begin_s, profile])
    profile, begin_s, lasts_s, velocity = (
        column[order] for column in (profile, begin_s, lasts_s, velocity)
    )
    # rests before pieces that do not begin where the one before them ends
    end_s = np.zeros(len(profile))
    follows = np.flatnonzero(profile[1:] == profile[:-1]) + 1
    end_s[follows] = (begin_s + lasts_s)[follows - 1]
    rests = np.flatnonzero(begin_s - end_s > _SAME_S)
    lasts_s = np.insert(lasts_s, rests, (begin_s - end_s)[rests])
    velocity = np.insert(velocity, rests, 0.0)
    profile = np.insert(profile, rests, profile[rests])
    start = phases[0].motion.decoded().start
    lengths = np.bincount(profile, minlength=start.size)
    return SegmentMotion(start, np.concatenate([[0], np.cumsum(lengths)]), lasts_s, velocity)


def _pieces(phase):
    # segments as far as they were carried out: profile, begin, length, velocity
    motion = phase.motion.decoded()
    profile = np.repeat(np.arange(2 * motion.n), np.diff(motion.offsets))
    ends_s = np.cumsum(motion.duration_s)
    before = np.concatenate([[0.0], ends_s])[motion.offsets[:-1]]
    begin_s = ends_s - motion.duration_s - before[profile] + 1e-6 * phase.begin_us
    stop_s = np.where(phase.stopped, 1e-6 * phase.stop_us, np.inf)[profile // 2]
    lasts_s = np.minimum(motion.duration_s, stop_s - begin_s)
    kept = lasts_s > 0.0
    return profile[kept], begin_s[kept], lasts_s[kept], motion.velocity_rad_s[kept]


def _settling(phase, pieces, until_s):
    # from where the cut leaves a joint to where it stood
    profile, _, lasts_s, velocity = pieces
    units, n = phase.motion.units, len(phase.motion.start)
    way = np.bincount(profile, lasts_s * velocity, minlength=2 * n)
    off = units.to_angles(phase.stop - phase.motion.start).ravel() - way
    moved = np.flatnonzero(np.repeat(phase.stopped, 2) & (np.abs(off) > 1e-3 * units.quantum_rad))
    begin_s = 1e-6 * phase.stop_us[moved // 2]
    lasts_s = np.minimum(_SETTLING_S, until_s - begin_s)
    return moved, begin_s, lasts_s, off[moved] / lasts_s
