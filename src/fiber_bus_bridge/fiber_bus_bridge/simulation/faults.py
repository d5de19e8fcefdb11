# SPDX-License-Identifier: Apache-2.0
"""Faults of buses and robots over time: a schedule drawn from a seed."""

from collections.abc import Iterable
from dataclasses import dataclass, field
from enum import IntEnum
from typing import TypeAlias

import numpy as np

from fiber_bus_bridge.bus.recovery import Recovery
from fiber_bus_bridge.simulation.events import EVENT, Event, Events
from fiber_core.array_types import Ints

__all__ = ["FaultKind", "Faults", "LineFault", "LineTrouble", "Noise", "Stretch", "draw_faults"]

FOREVER = np.inf


class LineFault(IntEnum):
    """A fault of the lines of a bus, for a period of time."""

    SDA_LOW = 1  # no START can be made
    SCL_LOW = 2  # no clock can be made
    BABBLE = 3  # another talker never stops: every arbitration is lost


class FaultKind(IntEnum):
    """The kinds of faults from which a campaign is drawn."""

    SDA_STUCK = 1
    SCL_STUCK = 2
    BABBLE = 3
    NOISE = 4
    ABSENT = 5
    DEAF_TO_CALLS = 6
    BUSY = 7
    RESET = 8
    BROWN_OUT = 9
    STRETCH = 10
    MEMORY = 11
    ADDRESS = 12
    STALL = 13
    STUCK_JOINT = 14
    ARBITRATION = 15


LineTrouble: TypeAlias = tuple[LineFault, int, float, float, Recovery]
Noise: TypeAlias = tuple[int, float, float, float]
Stretch: TypeAlias = tuple[int, float, float, float]


@dataclass(frozen=True)
class Faults:
    """A schedule of faults.

    Args:
        lines: (LineFault, bus, from [s], until [s], Recovery) of each fault of a line; the
            recovery is the weakest that frees the line.
        noise: (bus, from [s], until [s], probability of a wrong bit) of each noisy period.
        stretches: (row, from [s], until [s], longer [s]) of each period in which a robot stretches
            the clock of every message by a time.
        events: events of robots, records of EVENT.
    """

    lines: tuple[LineTrouble, ...] = ()
    noise: tuple[Noise, ...] = ()
    stretches: tuple[Stretch, ...] = ()
    events: Events = field(default_factory=lambda: np.zeros(0, dtype=EVENT))


def draw_faults(
    kinds: Iterable[FaultKind],
    bus: Ints,
    address: Ints,
    until_s: float,
    rng: np.random.Generator,
    from_s: float = 0.0,
) -> Faults:
    """Draw one fault of each given kind, at a random time, bus and robot.

    Args:
        kinds: kinds of faults; a kind may be repeated.
        bus: bus of each robot, shape (n,).
        address: address of each robot, shape (n,).
        until_s: every fault begins before this time [s].
        rng: source of randomness.
        from_s: no fault begins before this time [s].
    """
    lines: list[LineTrouble] = []
    noise: list[Noise] = []
    stretches: list[Stretch] = []
    events: list[tuple[int, float, int, int]] = []
    for kind in kinds:
        # early faults are more frequent: they meet configuration, LOAD, VERIFY and GO
        at, lasts = from_s + (until_s - from_s) * rng.random() ** 3, 10 ** rng.uniform(-4, 1)
        row = int(rng.integers(len(bus)))
        until = at + lasts if rng.random() < 0.7 else FOREVER
        if kind in _LINES:
            recovery = Recovery(rng.choice(_LINES[kind]))
            lines.append((LineFault(_LINE_OF[kind]), int(bus[row]), at, until, recovery))
        elif kind == FaultKind.ARBITRATION:
            end = at + min(lasts, 3e-3)
            lines.append((LineFault.BABBLE, int(bus[row]), at, end, Recovery.NOTHING))
        elif kind == FaultKind.NOISE:
            noise.append((int(bus[row]), at, until, 10 ** rng.uniform(-5, -2)))
        elif kind == FaultKind.STRETCH:
            stretches.append((row, at, until, 10 ** rng.uniform(-5, -1)))
        elif kind in _SWITCHES:
            events += [(row, at, _SWITCHES[kind], 1), (row, until, _SWITCHES[kind], 0)]
        elif kind in (FaultKind.RESET, FaultKind.BROWN_OUT):
            back = at + (2e-3 if kind == FaultKind.RESET else lasts)
            events += [(row, at, Event.POWER, 0), (row, back, Event.POWER, 1)]
        elif kind == FaultKind.MEMORY:
            events.append((row, at, Event.FLIP, int(rng.integers(1000))))
        elif kind == FaultKind.ADDRESS:
            # to a free address, or to that of another robot, whose replies it then disturbs
            same = np.flatnonzero(bus == bus[row])
            new = address[rng.choice(same)] if rng.random() < 0.5 else address[same].max() + 1
            events.append((row, at, Event.MOVE_ADDRESS, int(new)))
        else:
            joint = Event.JAM_THETA if rng.random() < 0.5 else Event.JAM_PHI
            events.append((row, at if kind == FaultKind.STALL else 0.0, joint, 1))
    return Faults(tuple(lines), tuple(noise), tuple(stretches), np.array(events, dtype=EVENT))


_LINES = {
    FaultKind.SDA_STUCK: (Recovery.CLOCKS, Recovery.RESET, Recovery.POWER, Recovery.NOTHING),
    FaultKind.SCL_STUCK: (Recovery.RESET, Recovery.POWER, Recovery.NOTHING),
    FaultKind.BABBLE: (Recovery.POWER, Recovery.NOTHING),
}
_LINE_OF = {
    FaultKind.SDA_STUCK: LineFault.SDA_LOW,
    FaultKind.SCL_STUCK: LineFault.SCL_LOW,
    FaultKind.BABBLE: LineFault.BABBLE,
}
_SWITCHES = {
    FaultKind.ABSENT: Event.DEAF,
    FaultKind.DEAF_TO_CALLS: Event.CALL_DEAF,
    FaultKind.BUSY: Event.BUSY,
}
