"""What robots were told to do, read back from the very bytes that went over the buses."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from fiber_bringup.client import PlaneClient, PlanEnd
from fiber_bus_bridge.wire import CALL_PREFIX, Addresses, Frames, Opcode, decode_load
from fiber_core.focal_plane import FocalPlane
from fiber_core.outcomes import Outcome, Reason
from fiber_core.wire_units import WireMotion, WireUnits
from fiber_msgs_py import FrameLog

__all__ = ["Replay", "replay", "settled_replay", "unexplained"]


@dataclass(frozen=True, eq=False)
class Replay:
    """A plan as its bytes tell it.

    Args:
        motion: the orders that were started, from where the encoders were.
        started: robots that a GO reached with an order for it, shape (n,).
        load_bytes: bytes of the order each of them was started with, shape (n,), else 0.
        load_s: when the first LOAD began, simulated time [s], nan without one.
        go_s: when the last GO began [s], nan without one.
    """

    motion: WireMotion
    started: np.ndarray
    load_bytes: np.ndarray
    load_s: float
    go_s: float

    @property
    def bus_time_s(self) -> float:
        """Time from the first LOAD to the last GO on the buses [s], 0 without a GO."""
        return float(self.go_s - self.load_s) if np.isfinite(self.go_s) else 0.0


def replay(plane: FocalPlane, units: WireUnits, counts, logs: Iterable[FrameLog]) -> Replay:
    """Follow the frames of a plan as the robots do: store, forget, start.

    An acknowledged LOAD replaces what a robot had stored, a CLEAR forgets it, and a GO
    starts every robot of its bus that stores an order of the GO's sequence number.

    Args:
        plane: the focal plane.
        units: tick, quantum and widths of the wire format.
        counts: encoders before the plan [quanta], shape (n, 2).
        logs: its frames, in the order they were published.
    """
    row_of = {hung: row for row, hung in enumerate(zip(plane.bus.tolist(), plane.address.tolist()))}
    stored = np.full(plane.n, -1)  # number of the frame a robot holds, among all frames
    running = np.full(plane.n, -1)
    sequence = np.full(plane.n, -1)
    load_s, go_s, before = np.nan, np.nan, 0
    logs = list(logs)
    for log in logs:
        written = np.flatnonzero(~log.read & (log.ack == 0) & (np.diff(log.offsets) > 0))
        called = (log.address == 0) & ~log.ten_bit
        head = _heads(log, written, called)
        opcode = head >> 4
        go = written[opcode == Opcode.GO]
        for frame, number in zip(go, head[opcode == Opcode.GO] & 15):
            starts = (plane.bus == log.bus[frame]) & (stored >= 0) & (sequence == number)
            running[starts], stored[starts] = stored[starts], -1
            go_s = np.fmax(go_s, log.time_s[frame])
        single = ~called[written]
        for code in (Opcode.LOAD, Opcode.CLEAR):
            chosen = written[single & (opcode == code)]
            rows = np.array(
                [row_of[h] for h in zip(log.bus[chosen].tolist(), log.address[chosen].tolist())],
                dtype=np.int64,
            )
            if code == Opcode.CLEAR:
                stored[rows] = -1
            elif len(rows):
                stored[rows] = before + chosen
                sequence[rows] = head[single & (opcode == code)] & 15
                load_s = np.fmin(load_s, log.time_s[chosen].min())
        before += len(log)
    started = running >= 0
    frames = _frames(logs, running[started])
    orders = decode_load(units, frames)
    segments = np.zeros((plane.n, 2), dtype=np.int64)
    segments[started] = np.diff(orders.offsets).reshape(-1, 2)
    offsets = np.concatenate([[0], np.cumsum(segments)])
    load_bytes = np.zeros(plane.n, dtype=np.int64)
    load_bytes[started] = frames.lengths
    motion = WireMotion(units, counts, offsets, orders.ticks, orders.velocity)
    return Replay(motion, started, load_bytes, float(load_s), float(go_s))


def settled_replay(client: PlaneClient, ended: PlanEnd, counts, timeout_s: float) -> Replay:
    """Wait until the frames a client heard explain where all encoders are; return the replay.

    Args:
        client: has followed the plan.
        ended: what became of it, to its end without a stop; failed robots may be anywhere.
        counts: encoders before the plan [quanta], shape (n, 2).
        timeout_s: for the last frames and readings to come in [s].

    Raises:
        WaitError: they did not; names the first robot that is elsewhere.
    """
    told = None

    def elsewhere():
        nonlocal told
        told = replay(client.plane, client.units, counts, client.frames.get(ended.stamp, ()))
        off = unexplained(client.plane, told, ended, client.units.to_counts(client.angles))
        return client.plane.ids[off]

    client.until(
        lambda: not len(elsewhere()),
        timeout_s,
        lambda: f"frames that explain where robot {elsewhere()[0]} is",
    )
    return told


def unexplained(plane: FocalPlane, told: Replay, ended: PlanEnd, counts) -> np.ndarray:
    """Return the robots that are elsewhere than a replay takes them, shape (n,).

    Args:
        plane: the focal plane.
        told: the replay.
        ended: what became of its plan; robots that failed or were stopped may be anywhere.
        counts: encoders now [quanta], shape (n, 2).
    """
    ended = ended.of(plane.ids)
    obeyed = (ended.outcome != Outcome.FAILED) & (ended.reason != Reason.STOPPED)
    return (told.motion.end != counts).any(axis=1) & obeyed


def _heads(log, written, called):
    # opcode and sequence number; a general call carries them behind its prefix
    first = log.offsets[written]
    prefixed = called[written] & (log.data[first] == CALL_PREFIX)
    return log.data[first + prefixed].astype(np.int64)


def _frames(logs, numbers) -> Frames:
    # the frames of these numbers, counted through all logs, as one table
    def joined(values, dtype):
        return np.concatenate([np.zeros(0, dtype), *values])

    to = Addresses(
        joined([log.bus for log in logs], np.int64),
        joined([log.address for log in logs], np.int64),
        joined([log.ten_bit for log in logs], bool),
    )
    lengths = joined([np.diff(log.offsets) for log in logs], np.int64)
    offsets = np.concatenate([[0], np.cumsum(lengths)])
    return Frames(to, offsets, joined([log.data for log in logs], np.uint8))[numbers]
