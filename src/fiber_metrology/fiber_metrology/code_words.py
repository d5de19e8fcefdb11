# SPDX-License-Identifier: Apache-2.0
"""Code words: which order moves which fibre, told by turns of phi that differ for each robot.

Each robot has a word of as many bits as there are images. In an image phi of the robot is turned
from where it rested, up if the bit is 1 and else down, by so little that no point of an arm moves
by more than half of the margin. The lights that move by a word are those of the robot that was told
to make it, wherever they are.

The words are those of the Reed-Muller code of order 2: the values of the quadratic forms
in m bits, at all 2^m points. Any two differ in a quarter of the images (MacWilliams and Sloane
1977, The Theory of Error-Correcting Codes, chapter 13).
"""

from dataclasses import dataclass
from itertools import combinations

import numpy as np

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
        turn_rad: the turn of phi either way [rad], shape (n,).
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
        return np.where(self.bits, 1.0, -1.0) * self.turn_rad[:, None]


def code_words(
    plane: FocalPlane, rng: np.random.Generator, images: int = 32, margin_mm: float = 0.05
) -> CodeWords:
    """Draw a word for each robot.

    Args:
        plane: the focal plane.
        rng: source of the words.
        images: 16 or 32; with 16 at most 1000 robots have words of their own.
        margin_mm: gap that the outlines keep before the turns [mm].

    Raises:
        MetrologyError: there are not so many images, or not so many words as robots.
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
    return CodeWords(bits, 0.5 * margin_mm / levers_of(plane)[:, 1])
