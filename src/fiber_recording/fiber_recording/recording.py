# SPDX-License-Identifier: Apache-2.0
"""The recording of one plan: the source of the player, the figures and the bag."""

from collections.abc import Mapping
from dataclasses import dataclass
from enum import IntEnum
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from fiber_core.array_types import Codes, Counts, Floats, Gaps, Ints, Mask, Pairs, Rows, Times
from fiber_core.corridor import JointCorridors
from fiber_core.motion import SampledMotion, SegmentMotion
from fiber_core.problem import Problem
from fiber_core.validation import frozen_array
from fiber_core.wire_units import WireMotion, WireUnits
from fiber_recording.errors import RecordingError
from fiber_recording.images import Images
from fiber_recording.phases import Phase, executed_motion

__all__ = [
    "SOFTWARE",
    "Approaches",
    "BusLoad",
    "EventKind",
    "Events",
    "Measured",
    "Recording",
]

SOFTWARE = "fiber_recording 0.1.0"  # the writer, as a recording names it


class EventKind(IntEnum):
    """What happened on a bus; the number is written to files."""

    GO = 0  # general call: every robot that stores an order starts
    STOP = 1  # general call: every robot stops
    NO_ADDRESS = 2  # the address was not acknowledged
    REFUSED = 3  # the robot did not acknowledge the last byte
    BAD_REPLY = 4  # the checksum of a reply was wrong
    FAULT = 5  # a robot reports a fault; the detail is its number
    ALERT = 6  # a robot raises alerts; the detail is their flags
    LINE = 7  # the lines of a bus failed; the detail is how


def _freeze(record: object, columns: Mapping[str, tuple[tuple[int | None, ...], type]]) -> None:
    for name, (shape, dtype) in columns.items():
        value = frozen_array(getattr(record, name), dtype, shape, name, RecordingError)
        object.__setattr__(record, name, value)


@dataclass(frozen=True, eq=False)
class Measured:
    """Encoder readings that robots reported over the bus.

    Args:
        row: row of the robot in the plane, shape (m,).
        time_us: time of the frame that carried the reading, from the begin of the motion [us],
            shape (m,).
        counts: encoders theta, phi [quanta], shape (m, 2).

    Raises:
        RecordingError: a shape does not fit; names the array.
    """

    row: Rows
    time_us: Ints
    counts: Counts

    def __post_init__(self):
        m = np.size(self.row)
        whole = dict.fromkeys(("row", "time_us"), ((m,), np.int64))
        _freeze(self, whole | {"counts": ((m, 2), np.int64)})


@dataclass(frozen=True, eq=False)
class BusLoad:
    """Frames and bytes on each bus, in bins of equal length.

    Args:
        buses: bus numbers, shape (b,).
        begin_s: begin of the first bin, from the begin of the motion [s].
        bin_s: length of a bin [s].
        frames: number of frames that began in each bin, shape (b, k).
        bytes: data bytes of these frames, shape (b, k).

    Raises:
        RecordingError: a shape does not fit; names the array.
    """

    buses: Ints
    begin_s: float
    bin_s: float
    frames: Ints
    bytes: Ints

    def __post_init__(self):
        shape = (np.size(self.buses), None)
        _freeze(self, {"buses": ((None,), np.int64), "frames": (shape, np.int64)})
        _freeze(self, {"bytes": (self.frames.shape, np.int64)})

    @property
    def edges_s(self) -> Times:
        """Begins of all bins and the end of the last [s], shape (k + 1,)."""
        return self.begin_s + self.bin_s * np.arange(self.frames.shape[1] + 1)


@dataclass(frozen=True, eq=False)
class Events:
    """Starts, stops and faults on the buses, in order of time.

    Args:
        time_s: time of the event, from the begin of the motion [s], shape (e,); of a stall, that at
            which the robot stopped.
        kind: EventKind, shape (e,).
        bus: number of the bus, shape (e,).
        row: row of the robot in the plane, -1 for an event of the whole bus, shape (e,).
        detail: number that the kind explains, 0 for a kind without one, shape (e,).

    Raises:
        RecordingError: a shape does not fit, or a kind is unknown; names the value.
    """

    time_s: Times
    kind: Codes
    bus: Ints
    row: Rows
    detail: Ints

    def __post_init__(self):
        e = np.size(self.time_s)
        whole = dict.fromkeys(("kind", "bus", "row", "detail"), ((e,), np.int64))
        _freeze(self, {"time_s": ((e,), np.float64)} | whole)
        unknown = ~np.isin(self.kind, list(EventKind))
        if unknown.any():
            raise RecordingError(f"kind of event {self.kind[unknown][0]} is unknown")

    @property
    def unexpected(self) -> Mask:
        """Events other than GO and STOP, shape (e,)."""
        return ~np.isin(self.kind, (EventKind.GO, EventKind.STOP))


@dataclass(frozen=True, eq=False)
class Approaches:
    """The smallest gap of every pair of neighbours; see closest_approaches.

    Args:
        pairs: rows a, b; rows from n on are fixed discs, shape (p, 2).
        gap_mm: smallest gap between the outlines of the pair [mm], shape (p,).
        time_s: time of that gap, from the begin of the motion [s], shape (p,).

    Raises:
        RecordingError: a shape does not fit; names the array.
    """

    pairs: Pairs
    gap_mm: Gaps
    time_s: Times

    def __post_init__(self):
        p = len(self.pairs)
        _freeze(
            self,
            {
                "pairs": ((p, 2), np.int64),
                "gap_mm": ((p,), np.float64),
                "time_s": ((p,), np.float64),
            },
        )


@dataclass(frozen=True, eq=False)
class Recording:
    """One plan: its targets, its orders, the executed motion and the outcome of every robot.

    Times count from the instant at which the robots of the first phase begin to move; loading
    and countdown have negative times.

    Args:
        problem: plane, joint angles before the motion, targets.
        units: tick and quantum of the orders.
        phases: the orders as sent, decoded from the bytes, and how far robots got with them;
            one more for each time the robots were resumed.
        started: robots that received a GO for an order that they stored, shape (n,).
        planned: the planner's trajectory, None if the planner published none.
        corridors: the corridors of all n robots in the first phase; None if
            the discretizer published none.
        measured: encoder readings during the plan.
        load: frames and bytes on the buses.
        events: starts, stops and faults on the buses.
        outcome: Outcome of each robot, shape (n,).
        reason: Reason of each robot, shape (n,).
        error_mm: distance from fibre to target [mm], nan without a target, shape (n,).
        approaches: smallest gaps of neighbours in the executed motion.
        about: plain values for JSON: `software`, `plan_ns`, `seed`, `planner`, `report` (the
            metrics of fiber_core.metrics.plan_metrics), `certificate`, `notes`, and `codes`:
            names of the details of fault and line events (a number) and of alerts (flags).
        images: what a camera told, None without one.

    Raises:
        RecordingError: a shape does not fit the plane; names the array.
    """

    problem: Problem
    units: WireUnits
    phases: tuple[Phase, ...]
    started: Mask
    planned: SampledMotion | None
    corridors: JointCorridors | None
    measured: Measured
    load: BusLoad
    events: Events
    outcome: Codes
    reason: Codes
    error_mm: Floats
    approaches: Approaches
    about: dict[str, Any]  # JSON: a value may be of any type
    images: Images | None = None

    def __post_init__(self):
        n = self.problem.plane.n
        whole = dict.fromkeys(("outcome", "reason"), ((n,), np.int64))
        _freeze(self, {"started": ((n,), np.bool_), "error_mm": ((n,), np.float64)} | whole)
        object.__setattr__(self, "phases", tuple(self.phases))
        rows_of_part = [(f"phase {k}", len(p.motion.start)) for k, p in enumerate(self.phases)]
        if self.planned is not None:
            rows_of_part.append(("planned", self.planned.n))
        if self.corridors is not None:
            rows_of_part.append(("corridors", len(self.corridors)))
        if self.images is not None:
            rows_of_part.append(("images", self.images.robots))
        for name, rows in rows_of_part or [("phases", 0)]:
            if rows != n:
                raise RecordingError(f"{name} has {rows} robots, the plane has {n}")
        last = n + self.problem.plane.fixtures - 1
        for name, value, high in (
            ("measured.row", self.measured.row, n - 1),
            ("events.row", self.events.row, n - 1),
            ("approaches.pairs", self.approaches.pairs, last),
        ):
            if value.max(initial=-1) > high:
                raise RecordingError(
                    f"{name} {value.max()} is not a row of this plane, the last one is {high}"
                )

    @property
    def motion(self) -> WireMotion:
        """The orders of the first phase, to their end."""
        return self.phases[0].motion

    @cached_property
    def executed(self) -> SegmentMotion:
        """The motion that robots executed, in rad and s; a rest is a segment of velocity 0."""
        return executed_motion(self.phases)

    @property
    def order_segments(self) -> Ints:
        """Number of segments in each order of each motor, shape (phases, n, 2)."""
        return np.stack([phase.motion.counts for phase in self.phases])

    @cached_property
    def active_s(self) -> Floats:
        """Begin and end of the motion of each robot in each phase [s], shape (phases, n, 2).

        nan for a robot that does not move in a phase.
        """
        spans = np.full((len(self.phases), self.problem.plane.n, 2), np.nan)
        for span, phase in zip(spans, self.phases):
            moves = phase.motion.moves
            ends = 1e-6 * phase.begin_us + phase.motion.decoded().durations.max(axis=1, initial=0.0)
            span[moves, 0] = 1e-6 * phase.begin_us
            span[moves, 1] = np.where(phase.stopped, 1e-6 * phase.stop_us, ends)[moves]
        return spans

    @property
    def pauses_s(self) -> list[tuple[float, float]]:
        """Begin and end of each time in which all robots were stopped [s]."""
        return [
            (1e-6 * int(phase.stop_us.max()), 1e-6 * following.begin_us)
            for phase, following in zip(self.phases, self.phases[1:])
            if phase.stopped.any()
        ]

    def rows_of(self, ids: ArrayLike) -> Rows:
        """Return the rows of robots by their ids, shape as ids.

        Raises:
            RecordingError: the plane has no robot with such an id; names the ids.
        """
        ids = np.asarray(ids)
        rows = self.problem.plane.index_of(ids)
        if (rows < 0).any():
            raise RecordingError(f"no robot {ids[rows < 0].tolist()} in this recording")
        return rows
