"""What goes wrong on buses and with robots, and when: a schedule drawn from a seed."""

from dataclasses import dataclass, field
from enum import IntEnum

import numpy as np

from fiber_bus_bridge.bus.recovery import Recovery
from fiber_bus_bridge.simulation.events import EVENT, Event

__all__ = ["FaultKind", "Faults", "Line", "draw_faults"]

FOREVER = np.inf


class Line(IntEnum):
    """What is wrong with the lines of a bus for a while."""

    SDA_LOW = 1  # no START can be made
    SCL_LOW = 2  # no clock can be made
    BABBLE = 3  # somebody talks all the time: every arbitration is lost


class FaultKind(IntEnum):
    """The faults a campaign draws from."""

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


@dataclass(frozen=True)
class Faults:
    """Everything that will go wrong.

    Args:
        lines: (Line, bus, from [s], until [s], Recovery) of each trouble with a line.
        noise: (bus, from [s], until [s], chance that a bit is read wrong) of each noisy time.
        stretches: (row, from [s], until [s], longer [s]): how long a robot holds the clock.
        events: what befalls robots, records of EVENT.
    """

    lines: tuple = ()
    noise: tuple = ()
    stretches: tuple = ()
    events: np.ndarray = field(default_factory=lambda: np.zeros(0, dtype=EVENT))


def draw_faults(
    kinds, bus, address, until_s: float, rng: np.random.Generator, from_s: float = 0.0
) -> Faults:
    """Draw one fault of each kind given, at a random time, bus and robot.

    Args:
        kinds: FaultKinds, repeated for more of one.
        bus: bus of each robot, shape (n,).
        address: its address, shape (n,).
        until_s: they begin before this time [s].
        rng: where chance comes from.
        from_s: and from this time on [s].
    """
    lines, noise, stretches, events = [], [], [], []
    for kind in kinds:
        # early ones are more frequent: they meet configuration, LOAD, VERIFY and GO
        at, lasts = from_s + (until_s - from_s) * rng.random() ** 3, 10 ** rng.uniform(-4, 1)
        row = int(rng.integers(len(bus)))
        until = at + lasts if rng.random() < 0.7 else FOREVER
        if kind in _LINES:
            cure = Recovery(rng.choice(_LINES[kind]))
            lines.append((Line(_LINE_OF[kind]), int(bus[row]), at, until, cure))
        elif kind == FaultKind.ARBITRATION:
            lines.append((Line.BABBLE, int(bus[row]), at, at + min(lasts, 3e-3), Recovery.NOTHING))
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
            # to a free address, or to that of another robot, which it then talks over
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
    FaultKind.SDA_STUCK: Line.SDA_LOW,
    FaultKind.SCL_STUCK: Line.SCL_LOW,
    FaultKind.BABBLE: Line.BABBLE,
}
_SWITCHES = {
    FaultKind.ABSENT: Event.DEAF,
    FaultKind.DEAF_TO_CALLS: Event.CALL_DEAF,
    FaultKind.BUSY: Event.BUSY,
}
