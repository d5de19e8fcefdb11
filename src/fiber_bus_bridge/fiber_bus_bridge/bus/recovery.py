# SPDX-License-Identifier: Apache-2.0
"""Ways to free the lines of a stuck bus."""

from enum import IntEnum

__all__ = ["Recovery"]


class Recovery(IntEnum):
    """Actions that free a line, in increasing strength."""

    CLOCKS = 1  # nine clocks and a STOP: the target that holds SDA low releases it
    RESET = 2  # reset of the controller and of the buffers of the branch
    POWER = 3  # power cycle of the branch: its robots boot
    NOTHING = 4  # no action frees the line
