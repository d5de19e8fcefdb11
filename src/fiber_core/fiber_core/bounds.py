# SPDX-License-Identifier: Apache-2.0
"""Bounds of input values: what lies outside them is a mistake of unit or a damaged file.

The bounds are far from every instrument that exists. Inside them all loops end and all arrays
fit the memory; a value outside is refused by name where it enters.
"""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

__all__ = [
    "MAX_ANGLE_RAD",
    "MAX_CLOCK_PPM",
    "MAX_COORDINATE_MM",
    "MAX_LENGTH_MM",
    "MAX_LIMIT_RAD",
    "MAX_NUMBER",
    "MAX_ROBOTS",
    "MAX_SKEW_S",
    "MAX_SPEED_RAD_S",
    "MIN_LENGTH_MM",
    "MIN_SPEED_RAD_S",
    "Range",
    "check_number",
    "check_ranges",
]

# Arms, radii, vertices and spacings, to ten metres; the longest arms in use are 17 mm. The
# shortest is a micrometre, as a ratio of lengths must not overflow.
MIN_LENGTH_MM, MAX_LENGTH_MM = 1e-3, 1e4
# Coordinates, to a kilometre; focal planes in use are below 2 m.
MAX_COORDINATE_MM = 1e6
# Joint limits, sixteen turns either way; the widest in use are four turns. A target has two
# configurations for each turn of theta and each of phi, and all of them are stored.
MAX_LIMIT_RAD = 16 * 2 * np.pi
# Joint angles: a joint may stand outside its limits, and a 32-bit encoder still reads it.
MAX_ANGLE_RAD = 2 * MAX_LIMIT_RAD
# Joint speeds. At the highest a joint turns 0.1 rad in the shortest tick of the wire, 10 us; at
# the lowest half a turn takes 36 days, hundreds of times longer than the longest order.
MIN_SPEED_RAD_S, MAX_SPEED_RAD_S = 1e-6, 1e4
# Robots of a plane; the largest that are planned have 32,000.
MAX_ROBOTS = 100_000
# Robot ids, buses and addresses: an id has 32 bits in every message.
MAX_NUMBER = 2**32 - 1
# Error of a clock: a tenth. A crystal has 50 ppm, an RC oscillator 20 000.
MAX_CLOCK_PPM = 1e5
# Differences between the instants at which two robots start or stop.
MAX_SKEW_S = 10.0


def check_number(
    value: object,
    name: str,
    low: float,
    high: float,
    error: type[Exception],
    whole: bool = False,
) -> None:
    """Refuse a value that is not a number in a range.

    Args:
        value: the value of a parameter.
        name: its name, for the message.
        low, high: the range; both ends are in it.
        error: exception to raise.
        whole: whether the value must be a whole number.

    Raises:
        error: the value is not a number, not finite where the range is, or outside the range.
    """
    kind = "a whole number" if whole else "a number"
    is_number = isinstance(value, (int, float, np.integer, np.floating))
    if is_number and not isinstance(value, bool) and low <= value <= high:
        if not whole or value % 1 == 0:
            return
    raise error(f"{name} is {value!r}, expected {kind} from {low:.10g} to {high:.10g}")


class Range(NamedTuple):
    """The values that a setting may have.

    Args:
        low, high: the least and the largest value; both are in the range.
        whole: whether only whole numbers are.
    """

    low: float
    high: float
    whole: bool = False


def check_ranges(config: object, ranges: Mapping[str, Range], error: type[Exception]) -> None:
    """Refuse a dataclass of settings with a value outside its range.

    Args:
        config: the settings.
        ranges: the range of each number, by name of its field; a field whose default is None may
            be None.
        error: exception to raise.

    Raises:
        error: a value is no number, or outside its range; names it.
    """
    for name, (low, high, whole) in ranges.items():
        value = getattr(config, name)
        if value is not None or getattr(type(config), name, 0) is not None:
            check_number(value, name, low, high, error, whole)
