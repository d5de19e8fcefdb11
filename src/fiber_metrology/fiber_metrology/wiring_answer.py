# SPDX-License-Identifier: Apache-2.0
"""The answer of images of code words: which robot each order moves, or why it is not told."""

from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from fiber_core.array_types import Codes, Floats, Ints, Mask, Points
from fiber_core.focal_plane import FocalPlane

__all__ = ["Wiring", "WiringVerdict"]


class WiringVerdict(IntEnum):
    """What the images say about the robot that an order is for."""

    IN_PLACE = 0  # it moves a light about its own axis
    SWAPPED = 1  # it moves a light about the axis of another robot
    NOT_SEEN = 2  # no light moves by its word: see `Wiring.resting`
    AMBIGUOUS = 3  # a light may move by its word, and what is true of it is not certain
    REVERSED = 4  # it turns phi of a robot the other way
    OTHER_JOINT = 5  # its orders of phi turn theta of a robot
    NOT_TURNED = 6  # it made no word, so that nothing is told


_HOW = {
    WiringVerdict.REVERSED: "orders turn phi the other way",
    WiringVerdict.OTHER_JOINT: "orders of phi turn theta",
}


@dataclass(frozen=True, eq=False)
class Wiring:
    """Which robot each order moves.

    Args:
        verdict: WiringVerdict of each robot, shape (n,).
        at: row of the robot about whose axis the light moves, -1 where none is told, shape (n,).
        places: place of the light, at the middle of its turns [mm], shape (n, 2), nan where none is
            told.
        doubt: probability of anything else, shape (n,); 1 for a robot that moves several lights, or
            one in a way that none explains, or an arm that another robot may move too.
        lights: number of lights that move by the word of each robot, shape (n,); a faint movement
            is not counted.
        resting: whether a light that moves by no word is in the reach of each robot, shape (n,):
            where no light follows a robot and none rests, the fibre that its orders move is dark,
            or of another robot; where one rests, a joint may be stuck, or the robot not answer.
    """

    verdict: Codes
    at: Ints
    places: Points
    doubt: Floats
    lights: Ints
    resting: Mask

    def lines(self, plane: FocalPlane) -> list[str]:
        """Return a line for each robot that is not at its place, with its doubt."""
        ids, told = plane.ids, []
        for row in np.flatnonzero(self.verdict != WiringVerdict.IN_PLACE):
            doubt, at = f"doubt {self.doubt[row]:.1e}", self.at[row]
            if self.verdict[row] == WiringVerdict.SWAPPED:
                how = "these two" if self.at[at] == row else "three robots or more"
                how += " are swapped"
                text = f"orders move the fibre at the place of robot {ids[at]}: {how}, {doubt}"
            elif self.verdict[row] in _HOW:
                text = f"{_HOW[self.verdict[row]]} of robot {ids[at]}, {doubt}"
            elif self.verdict[row] == WiringVerdict.NOT_TURNED:
                text = "did not turn, nothing is told"
            elif self.verdict[row] == WiringVerdict.NOT_SEEN:
                text = "no light moves by its orders, "
                text += f"{'one' if self.resting[row] else 'none'} rests in its reach"
            elif self.lights[row] > 1:
                text = f"ambiguous, {self.lights[row]} lights move by its orders"
            elif self.doubt[row] >= 1.0:
                text = "ambiguous, what moves by its orders or near there is not explained"
            else:
                text = f"ambiguous, {doubt}"
            told.append(f"robot {ids[row]}: {text}")
        return told

    def columns(self, plane: FocalPlane) -> dict[str, NDArray]:
        """Return the columns of a table with a row for each robot."""
        at = np.where(self.at >= 0, plane.ids[np.maximum(self.at, 0)], -1)
        return {
            "id": plane.ids,
            "verdict": np.array([WiringVerdict(code).name.lower() for code in self.verdict]),
            "at_id": np.array([str(robot) if robot >= 0 else "" for robot in at]),
            "x_mm": self.places[:, 0],
            "y_mm": self.places[:, 1],
            "doubt": self.doubt,
            "resting_light": self.resting.astype(np.int64),
        }

    def counts(self) -> dict[str, int]:
        """Return the number of robots with each verdict, by its name."""
        return {v.name.lower(): int(np.count_nonzero(self.verdict == v)) for v in WiringVerdict}
