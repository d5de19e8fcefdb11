"""Bring orders onto robots so that nothing can move but what was loaded, verified and certified."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from fiber_bus_bridge.bus import Ack
from fiber_bus_bridge.motion_monitor import MotionMonitor
from fiber_bus_bridge.start_stop import StartStop
from fiber_bus_bridge.transactions import Transactions
from fiber_bus_bridge.wire import Frames, Opcode, RobotState, decode_load, encode_load
from fiber_core.clearance import Certificate, Safety, hold_until_safe
from fiber_core.focal_plane import FocalPlane
from fiber_core.outcomes import Reason
from fiber_core.wire_units import WireMotion, WireUnits

__all__ = ["LoadedPlan", "Loader"]

_ROUNDS = 6  # fresh sequence numbers tried on a bus before nothing is started
_TRIES = 2  # deliveries of an order under one sequence number


@dataclass(frozen=True, eq=False)
class LoadedPlan:
    """What an upload came to.

    Args:
        started: robots that were told to go, shape (n,).
        reason: why the others that had orders were not, Reason, shape (n,).
        sequence: sequence number of each robot's order, shape (n,).
        loaded: the LOAD frames of those that were started, in the order of their rows.
        motion: the motion decoded from these bytes, and certified.
        certificate: its certificate.
        go_s: when the GO was complete [s].
        start_s: when the robots begin to move, at the end of the countdown [s].
        watch: the watch over those that were started, None if nobody was.
    """

    started: np.ndarray
    reason: np.ndarray
    sequence: np.ndarray
    loaded: Frames
    motion: WireMotion
    certificate: Certificate
    go_s: float
    start_s: float
    watch: MotionMonitor | None = None


class Loader:
    """LOAD, VERIFY, certify, GO.

    GO reaches a whole bus and starts whatever is loaded there under its sequence number.
    So a robot that may hold such an order though it must not move (it did not verify, or
    it is unsafe and could not be given an empty order instead) takes its bus to a fresh
    sequence number: the others are loaded again, and the GO means nothing to it. A robot
    that does not count down after the GO stops everybody before anyone has moved, and the
    others are loaded again without it.

    Args:
        plane: the focal plane.
        units: tick, quantum and widths.
        safety: clearance asked of what is started.
        link: the wire.
        pairs: who can touch whom, rows as from neighbour_pairs, shape (p, 2).
        starter: how those that are loaded are told to go.
    """

    def __init__(
        self,
        plane: FocalPlane,
        units: WireUnits,
        safety: Safety,
        link: Transactions,
        pairs: np.ndarray,
        starter: StartStop,
    ):
        self.plane, self.units, self.safety, self.link, self.pairs = (
            plane, units, safety, link, pairs
        )  # fmt: skip
        self._starter = starter
        self._bus = np.searchsorted(link.buses, link.addresses.bus)
        self._sequence = np.zeros(len(link.buses), dtype=np.int64)
        self._look_s = 0.0  # what it takes to VERIFY all

    def run(
        self,
        motion: WireMotion,
        wanted,
        known,
        boot,
        lost,
        t: float,
        may_go: Callable[[], bool] = lambda: True,
    ) -> LoadedPlan:
        """Load, verify and certify orders, and start what is certified.

        Args:
            motion: orders of every robot, from where its encoders are.
            wanted: robots that shall move, shape (n,).
            known: robots that can be commanded, shape (n,).
            boot: boot counters at configuration, shape (n,).
            lost: robots whose position is not known: whoever could touch them rests, (n,).
            t: not before this time [s].
            may_go: asked when everything is certified; False drops all orders instead.
        """
        reason = np.zeros(self.plane.n, dtype=np.int64)
        blocked = wanted & (self._beside(lost) | lost)
        reason[blocked] = Reason.UNSAFE_AS_LOADED
        wanted = wanted & ~blocked
        motion = _only(motion, wanted)
        verified, self._look_s = np.zeros_like(wanted), 0.0
        stale = np.ones(len(self.link.buses), dtype=bool)  # buses that need a fresh sequence
        late = np.zeros_like(wanted)  # whose bus the GO has once reached too late
        for _ in range(_ROUNDS):
            verified &= ~stale[self._bus]
            self._sequence = np.where(stale, self._sequence % 15 + 1, self._sequence)
            todo = np.flatnonzero(wanted & stale[self._bus])
            # on the other buses these are, byte for byte, the frames already verified there
            frames = self._encode(motion)
            delivered = self._deliver(todo, frames[todo], boot, t)
            verified[todo] = delivered.verified
            reason[todo] = delivered.reason
            wanted &= reason == Reason.OK
            # where nobody will be told to go, it does not matter what is loaded
            stale = self._buses_of(todo[delivered.suspect]) & self._buses_of(wanted)
            if stale.any():
                continue
            loaded = self._decode(motion, frames, verified)
            certificate, held = self._certify(loaded)
            held = held & verified
            if held.any():
                reason[held] = Reason.UNSAFE_AS_LOADED
                wanted &= ~held
                verified &= ~held
                stale = self._buses_of(self._disarm(np.flatnonzero(held), boot, t))
                stale &= self._buses_of(wanted)
                if stale.any():
                    continue
                loaded = self._decode(motion, frames, verified)
            if not may_go():
                return self._nothing(motion, frames, wanted, verified, reason, Reason.STOPPED)
            rows = np.flatnonzero(verified)
            begun = self._starter.go(rows, known, self._sequence, boot, self._look_s, t)
            if begun.watch is None and len(rows):
                # nobody has moved, which all have confirmed that are told again; the others, and
                # those that a GO reached too late for the second time, are left out
                missing = begun.missing | (begun.late & late)
                late |= begun.late
                reason[missing] = Reason.NOT_ACKNOWLEDGED
                wanted &= ~missing
                stale[:] = True
                continue
            sequence = self._sequence[self._bus]
            sent = frames[rows]
            if begun.watch is not None:
                begun.watch.moves_until_s = begun.start_s + loaded.decoded().makespan_s
            return LoadedPlan(verified, reason, sequence, sent, loaded, certificate, *begun[:3])
        return self._nothing(motion, frames, wanted, verified, reason, Reason.STOPPED)

    def _nothing(self, motion, frames, wanted, verified, reason, why):
        """Drop what was loaded: nobody is started."""
        reason[wanted] = why
        self.link.command(Opcode.CLEAR, np.flatnonzero(verified), self.link.now_s)
        nobody = np.zeros_like(wanted)
        loaded = self._decode(motion, frames, nobody)
        certificate, _ = self._certify(loaded)
        sequence = self._sequence[self._bus]
        sent = frames[np.flatnonzero(nobody)]
        now_s = self.link.now_s
        return LoadedPlan(nobody, reason, sequence, sent, loaded, certificate, now_s, now_s)

    def _beside(self, lost):
        """Robots in a pair with a lost one, shape (n,)."""
        pairs = self.pairs[(self.pairs < self.plane.n).all(axis=1)]
        beside = np.zeros(self.plane.n, dtype=bool)
        beside[pairs[lost[pairs[:, 1]], 0]] = True
        beside[pairs[lost[pairs[:, 0]], 1]] = True
        return beside

    def _buses_of(self, robots):
        """Buses, a mask, of some robots, by rows or mask."""
        return np.isin(np.arange(len(self.link.buses)), self._bus[robots])

    def _encode(self, motion):
        return encode_load(
            self.units, self.link.addresses, self._sequence[self._bus],
            motion.offsets, motion.ticks, motion.velocity,
        )  # fmt: skip

    def _decode(self, motion, frames, chosen):
        """The motion in the bytes sent to the chosen robots; everybody else rests."""
        orders = decode_load(self.units, frames)
        whole = WireMotion(self.units, motion.start, orders.offsets, orders.ticks, orders.velocity)
        return _only(whole, chosen)

    def _deliver(self, rows, frames, boot, t):
        """LOAD and VERIFY, and both once more for those it failed with by chance."""
        verified, suspect = np.zeros(len(rows), dtype=bool), np.ones(len(rows), dtype=bool)
        ack = np.full(len(rows), Ack.NO_ADDRESS, dtype=np.int64)
        todo = np.arange(len(rows))
        for _ in range(_TRIES):
            again = self.link.send(rows[todo], frames[todo], t)
            ack[todo] = np.where(again == Ack.NO_ADDRESS, ack[todo], again)
            begin_s = max(t, self.link.now_s)
            status = self.link.statuses(rows[todo], t, whole=False)
            self._look_s = max(self._look_s, self.link.now_s - begin_s)
            sent = decode_load(self.units, frames[todo])
            loaded = (status.state == RobotState.LOADED) & (status.sequence == sent.sequence)
            same = (status.order_crc == sent.crc) & (status.boot == boot[rows[todo]])
            verified[todo] = status.ok & loaded & same
            suspect[todo] = ~verified[todo] & (~status.ok | loaded)
            # another boot, a refusal it stands by, or an absence will not change
            stands = status.ok & (status.boot != boot[rows[todo]]) | (again == Ack.REFUSED)
            stands |= (again == Ack.NO_ADDRESS) & ~status.ok
            todo = todo[~verified[todo] & ~stands]
        unverified = np.where(ack == Ack.REFUSED, Reason.REFUSED, Reason.NOT_VERIFIED)
        unverified[ack == Ack.NO_ADDRESS] = Reason.NOT_ACKNOWLEDGED
        return _Delivery(verified, suspect, np.where(verified, Reason.OK, unverified))

    def _certify(self, loaded):
        """The certificate of what remains when unsafe robots are held, and who they are."""
        motion, held, certificate = hold_until_safe(self.plane, loaded.decoded(), self.safety)
        # two robots at rest may stand too close; whoever moves may not be one of them
        wrong = certificate.unsafe_robots | certificate.limits_broken | certificate.moved_disabled
        if (wrong & (motion.counts > 0).any(axis=1)).any():
            held = np.ones(self.plane.n, dtype=bool)
        return certificate, held

    def _disarm(self, rows, boot, t):
        """Overwrite orders with empty ones; return the robots that may still hold theirs."""
        nothing = encode_load(
            self.units, self.link.addresses[rows], self._sequence[self._bus[rows]],
            np.zeros(2 * len(rows) + 1), [], [],
        )  # fmt: skip
        return rows[self._deliver(rows, nothing, boot, t).suspect]


@dataclass(frozen=True, eq=False)
class _Delivery:
    verified: np.ndarray
    suspect: np.ndarray  # may hold an order under this sequence number that is not the one sent
    reason: np.ndarray


def _only(motion, chosen):
    """The same orders for the chosen robots, none for the others."""
    counts = np.diff(motion.offsets) * np.repeat(chosen, 2)
    keep = np.repeat(np.repeat(chosen, 2), np.diff(motion.offsets))
    offsets = np.concatenate([[0], np.cumsum(counts)])
    ticks, velocity = motion.ticks[keep], motion.velocity[keep]
    return WireMotion(motion.units, motion.start, offsets, ticks, velocity)
