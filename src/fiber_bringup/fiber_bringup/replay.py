"""What robots were told to do, read back from the very bytes that went over the buses."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from fiber_bringup.client import PlaneClient, PlanEnd
from fiber_bus_bridge.wire import (
    CALL_PREFIX,
    COUNTDOWN_S,
    Addresses,
    Frames,
    Opcode,
    decode_load,
)
from fiber_core.focal_plane import FocalPlane
from fiber_core.outcomes import Outcome, Reason
from fiber_core.wire_units import WireMotion, WireUnits
from fiber_msgs_py import FrameLog

__all__ = ["Replay", "replay", "settled_replay", "unexplained"]

_TOLD = (Opcode.LOAD, Opcode.CLEAR, Opcode.GO, Opcode.STOP)


@dataclass(frozen=True, eq=False)
class Replay:
    """A plan as its bytes tell it.

    Args:
        motion: the orders that were started, from where the encoders were.
        started: robots that a GO reached with an order for it, shape (n,).
        load_bytes: bytes of the order each of them was started with, shape (n,), else 0.
        load_s: when the first LOAD began, simulated time [s], nan without one.
        go_s: when the last GO began [s], nan without one.
        start_s: when its countdown was over [s], but for the 0.1 ms the frame itself takes.
    """

    motion: WireMotion
    started: np.ndarray
    load_bytes: np.ndarray
    load_s: float
    go_s: float
    start_s: float

    @property
    def bus_time_s(self) -> float:
        """Time from the first LOAD to the last GO on the buses [s], 0 without a GO."""
        return float(self.go_s - self.load_s) if np.isfinite(self.go_s) else 0.0


def replay(plane: FocalPlane, units: WireUnits, counts, logs: Iterable[FrameLog]) -> Replay:
    """Follow the frames of a plan as the robots do: store, forget, count down, start.

    An acknowledged LOAD replaces what a robot had stored, a CLEAR forgets it, and a GO lets
    every robot it reaches that stores an order of its sequence number start after a
    countdown. A STOP before that calls the start off.

    Args:
        plane: the focal plane.
        units: tick, quantum and widths of the wire format.
        counts: encoders before the plan [quanta], shape (n, 2).
        logs: its frames, in the order they were published.
    """
    log = FrameLog.joined(logs)
    rows_of = {
        (bus, address): np.array([row])
        for row, (bus, address) in enumerate(zip(plane.bus.tolist(), plane.address.tolist()))
    }
    rows_on = {bus: np.flatnonzero(plane.bus == bus) for bus in np.unique(plane.bus).tolist()}
    stored = np.full(plane.n, -1)  # number of the frame a robot holds
    running = np.full(plane.n, -1)
    sequence = np.full(plane.n, -1)
    starts_s = np.full(plane.n, np.nan)
    load_s = go_s = start_s = np.nan
    for frame, opcode, number, countdown_s, called in _orders(log):
        bus, time_s = int(log.bus[frame]), log.time_s[frame]
        rows = rows_on[bus] if called else rows_of[bus, int(log.address[frame])]
        if opcode == Opcode.LOAD:
            stored[rows], sequence[rows] = frame, number
            load_s = np.fmin(load_s, time_s)
        elif opcode == Opcode.CLEAR:
            stored[rows] = -1
        elif opcode == Opcode.GO:
            rows = rows[(stored[rows] >= 0) & (sequence[rows] == number)]
            running[rows], stored[rows] = stored[rows], -1
            starts_s[rows] = time_s + countdown_s
            go_s, start_s = np.fmax(go_s, time_s), np.fmax(start_s, time_s + countdown_s)
        else:
            stored[rows] = -1
            running[rows[starts_s[rows] > time_s]] = -1
    started = running >= 0
    frames = Frames(Addresses(log.bus, log.address, log.ten_bit), log.offsets, log.data)
    frames = frames[running[started]]
    orders = decode_load(units, frames)
    segments = np.zeros((plane.n, 2), dtype=np.int64)
    segments[started] = np.diff(orders.offsets).reshape(-1, 2)
    offsets = np.concatenate([[0], np.cumsum(segments)])
    load_bytes = np.zeros(plane.n, dtype=np.int64)
    load_bytes[started] = frames.lengths
    motion = WireMotion(units, counts, offsets, orders.ticks, orders.velocity)
    return Replay(motion, started, load_bytes, float(load_s), float(go_s), float(start_s))


def settled_replay(client: PlaneClient, ended: PlanEnd, counts, timeout_s: float) -> Replay:
    """Wait until the frames a client heard explain where all encoders are; return the replay.

    Of a plan with several attempts it is the replay of the last.

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
        last = client.last_attempt(ended.stamp)
        before = counts if last.attempt == 1 else client.before[last]
        told = replay(client.plane, client.units, before, client.frames.get(last, ()))
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


def _orders(log):
    # What makes robots store, forget or start: frame, opcode, sequence number, countdown of a
    # GO [s], and whether it is a general call, which has a prefix.
    written = np.flatnonzero(~log.read & (log.ack == 0) & (np.diff(log.offsets) > 0))
    called = (log.address[written] == 0) & ~log.ten_bit[written]
    first = log.offsets[written] + called * (log.data[log.offsets[written]] == CALL_PREFIX)
    opcode, number = log.data[first] >> 4, log.data[first] & 15
    for at in np.flatnonzero(np.isin(opcode, _TOLD)):
        countdown_s = 0.0
        if opcode[at] == Opcode.GO:
            countdown_s = (
                int.from_bytes(log.data[first[at] + 1 : first[at] + 3].tobytes()) * COUNTDOWN_S
            )
        yield written[at], opcode[at], number[at], countdown_s, called[at]
