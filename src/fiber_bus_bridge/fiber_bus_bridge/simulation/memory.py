"""What positioners remember: a table with one record per robot."""

import numpy as np

from fiber_bus_bridge.wire import MAX_SEGMENTS, Addresses, RobotState

__all__ = ["MEMORY", "NOTHING", "ORDER_BYTES", "new_memory"]

NOTHING = 255  # no sequence number
ORDER_BYTES = 4 + 2 * MAX_SEGMENTS * 4  # longest LOAD frame: 32-bit segments

# Orders are kept as the bytes that came, so that the checksum in a status is one of what
# is stored; they are decoded when they are started.
MEMORY = np.dtype(
    [
        # how it is built
        ("address", "i8"),
        ("ten_bit", "?"),
        ("serial", "i8"),
        ("quantum_prad", "i8"),
        ("clock_ppm", "f8"),
        ("start_skew_s", "f8"),
        # what is wrong with it
        ("jam_s", "f8", (2,)),  # from when on a joint does not turn any more [s]
        ("deaf", "?"),  # hears nothing
        ("call_deaf", "?"),  # hears no general call
        ("busy", "?"),  # takes nothing
        ("powered", "?"),
        ("boots_until_s", "f8"),  # it hears nothing before [s]
        # what survives a power cut
        ("position", "i8", (2,)),  # encoders at rest, or where the motion began [quanta]
        ("boot", "i8"),
        # what does not
        ("state", "i8"),
        ("fault", "i8"),
        ("alerts", "i8"),
        ("alert_s", "f8"),  # from when on it pulls the alert line, until it is read or cleared [s]
        ("asked_identity", "?"),
        ("tick_us", "i8"),
        ("velocity_bits", "i8"),
        ("duration_bits", "i8"),
        ("limits", "i8", (2, 2)),  # [quanta]
        ("speed", "i8", (2,)),  # [velocity units]
        ("watchdog_s", "f8"),
        ("silence_s", "f8"),  # longest time between two beats while moving, 0 for ever [s]
        ("sequence", "i8"),
        ("executed", "i8"),  # sequence of the order started last, or NOTHING
        ("order", "u1", (ORDER_BYTES,)),
        ("order_length", "i8"),
        ("loaded_s", "f8"),  # when the order was stored [s]
        ("started_s", "f8"),  # when its motion began, or will after the countdown [s]
        ("beat_s", "f8"),  # when it heard the last beat [s]
        ("halted_s", "f8"),  # when its last motion ended [s]
        ("counts", "i8", (2,)),  # segments of the running order
        ("ticks", "i8", (2, MAX_SEGMENTS)),
        ("velocity", "i8", (2, MAX_SEGMENTS)),
    ],
    align=True,
)


def new_memory(
    addresses: Addresses, serial, quantum_prad: int, position, clock_ppm, start_skew_s
) -> np.ndarray:
    """Return the memory of robots that have just been switched on for the first time."""
    memory = np.zeros(len(addresses), dtype=MEMORY)
    memory["address"] = addresses.address
    memory["ten_bit"] = addresses.ten_bit
    memory["serial"] = serial
    memory["quantum_prad"] = quantum_prad
    memory["clock_ppm"] = clock_ppm
    memory["start_skew_s"] = start_skew_s
    memory["position"] = position
    memory["jam_s"] = np.inf
    memory["powered"] = True
    memory["alert_s"] = np.inf
    memory["started_s"] = memory["halted_s"] = memory["boots_until_s"] = -np.inf
    memory["boot"] = 1
    memory["state"] = RobotState.UNCONFIGURED
    memory["executed"] = NOTHING
    return memory
