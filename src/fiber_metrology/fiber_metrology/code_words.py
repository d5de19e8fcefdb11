# SPDX-License-Identifier: Apache-2.0
"""Code words: which order moves which fibre, told by turns of phi that differ for each robot.

Each robot has a word of as many bits as there are images. In an image phi of the robot is turned
from where it rested, up if the bit is 1 and else down, by so little that no point of an arm moves
by more than half of the margin, or by what test turns have left of it. The lights that move by a
word are those of the robot that was told to make it, wherever they are.

That bounds the movement of arms which kept the margin at rest and of which phi turns as told,
either way. An arm of which theta turns instead may move by more: the lever of theta is longer.

The words are those of the Reed-Muller code of order 2: the values of the quadratic forms
in m bits, at all 2^m points. Any two differ in a quarter of the images (MacWilliams and Sloane
1977, The Theory of Error-Correcting Codes, chapter 13).
"""

from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import ArrayLike

from fiber_core.array_types import Bools, Floats
from fiber_core.clearance import levers_of
from fiber_core.focal_plane import FocalPlane
from fiber_metrology.errors import MetrologyError

__all__ = ["CodeWords", "code_words"]


@dataclass(frozen=True, eq=False)
class CodeWords:
    """What each robot is told before each image.

    Args:
        bits: whether phi is turned up, and not down, shape (n, images).
        turn_rad: the turns of phi down and up, both 0 or more [rad], shape (n, 2); both 0 for a
            robot that may not turn.
    """

    bits: Bools
    turn_rad: Floats

    @property
    def images(self) -> int:
        """Number of images."""
        return self.bits.shape[1]

    @property
    def turned_rad(self) -> Floats:
        """Turn of phi from where it rested, in each image [rad], shape (n, images)."""
        return np.where(self.bits, self.turn_rad[:, 1:], -self.turn_rad[:, :1])


def code_words(
    plane: FocalPlane,
    rng: np.random.Generator,
    images: int = 32,
    margin_mm: float = 0.05,
    *,
    phi_rad: ArrayLike | None = None,
    turn_limit_rad: ArrayLike | None = None,
) -> CodeWords:
    """Draw a word for each robot.

    Until phi is back where it rested, a robot has used up of its turn limits what its words move.

    Args:
        plane: the focal plane.
        rng: source of the words.
        images: 16 or 32; with 16 at most 1000 robots have words of their own.
        margin_mm: gap that the outlines keep before the turns [mm].
        phi_rad: where phi rests by its counter [rad], shape (n,), nan where that tells nothing; no
            turn leads out of the range of phi. None: no turn is shortened.
        turn_limit_rad: how far theta may still turn down and up (decision 46) [rad], shape (n, 2):
            phi moves no point farther than the smaller of both. None: half of the margin is left.

    Raises:
        MetrologyError: there are not so many images, or not so many words as robots; an array has
            another shape, or a limit is negative or not a number.
    """
    if images not in (16, 32):
        raise MetrologyError(f"{images} images: code words have 16 or 32 bits")
    points = (np.arange(images)[:, None] >> np.arange(images.bit_length() - 1)) & 1
    terms = [points[:, a] for a in range(points.shape[1])]
    terms += [points[:, a] * points[:, b] for a, b in combinations(range(points.shape[1]), 2)]
    count = 1 << len(terms)
    # a form and its opposite move a light the same way but for the sign: one of both is used
    chosen = (np.arange(count)[:, None] >> np.arange(len(terms))) & 1
    words = (chosen @ np.array(terms)) % 2
    even = np.abs(2 * words.sum(axis=1) - images) <= images // 4
    words = words[even]
    if len(words) < plane.n:
        raise MetrologyError(
            f"{plane.n} robots have no words of their own: there are {len(words)} of {images} bits"
        )
    bits = words[rng.permutation(len(words))[: plane.n]].astype(bool)
    return CodeWords(bits, _turns(plane, margin_mm, phi_rad, turn_limit_rad))


def _turns(
    plane: FocalPlane, margin_mm: float, phi_rad: ArrayLike | None, turn_limit_rad: ArrayLike | None
) -> Floats:
    """How far phi may turn down and up [rad], shape (n, 2)."""
    theta_mm, phi_mm = levers_of(plane)[:, :2].T
    moved_mm = np.full(plane.n, 0.5 * margin_mm)
    if turn_limit_rad is not None:
        limit = _of_robots(plane, "turn_limit_rad", turn_limit_rad, (plane.n, 2))
        bad = np.flatnonzero(~(limit >= 0.0).all(axis=1))
        if len(bad):
            robot, value = plane.ids[bad[0]], limit[bad[0]].tolist()
            raise MetrologyError(f"robot {robot}: turn_limit_rad {value} is not 0 or more")
        moved_mm = np.minimum(moved_mm, limit.min(axis=1) * theta_mm)
    turns = np.repeat((moved_mm / phi_mm)[:, None], 2, axis=1)
    if phi_rad is None:
        return turns
    phi = _of_robots(plane, "phi_rad", phi_rad, (plane.n,))
    left = np.stack([phi - plane.limits[:, 1, 0], plane.limits[:, 1, 1] - phi], axis=1)
    return np.where(np.isnan(left), turns, np.minimum(turns, np.maximum(left, 0.0)))


def _of_robots(plane: FocalPlane, name: str, value: ArrayLike, shape: tuple[int, ...]) -> Floats:
    array = np.asarray(value, dtype=np.float64)
    if array.shape != shape:
        raise MetrologyError(f"{name} has shape {array.shape}, for {plane.n} robots it is {shape}")
    return array
