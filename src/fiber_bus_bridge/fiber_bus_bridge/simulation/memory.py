# SPDX-License-Identifier: Apache-2.0
"""Memory of the simulated positioners: a table with one record for each robot."""

from typing import Protocol, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fiber_bus_bridge.wire import MAX_SEGMENTS, NO_SLOT, Addresses, Bytes, RobotState
from fiber_bus_bridge.wire.fields import Whole
from fiber_bus_bridge.wire.ramp_block import MOST_RAMP_BYTES
from fiber_bus_bridge.wire.speed_block import MOST_LISTED_BYTES
from fiber_core.array_types import Floats, Ints

__all__ = ["MEMORY", "NOTHING", "ORDER_BYTES", "Memory", "Robot", "new_memory"]

Memory: TypeAlias = NDArray[np.void]

NOTHING = 255  # stands for no sequence number
ORDER_BYTES = 4 + 2 * MAX_SEGMENTS * 4  # longest LOAD frame: 32-bit segments

# Orders are stored as the received bytes, so that the checksum in a status is computed over what
# is stored; an order is decoded when it is started. Of a configuration only the values are stored
# by which the robot works: their checksum is computed as that of a CONFIG with them.
MEMORY = np.dtype(
    [
        # what every frame and heartbeat looks at comes first, in one or two cache lines
        ("powered", "?"),
        ("deaf", "?"),  # receives no frame
        ("call_deaf", "?"),  # receives no general call
        ("busy", "?"),  # refuses every frame
        ("boots_until_s", "f8"),  # the robot receives nothing before this time [s]
        ("state", "i8"),
        ("done_s", "f8"),  # end of the motion unless it is broken off [s]
        ("heartbeat_s", "f8"),  # time of the last heartbeat [s]
        ("silence_s", "f8"),  # longest time between two heartbeats while moving, 0 = no limit [s]
        ("jam_s", "f8", (2,)),  # a joint is jammed from this time on [s], a defect
        ("alert_s", "f8"),  # pulls the alert line from this time on, until read or cleared [s]
        ("started_s", "f8"),  # start of the motion, at the end of the countdown [s]
        ("halted_s", "f8"),  # end of the last motion [s]
        ("watchdog_s", "f8"),
        ("loaded_s", "f8"),  # time at which the order was stored [s]
        # construction
        ("address", "i8"),
        ("ten_bit", "?"),
        ("serial", "i8"),
        ("quantum_prad", "i8"),
        ("coupling", "i8", (2, 2)),  # of motors and joints, zeros of independent joints [GEAR_UNIT]
        ("clock_ppm", "f8"),
        ("start_skew_s", "f8"),
        ("volatile", "?"),  # the encoders read 0 after a boot
        # kept without power, unless volatile
        ("position", "i8", (2,)),  # encoders at rest, or where the motion began [quanta]
        ("boot", "i8"),
        # lost without power
        ("fault", "i8"),
        ("alerts", "i8"),
        ("identity_requested", "?"),
        ("tick_us", "i8"),
        ("velocity_bits", "i8"),
        ("duration_bits", "i8"),
        ("limits", "i8", (2, 2)),  # [quanta]
        ("speed", "i8", (2,)),  # [velocity units]
        ("slot", "i8"),  # in the roll call of its bus
        ("sequence", "i8"),
        ("executed", "i8"),  # sequence number of the order started last, or NOTHING
        ("order_length", "i8"),
        ("order", "u1", (ORDER_BYTES,)),
        ("counts", "i8", (2,)),  # segments of the running order
        ("ticks", "i8", (2, MAX_SEGMENTS)),
        ("velocity", "i8", (2, MAX_SEGMENTS)),
        ("config_crc", "i8"),  # of the CONFIG that was taken last
        ("listed_bytes", "i8"),  # of the list of speeds, 0 without one
        ("listed", "u1", (MOST_LISTED_BYTES,)),  # content of the block SPEEDS
        ("ramp_bytes", "i8"),  # of the ramps, 0 without one
        ("ramps", "u1", (MOST_RAMP_BYTES,)),  # content of the block RAMPS
        ("motor_limits", "i8", (2, 2)),  # of coupled motors [quanta]
        ("motor_speed", "i8", (2,)),  # [MOTOR_SPEED_UNIT]
    ],
    align=True,
)


class Robot(Protocol):
    """One record of MEMORY, as compiled functions read it: fields are attributes."""

    address: int
    ten_bit: bool
    serial: int
    quantum_prad: int
    coupling: Ints
    clock_ppm: float
    start_skew_s: float
    volatile: bool
    jam_s: Floats
    deaf: bool
    call_deaf: bool
    busy: bool
    powered: bool
    boots_until_s: float
    position: Ints
    boot: int
    state: int
    done_s: float
    heartbeat_s: float
    silence_s: float
    fault: int
    alerts: int
    alert_s: float
    identity_requested: bool
    tick_us: Whole
    velocity_bits: Whole
    duration_bits: Whole
    limits: Ints
    speed: Ints
    watchdog_s: float
    slot: Whole
    sequence: Whole
    executed: Whole
    order_length: Whole
    loaded_s: float
    started_s: float
    halted_s: float
    order: Bytes
    counts: Ints
    ticks: Ints
    velocity: Ints
    config_crc: Whole
    listed_bytes: Whole
    listed: Bytes
    ramp_bytes: Whole
    ramps: Bytes
    motor_limits: Ints
    motor_speed: Ints


def new_memory(
    addresses: Addresses,
    serial: ArrayLike,
    quantum_prad: int,
    position: ArrayLike,
    clock_ppm: ArrayLike,
    start_skew_s: ArrayLike,
    coupling: ArrayLike = 0,
    volatile: ArrayLike = False,
) -> Memory:
    """Return the memory of robots in their first boot; arguments as in Positioners."""
    memory = np.zeros(len(addresses), dtype=MEMORY)
    memory["address"] = addresses.address
    memory["ten_bit"] = addresses.ten_bit
    memory["serial"] = serial
    memory["quantum_prad"] = quantum_prad
    memory["coupling"] = coupling
    memory["clock_ppm"] = clock_ppm
    memory["start_skew_s"] = start_skew_s
    memory["volatile"] = volatile
    memory["position"] = position
    memory["jam_s"] = np.inf
    memory["powered"] = True
    memory["alert_s"] = np.inf
    memory["started_s"] = memory["halted_s"] = memory["boots_until_s"] = -np.inf
    memory["boot"] = 1
    memory["slot"] = NO_SLOT
    memory["state"] = RobotState.UNCONFIGURED
    memory["executed"] = NOTHING
    return memory
