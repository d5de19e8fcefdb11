"""Loading of orders: only an order that was loaded, verified and certified can be started."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from fiber_bus_bridge.bus import Ack
from fiber_bus_bridge.motion_monitor import MotionMonitor
from fiber_bus_bridge.start_stop import StartStop
from fiber_bus_bridge.transactions import Transactions
from fiber_bus_bridge.wire import Frames, Opcode, RobotState, decode_load, encode_load
from fiber_core.array_types import Bools, Codes, Ints, Mask, Pairs, Rows
from fiber_core.clearance import Certificate, Safety, hold_until_safe
from fiber_core.focal_plane import FocalPlane
from fiber_core.outcomes import Reason
from fiber_core.wire_units import WireMotion, WireUnits

__all__ = ["LoadedPlan", "Loader"]

_ROUNDS = 6  # fresh sequence numbers tried before nothing is started
_TRIES = 2  # deliveries of an order under one sequence number


@dataclass(frozen=True, eq=False)
class LoadedPlan:
    """Result of loading and starting a plan.

    Args:
        started: robots that were started, shape (n,).
        reason: Reason of robots with orders that were not started, else OK, shape (n,).
        sequence: sequence number of the order of each robot, shape (n,).
        frames: the LOAD frames of the started robots, in the order of their rows.
        motion: the motion decoded from these frames.
        certificate: the certificate of this motion.
        go_s: time at which the GO was complete [s].
        start_s: time at which the robots begin to move, at the end of the countdown [s].
        monitor: the monitor of the started robots, None if no robot was started.
    """

    started: Mask
    reason: Codes
    sequence: Ints
    frames: Frames
    motion: WireMotion
    certificate: Certificate
    go_s: float
    start_s: float
    monitor: MotionMonitor | None = None


@dataclass(frozen=True, eq=False)
class _Delivery:
    """Result of LOAD and VERIFY for some robots, shape (r,) each.

    Args:
        verified: whether the order on the robot is the one sent.
        suspect: whether the robot may hold another order under the same sequence number.
        reason: Reason of robots that are not verified, else OK.
    """

    verified: Bools
    suspect: Bools
    reason: Codes


@dataclass(eq=False)
class _Progress:
    """State of a run of the loader, updated from round to round.

    Args:
        motion: orders of the robots that shall move.
        wanted: robots that shall move and can still be started, shape (n,).
        verified: robots with a verified order, shape (n,).
        reason: Reason of robots that cannot be started, else OK, shape (n,).
        stale: buses that need a fresh sequence number, shape (b,).
        late: robots on buses that received a GO too late, shape (n,).
    """

    motion: WireMotion
    wanted: Mask
    verified: Mask
    reason: Codes
    stale: Bools
    late: Mask

    def exclude(self, robots: Mask, reason: Reason) -> None:
        """Exclude robots from the start for a reason."""
        self.reason[robots] = reason
        self.wanted &= ~robots
        self.verified &= ~robots


class Loader:
    """Loads, verifies, certifies and starts orders: LOAD, VERIFY, certify, GO.

    A GO reaches a whole bus and starts every order loaded there under its sequence number. So a
    robot that must not move, but may hold such an order, forces its bus to a fresh sequence
    number: the robot is not verified, or it is unsafe and could not be given an empty order. The
    other robots of the bus are loaded again, and the GO has no effect on that robot. A robot that
    does not confirm the GO stops all robots before one has moved, and the other robots are loaded
    again without it.

    Args:
        plane: the focal plane.
        units: tick, quantum and widths.
        safety: clearance required of every started motion.
        transactions: the transactions with the robots.
        pairs: pairs of robots that can touch, rows as from neighbour_pairs, shape (p, 2).
        start_stop: starts the loaded robots.
    """

    def __init__(
        self,
        plane: FocalPlane,
        units: WireUnits,
        safety: Safety,
        transactions: Transactions,
        pairs: Pairs,
        start_stop: StartStop,
    ):
        self.plane, self.units, self.safety = plane, units, safety
        self.transactions, self.pairs = transactions, pairs
        self._start_stop = start_stop
        self._bus = transactions.places(transactions.addresses.bus)
        self._sequence = np.zeros(len(transactions.buses), dtype=np.int64)
        self._verify_s = 0.0  # time to VERIFY all robots

    def run(
        self,
        motion: WireMotion,
        wanted: Mask,
        known: Mask,
        boot: Ints,
        lost: Mask,
        t: float,
        may_go: Callable[[], bool] = lambda: True,
    ) -> LoadedPlan:
        """Load, verify and certify orders, and start the certified ones.

        Args:
            motion: orders of every robot, from the positions of the encoders.
            wanted: robots that shall move, shape (n,).
            known: robots that can be commanded, shape (n,).
            boot: boot counters at configuration, shape (n,).
            lost: robots with an unknown position, shape (n,); their neighbours do not move.
            t: earliest time [s].
            may_go: asked when the orders are certified; False drops all orders.
        """
        blocked = wanted & (self._neighbours_of(lost) | lost)
        progress = _Progress(
            motion.only(wanted & ~blocked),
            wanted & ~blocked,
            np.zeros_like(wanted),
            np.where(blocked, Reason.UNSAFE_AS_LOADED, Reason.OK).astype(np.int64),
            np.ones(len(self.transactions.buses), dtype=bool),
            np.zeros_like(wanted),
        )
        self._verify_s = 0.0
        frames = self._encode(progress.motion)
        for _ in range(_ROUNDS):
            frames = self._load_stale(progress, boot, t)
            if progress.stale.any():
                continue
            certified = self._certify_verified(progress, frames, boot, t)
            if certified is None:
                continue
            if not may_go():
                break
            started = self._go(progress, frames, certified, known, boot, t)
            if started is not None:
                return started
        return self._drop(progress, frames)

    def _load_stale(self, progress: _Progress, boot: Ints, t: float) -> Frames:
        """LOAD and VERIFY on buses that need a fresh sequence number; return all frames."""
        stale = progress.stale
        progress.verified &= ~stale[self._bus]
        self._sequence = np.where(stale, self._sequence % 15 + 1, self._sequence)
        todo = np.flatnonzero(progress.wanted & stale[self._bus])
        # for the other buses these are, byte for byte, the frames already verified there
        frames = self._encode(progress.motion)
        delivered = self._load_and_verify(todo, frames[todo], boot, t)
        progress.verified[todo] = delivered.verified
        progress.reason[todo] = delivered.reason
        progress.wanted &= progress.reason == Reason.OK
        # on a bus without GO it does not matter which orders are loaded
        suspect = self._buses_of(todo[delivered.suspect])
        progress.stale = suspect & self._buses_of(progress.wanted)
        return frames

    def _certify_verified(
        self, progress: _Progress, frames: Frames, boot: Ints, t: float
    ) -> tuple[WireMotion, Certificate] | None:
        """Certify the verified orders, unsafe robots held; None if a bus has become stale."""
        loaded = self._decode(progress.motion, frames, progress.verified)
        certificate, held = self._certify(loaded)
        held = held & progress.verified
        if held.any():
            progress.exclude(held, Reason.UNSAFE_AS_LOADED)
            armed = self._disarm(np.flatnonzero(held), boot, t)
            progress.stale = self._buses_of(armed) & self._buses_of(progress.wanted)
            if progress.stale.any():
                return None
            loaded = self._decode(progress.motion, frames, progress.verified)
        return loaded, certificate

    def _go(
        self,
        progress: _Progress,
        frames: Frames,
        certified: tuple[WireMotion, Certificate],
        known: Mask,
        boot: Ints,
        t: float,
    ) -> LoadedPlan | None:
        """Start the verified robots; None if the start was cancelled."""
        loaded, certificate = certified
        rows = np.flatnonzero(progress.verified)
        start = self._start_stop.go(rows, known, self._sequence, boot, self._verify_s, t)
        if start.monitor is None and len(rows):
            # No robot has moved: all robots that are loaded again have confirmed that. Left out
            # are the others, and robots on a bus that received a GO too late for the second time.
            missing = start.missing | (start.late & progress.late)
            progress.late |= start.late
            progress.reason[missing] = Reason.NOT_ACKNOWLEDGED
            progress.wanted &= ~missing
            progress.stale[:] = True
            return None
        if start.monitor is not None:
            start.monitor.moves_until_s = start.start_s + loaded.decoded().makespan_s
        return LoadedPlan(
            progress.verified, progress.reason, self._sequence[self._bus], frames[rows],
            loaded, certificate, start.go_s, start.start_s, start.monitor,
        )  # fmt: skip

    def _drop(self, progress: _Progress, frames: Frames) -> LoadedPlan:
        """Clear all loaded orders; no robot is started."""
        progress.reason[progress.wanted] = Reason.STOPPED
        rows = np.flatnonzero(progress.verified)
        self.transactions.command(Opcode.CLEAR, rows, self.transactions.now_s)
        none = np.zeros_like(progress.wanted)
        loaded = self._decode(progress.motion, frames, none)
        certificate, _ = self._certify(loaded)
        now_s = self.transactions.now_s
        return LoadedPlan(
            none, progress.reason, self._sequence[self._bus], frames[np.flatnonzero(none)],
            loaded, certificate, now_s, now_s,
        )  # fmt: skip

    def _neighbours_of(self, lost: Mask) -> Mask:
        """Robots in a pair with a lost one, shape (n,)."""
        pairs = self.pairs[(self.pairs < self.plane.n).all(axis=1)]
        neighbours = np.zeros(self.plane.n, dtype=bool)
        neighbours[pairs[lost[pairs[:, 1]], 0]] = True
        neighbours[pairs[lost[pairs[:, 0]], 1]] = True
        return neighbours

    def _buses_of(self, robots: Rows | Mask) -> Bools:
        """Whether a bus carries some of these robots, shape (b,)."""
        return np.isin(np.arange(len(self.transactions.buses)), self._bus[robots])

    def _encode(self, motion: WireMotion) -> Frames:
        return encode_load(
            self.units, self.transactions.addresses, self._sequence[self._bus],
            motion.offsets, motion.ticks, motion.velocity,
        )  # fmt: skip

    def _decode(self, motion: WireMotion, frames: Frames, chosen: Mask) -> WireMotion:
        """The motion in the frames of the chosen robots; all other robots rest."""
        orders = decode_load(self.units, frames)
        every = WireMotion(self.units, motion.start, orders.offsets, orders.ticks, orders.velocity)
        return every.only(chosen)

    def _load_and_verify(self, rows: Rows, frames: Frames, boot: Ints, t: float) -> _Delivery:
        """LOAD and VERIFY; both are repeated once for robots on which they failed by chance."""
        verified, suspect = np.zeros(len(rows), dtype=bool), np.ones(len(rows), dtype=bool)
        ack = np.full(len(rows), Ack.NO_ADDRESS, dtype=np.int64)
        todo = np.arange(len(rows))
        for _ in range(_TRIES):
            new_ack = self.transactions.send(rows[todo], frames[todo], t)
            ack[todo] = np.where(new_ack == Ack.NO_ADDRESS, ack[todo], new_ack)
            begin_s = max(t, self.transactions.now_s)
            status = self.transactions.statuses(rows[todo], t, complete=False)
            self._verify_s = max(self._verify_s, self.transactions.now_s - begin_s)
            sent = decode_load(self.units, frames[todo])
            loaded = (status.state == RobotState.LOADED) & (status.sequence == sent.sequence)
            same = (status.order_crc == sent.crc) & (status.boot == boot[rows[todo]])
            verified[todo] = status.ok & loaded & same
            suspect[todo] = ~verified[todo] & (~status.ok | loaded)
            # another boot, a repeated refusal and an absence are final
            final = status.ok & (status.boot != boot[rows[todo]]) | (new_ack == Ack.REFUSED)
            final |= (new_ack == Ack.NO_ADDRESS) & ~status.ok
            todo = todo[~verified[todo] & ~final]
        unverified = np.where(ack == Ack.REFUSED, Reason.REFUSED, Reason.NOT_VERIFIED)
        unverified[ack == Ack.NO_ADDRESS] = Reason.NOT_ACKNOWLEDGED
        return _Delivery(verified, suspect, np.where(verified, Reason.OK, unverified))

    def _certify(self, loaded: WireMotion) -> tuple[Certificate, Mask]:
        """The certificate of the motion with unsafe robots held, and the held robots, (n,)."""
        motion, held, certificate = hold_until_safe(self.plane, loaded.decoded(), self.safety)
        # two resting robots may be too close to each other; a moving robot may not be one of them
        wrong = certificate.unsafe_robots | certificate.limits_broken | certificate.moved_disabled
        if (wrong & (motion.counts > 0).any(axis=1)).any():
            held = np.ones(self.plane.n, dtype=bool)
        return certificate, held

    def _disarm(self, rows: Rows, boot: Ints, t: float) -> Rows:
        """Replace orders by empty ones; return the robots that may still hold their order."""
        empty = encode_load(
            self.units, self.transactions.addresses[rows], self._sequence[self._bus[rows]],
            np.zeros(2 * len(rows) + 1), [], [],
        )  # fmt: skip
        return rows[self._load_and_verify(rows, empty, boot, t).suspect]
