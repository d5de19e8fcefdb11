# SPDX-License-Identifier: Apache-2.0
"""Hosts with clocks and a network between them, simulated: the agreement of sectors under faults.

Messages are lost, late, doubled and out of order; hosts are cut off and killed; clocks drift and
jump. Robots are not simulated one by one: of a sector it is known when its robots begin to move and
when they rest. Not modelled: the time that a process takes to decide, beyond its period.
"""

import heapq
import math
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from fiber_sectors.conductor import Conductor, Step
from fiber_sectors.errors import SectorError
from fiber_sectors.member import Decision, Member
from fiber_sectors.messages import (
    Stage,
    decode_beat,
    decode_report,
    encode_beat,
    encode_report,
)
from fiber_sectors.terms import Terms

__all__ = ["Host", "Network", "Plane", "run", "violations"]

_STEP_S = 2.5e-3  # between two decisions of a sector
_AHEAD_S = 10e-3  # before the start: after it a STOP may come too late
_SILENCE_S = 5e-3  # robots without heartbeats stop by themselves
_POLL_S = 15e-3  # in which a sector polls its robots after the GO
_INSTANT_S = 1e-8  # no two reports have one time
_EXTRA_S = 40e-3  # of a countdown, for the exchange of confirmations
COORDINATOR = -1


@dataclass(frozen=True)
class Host:
    """What happens to one host; times are true ones [s].

    Args:
        ahead_s: how far its clock is ahead at time 0 [s].
        rate_ppm: how much faster its clock is [1e-6].
        jump_at_s: when its clock jumps; inf for never.
        jump_s: by how much [s].
        killed_at_s: when its process is killed.
        fails_at_s: when a robot of this sector fails.
        wakes_at_s: when it decides for the first time, after the others in the order of hosts [s].
    """

    ahead_s: float = 0.0
    rate_ppm: float = 0.0
    jump_at_s: float = math.inf
    jump_s: float = 0.0
    killed_at_s: float = math.inf
    fails_at_s: float = math.inf
    wakes_at_s: float = 0.0

    def clock(self, t: float) -> float:
        """Return the time of its clock at a true time [s]."""
        jumped_s = self.jump_s if t >= self.jump_at_s else 0.0
        return self.ahead_s + t * (1.0 + 1e-6 * self.rate_ppm) + jumped_s


@dataclass(frozen=True)
class Network:
    """The fate of messages.

    Args:
        delays_s: called with the sender, the receiver (-1 is the coordinator), the number of the
            message and the time; returns the delay of each copy that arrives [s].
    """

    delays_s: Callable[[int, int, int, float], list[float]] = lambda *_: [2e-4]

    @classmethod
    def bad(
        cls,
        rng: np.random.Generator,
        loss: float = 0.0,
        jitter_s: float = 0.0,
        doubled: float = 0.0,
        cut: tuple[int, float, float] | None = None,
    ) -> "Network":
        """Return a network with random faults.

        Args:
            rng: source of the faults.
            loss: probability that a message is lost.
            jitter_s: mean of the delays beyond 0.2 ms, exponential [s].
            doubled: probability that a message arrives twice.
            cut: a sector that is cut off, from a time until another [s].
        """

        def delays_s(sender: int, receiver: int, number: int, t: float) -> list[float]:
            if cut is not None and cut[0] in (sender, receiver) and cut[1] <= t < cut[2]:
                return []
            if rng.random() < loss:
                return []
            copies = 2 if rng.random() < doubled else 1
            return [2e-4 + float(rng.exponential(jitter_s)) for _ in range(copies)]

        return cls(delays_s)


@dataclass
class Plane:
    """What really happened to the sectors of a plane; times are true ones [s].

    Args:
        terms: the times on which all agreed.
        starts_s: when the robots of each sector began to move; nan if they did not.
        rests_s: when they rested again; when they were stopped in the countdown.
        complete: whether a sector moved to the end of its orders.
        counted: sectors that had confirmed when the first robot moved.
        step: how far the coordinator was at the end.
        why: why the run was stopped.
        stop_s: from the decision of the coordinator to the rest of the last robot [s].
        bound_s: largest difference between starts as the coordinator stated it [s].
    """

    terms: Terms
    starts_s: list[float]
    rests_s: list[float]
    complete: list[bool]
    counted: int = 0
    step: Step = Step.LOADING
    why: str = ""
    stop_s: float = math.nan
    bound_s: float = 0.0
    stages: list[Stage] = field(default_factory=list)


class _Sector:
    # A sector whose robots are one body; `wake` is called every step of its host.

    def __init__(self, number: int, host: Host, terms: Terms, loads_s: float, lasts_s: float):
        self.host = host
        self.member = Member(number, number + 1, terms)
        self._loads_s, self._lasts_s, self._notice_s = loads_s, lasts_s, terms.notice_s
        self.start_s = self.confirms_s = self.rest_s = math.inf
        self.told_s = -math.inf
        self.stopped = False

    def wake(self, t: float) -> None:
        member, now_s = self.member, self.host.clock(t)
        if t >= self.host.fails_at_s and not self.stopped and member.stage is not Stage.ENDED:
            self._rest(self.host.fails_at_s)
            member.stopped("a robot has failed")
        decision = member.decide(now_s)
        if decision is Decision.STOP and not self.stopped:
            self._rest(t + self._notice_s)
            member.stopped(member.why)
        elif member.stage is Stage.LOADING and t >= self._loads_s:
            member.ready()
        elif decision is Decision.GO and math.isinf(self.start_s):
            self.start_s, self.confirms_s = t + member.start_s - now_s, t + _POLL_S
            if self.start_s < t + _POLL_S + _AHEAD_S:
                self.start_s = math.inf
                self._rest(t)
                member.stopped("the start is too soon")
        elif member.stage is Stage.READY and t >= self.confirms_s:
            start_s = now_s + self.start_s - t
            member.confirmed(start_s, start_s - _AHEAD_S, now_s)
        elif t >= self.start_s + self._lasts_s and not self.stopped:
            self.rest_s = self.start_s + self._lasts_s
            member.ended()

    def _rest(self, t: float) -> None:
        self.stopped, self.rest_s = True, t

    def outcome(self) -> tuple[float, float, bool]:
        """When the robots began to move, when they rested, whether they arrived."""
        end_s, rest_s = self.start_s + self._lasts_s, self.rest_s
        # nothing sends heartbeats on a host that was killed
        if self.host.killed_at_s < rest_s:
            rest_s = min(rest_s, self.host.killed_at_s + _SILENCE_S)
        moved = self.start_s < min(rest_s, math.inf)
        complete = moved and rest_s >= end_s
        return (self.start_s if moved else math.nan), min(rest_s, end_s), complete


class _World:
    # Hosts, messages on their way, and true time.

    def __init__(
        self,
        terms: Terms,
        hosts: list[Host],
        network: Network,
        coordinator: Host,
        loads_s: float,
        lasts_s: float,
    ):
        self._terms, self._network = terms, network
        self._own, self._hosts = coordinator, hosts
        self.sectors = [_Sector(k, host, terms, loads_s, lasts_s) for k, host in enumerate(hosts)]
        self.conductor = Conductor(len(hosts), terms)
        self._events: list[tuple[float, int, int, bytes]] = []
        self._pushed = self._sent = self.counted = 0
        self.stop_at_s = math.nan
        self.conductor.begin(1, coordinator.clock(0.0))
        self._push(0.0, COORDINATOR)
        for k, each in enumerate(self.sectors):
            each.member.begin(1, each.host.clock(0.0))
            self._push(each.host.wakes_at_s + 1e-4 * (k + 1), k)

    def _push(self, t: float, to: int, data: bytes = b"") -> None:
        self._pushed += 1
        heapq.heappush(self._events, (t, self._pushed, to, data))

    def _send(self, t: float, sender: int, to: int, data: bytes) -> None:
        self._sent += 1
        for delay_s in self._network.delays_s(sender, to, self._sent, t):
            self._push(t + delay_s, to, data)

    def run(self, until_s: float) -> None:
        while self._events and self._events[0][0] < until_s and not self._over:
            t, _, to, data = heapq.heappop(self._events)
            host = self._own if to == COORDINATOR else self._hosts[to]
            if t >= host.killed_at_s:
                continue
            if to == COORDINATOR:
                self._conduct(t, data)
            else:
                self._wake(t, to, data)
            if not self.counted and any(t >= each.start_s for each in self.sectors):
                self.counted = sum(not math.isnan(s.member.start_s) for s in self.sectors)

    @property
    def _over(self) -> bool:
        t = self._events[0][0]
        rest = all(s.member.stage in (Stage.ENDED, Stage.STOPPED) for s in self.sectors)
        rest &= all(s.rest_s <= t for s in self.sectors if math.isfinite(s.start_s))
        return rest and self.conductor.step is Step.OVER

    def _conduct(self, t: float, data: bytes) -> None:
        conductor, now_s = self.conductor, self._own.clock(t)
        if data:
            conductor.hear(decode_report(data), now_s)
            return
        if conductor.ready:
            try:
                conductor.go(now_s + _POLL_S + _AHEAD_S + _EXTRA_S, _AHEAD_S, now_s)
            except SectorError:
                pass  # the clocks are not known yet
        beat = encode_beat(conductor.beat(now_s))
        if math.isnan(self.stop_at_s) and conductor.step is Step.STOPPING:
            self.stop_at_s = t
        for k in range(len(self._hosts)):
            self._send(t, COORDINATOR, k, beat)
        self._push(t + self._terms.period_s, COORDINATOR)

    def _wake(self, t: float, k: int, data: bytes) -> None:
        sector, now_s = self.sectors[k], self._hosts[k].clock(t)
        member, stage = sector.member, sector.member.stage
        if data:
            member.hear(decode_beat(data), now_s)
        else:
            sector.wake(t)
            self._push(t + _STEP_S, k)
        if data or member.stage is not stage:
            sector.told_s = max(now_s, sector.told_s + _INSTANT_S)
            self._send(t, k, COORDINATOR, encode_report(member.report(sector.told_s)))


def run(
    terms: Terms,
    hosts: list[Host],
    network: Network,
    coordinator: Host | None = None,
    loads_s: float = 20e-3,
    lasts_s: float = 0.15,
    until_s: float = 3.0,
) -> Plane:
    """Carry out one run of a plane; return what really happened.

    Args:
        terms: the times on which all agree.
        hosts: the host of each sector.
        network: the fate of messages.
        coordinator: the host of the coordinator.
        loads_s: time at which the sectors have loaded [s].
        lasts_s: duration of the motion [s].
        until_s: time at which the simulation ends [s].
    """
    world = _World(terms, hosts, network, coordinator or Host(), loads_s, lasts_s)
    world.run(until_s)
    conductor, sectors = world.conductor, world.sectors
    starts_s, rests_s, complete = (list(each) for each in zip(*(s.outcome() for s in sectors)))
    rest_s = max((r for s, r in zip(starts_s, rests_s) if not math.isnan(s)), default=math.nan)
    return Plane(
        terms, starts_s, rests_s, complete, world.counted, conductor.step, conductor.why,
        rest_s - world.stop_at_s, conductor.start_skew_bound_s, [s.member.stage for s in sectors],
    )  # fmt: skip


def violations(plane: Plane) -> list[str]:
    """Return which promises were broken: start and stop within their skews, and an end."""
    found: list[str] = []
    terms, starts_s = plane.terms, plane.starts_s
    moved = [k for k, start_s in enumerate(starts_s) if not math.isnan(start_s)]
    if moved:
        skew_s = max(starts_s[k] for k in moved) - min(starts_s[k] for k in moved)
        if skew_s > terms.start_skew_s + 1e-9:
            found.append(f"starts {1e3 * skew_s:.3f} ms apart")
        if plane.counted < len(starts_s):
            found.append(f"moved when {plane.counted} of {len(starts_s)} had confirmed")
        first_s = min(starts_s[k] for k in moved)
        for k in range(len(starts_s)):
            if plane.complete[k]:
                continue
            # a sector that did not move stands still from the start on
            still_s = max(plane.rests_s[k], first_s) if k in moved else first_s
            late_s = max(plane.rests_s[j] for j in moved) - still_s
            if late_s > terms.stop_skew_s + 1e-9:
                found.append(f"a sector moves {1e3 * late_s:.2f} ms longer than sector {k}")
    if plane.step is not Step.OVER:
        found.append(f"the run has not ended: {plane.step.value}")
    return found
