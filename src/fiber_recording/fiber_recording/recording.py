"""What is kept of one reconfiguration: everything the player, the figures and a bag are made of."""

from dataclasses import dataclass
from enum import IntEnum
from functools import cached_property

import numpy as np

from fiber_core.corridor import JointCorridors
from fiber_core.motion import SampledMotion, SegmentMotion
from fiber_core.problem import Problem
from fiber_core.validation import frozen_array
from fiber_core.wire_units import WireMotion, WireUnits
from fiber_recording.errors import RecordingError
from fiber_recording.phases import Phase, executed

__all__ = [
    "SOFTWARE",
    "Approaches",
    "BusLoad",
    "EventKind",
    "Events",
    "Measured",
    "Recording",
]

SOFTWARE = "fiber_recording 0.1.0"  # what a recording says it was written by


class EventKind(IntEnum):
    """What happened on a bus; the number travels in files."""

    GO = 0  # general call: whoever holds an order starts
    STOP = 1  # general call: everybody freezes
    NO_ADDRESS = 2  # nobody acknowledged the address
    REFUSED = 3  # the robot did not acknowledge the last byte
    BAD_REPLY = 4  # the checksum of a reply was wrong
    FAULT = 5  # a robot reports a fault; the detail is its number
    ALERT = 6  # a robot raises alerts; the detail is their flags
    LINE = 7  # the lines of a bus failed; the detail is how


def _freeze(record, columns):
    for name, (shape, dtype) in columns.items():
        value = frozen_array(getattr(record, name), dtype, shape, name, RecordingError)
        object.__setattr__(record, name, value)


@dataclass(frozen=True, eq=False)
class Measured:
    """Encoder readings as robots reported them over the bus.

    Args:
        row: robot, row of the plane, shape (m,).
        time_us: when it was asked, from the GO on [us], shape (m,).
        counts: encoders theta, phi [quanta], shape (m, 2).
    """

    row: np.ndarray
    time_us: np.ndarray
    counts: np.ndarray

    def __post_init__(self):
        m = np.size(self.row)
        whole = dict.fromkeys(("row", "time_us"), ((m,), np.int64))
        _freeze(self, whole | {"counts": ((m, 2), np.int64)})


@dataclass(frozen=True, eq=False)
class BusLoad:
    """How much went over each bus, in bins of equal length.

    Args:
        buses: bus numbers, shape (b,).
        begin_s: begin of the first bin, from the GO on [s].
        bin_s: length of a bin [s].
        frames: frames begun in each bin, shape (b, k).
        bytes: data bytes of these frames, shape (b, k).
    """

    buses: np.ndarray
    begin_s: float
    bin_s: float
    frames: np.ndarray
    bytes: np.ndarray

    def __post_init__(self):
        shape = (np.size(self.buses), None)
        _freeze(self, {"buses": ((None,), np.int64), "frames": (shape, np.int64)})
        _freeze(self, {"bytes": (self.frames.shape, np.int64)})

    @property
    def edges_s(self) -> np.ndarray:
        """Begins of the bins and the end of the last [s], shape (k + 1,)."""
        return self.begin_s + self.bin_s * np.arange(self.frames.shape[1] + 1)


@dataclass(frozen=True, eq=False)
class Events:
    """What happened on the buses beside the ordinary, in order of time.

    Args:
        time_s: when, from the GO on [s], shape (e,).
        kind: EventKind, shape (e,).
        bus: on which bus, shape (e,).
        row: robot, row of the plane, -1 for all of a bus, shape (e,).
        detail: number that belongs to the kind, 0 where there is none, shape (e,).
    """

    time_s: np.ndarray
    kind: np.ndarray
    bus: np.ndarray
    row: np.ndarray
    detail: np.ndarray

    def __post_init__(self):
        e = np.size(self.time_s)
        whole = dict.fromkeys(("kind", "bus", "row", "detail"), ((e,), np.int64))
        _freeze(self, {"time_s": ((e,), np.float64)} | whole)
        unknown = ~np.isin(self.kind, list(EventKind))
        if unknown.any():
            raise RecordingError(f"event {self.kind[unknown][0]} has no meaning")

    @property
    def bad(self) -> np.ndarray:
        """Those that nobody asked for, shape (e,)."""
        return ~np.isin(self.kind, (EventKind.GO, EventKind.STOP))


@dataclass(frozen=True, eq=False)
class Approaches:
    """How near every pair of neighbours came; see closest_approaches.

    Args:
        pairs: rows a, b; rows from n on are fixed discs, shape (p, 2).
        gap_mm: smallest gap met between the outlines [mm], shape (p,).
        time_s: when [s], shape (p,).
    """

    pairs: np.ndarray
    gap_mm: np.ndarray
    time_s: np.ndarray

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
    """One reconfiguration, from what was asked to what became of every robot.

    Times count from the moment at which robots begin to move: before it orders are loaded.

    Args:
        problem: plane, encoders before the motion, targets.
        units: tick and quantum of the orders.
        phases: the orders as sent, decoded from the bytes, and how far robots got with them;
            more than one where robots were stopped and went on.
        started: robots a GO reached with an order for it, shape (n,).
        planned: the planner's curves, None where it published none.
        corridors: how far joints could turn beside the orders of the first phase, of all n
            robots; None where nobody told.
        measured: encoder readings on the way.
        load: how busy the buses were.
        events: what happened on them.
        outcome: Outcome of each robot, shape (n,).
        reason: Reason of each robot, shape (n,).
        error_mm: distance from fibre to target [mm], nan without a target, shape (n,).
        approaches: how near neighbours came on the motion as sent.
        about: plain values for JSON: `software`, `plan_ns`, `seed`, `planner`, `report` (as
            fiber_core.metrics.plan_metrics gives it), `certificate`, `notes`, and `codes`: names
            of the details of FAULT (a number) and ALERT (flags), where they are known.

    Raises:
        RecordingError: a shape does not fit the plane; names the array.
    """

    problem: Problem
    units: WireUnits
    phases: tuple[Phase, ...]
    started: np.ndarray
    planned: SampledMotion | None
    corridors: JointCorridors | None
    measured: Measured
    load: BusLoad
    events: Events
    outcome: np.ndarray
    reason: np.ndarray
    error_mm: np.ndarray
    approaches: Approaches
    about: dict

    def __post_init__(self):
        n = self.problem.plane.n
        whole = dict.fromkeys(("outcome", "reason"), ((n,), np.int64))
        _freeze(self, {"started": ((n,), np.bool_), "error_mm": ((n,), np.float64)} | whole)
        object.__setattr__(self, "phases", tuple(self.phases))
        told = [(f"phase {k}", len(phase.motion.start)) for k, phase in enumerate(self.phases)]
        if self.planned is not None:
            told.append(("planned", self.planned.n))
        if self.corridors is not None:
            told.append(("corridors", len(self.corridors)))
        for name, rows in told or [("phases", 0)]:
            if rows != n:
                raise RecordingError(f"{name} is of {rows} robots, the plane has {n}")
        last = n + len(self.problem.plane.obstacles) - 1
        for name, value, high in (
            ("measured.row", self.measured.row, n - 1),
            ("events.row", self.events.row, n - 1),
            ("approaches.pairs", self.approaches.pairs, last),
        ):
            if value.max(initial=-1) > high:
                raise RecordingError(f"{name} {value.max()} is not of this plane, last is {high}")

    @property
    def motion(self) -> WireMotion:
        """The orders that were started first, to their end."""
        return self.phases[0].motion

    @cached_property
    def decoded(self) -> SegmentMotion:
        """The motion as it was carried out, in rad and s; one rest is one segment of it."""
        return executed(self.phases)

    @property
    def order_segments(self) -> np.ndarray:
        """Number of segments in each order of each motor, shape (phases, n, 2)."""
        return np.stack([np.diff(phase.motion.offsets).reshape(-1, 2) for phase in self.phases])

    @cached_property
    def active_s(self) -> np.ndarray:
        """When each robot of each phase moved [s], shape (phases, n, 2): from, until; nan: not."""
        spans = np.full((len(self.phases), self.problem.plane.n, 2), np.nan)
        for span, phase in zip(spans, self.phases):
            moves = np.diff(phase.motion.offsets).reshape(-1, 2).any(axis=1)
            ends = 1e-6 * phase.begin_us + phase.motion.decoded().durations.max(axis=1, initial=0.0)
            span[moves, 0] = 1e-6 * phase.begin_us
            span[moves, 1] = np.where(phase.stopped, 1e-6 * phase.stop_us, ends)[moves]
        return spans

    @property
    def pauses_s(self) -> list[tuple[float, float]]:
        """From when on all were stopped until some went on [s]."""
        return [
            (1e-6 * int(phase.stop_us.max()), 1e-6 * after.begin_us)
            for phase, after in zip(self.phases, self.phases[1:])
            if phase.stopped.any()
        ]

    def rows_of(self, ids) -> np.ndarray:
        """Return the rows of robots by id, shape as ids.

        Raises:
            RecordingError: the plane has no such robot.
        """
        rows = self.problem.plane.index_of(ids)
        if (rows < 0).any():
            raise RecordingError(f"no robot {np.asarray(ids)[rows < 0].tolist()} in this recording")
        return rows
