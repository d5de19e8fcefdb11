"""How the lines of a bus that is stuck are freed."""

from enum import IntEnum

__all__ = ["Recovery"]


class Recovery(IntEnum):
    """What frees a line, each stronger than the one before."""

    CLOCKS = 1  # nine clocks and a STOP: whoever holds SDA lets go
    RESET = 2  # reset of the controller and of the buffers of the branch
    POWER = 3  # power cycle of the branch: its robots boot
    NOTHING = 4
