# SPDX-License-Identifier: Apache-2.0
"""Blocks of a plane that are searched side by side, and the robots between them."""

from typing import NamedTuple

import numba as nb
import numpy as np

from fiber_core.array_types import Bools, Ints, Offsets, Rows
from fiber_core.clearance import Neighbours
from fiber_core.threads import share_out
from fiber_planner.direct.local_search import sweep
from fiber_planner.direct.plan_state import PlanState
from fiber_planner.direct.scene import Scene
from fiber_planner.direct.shortcut import shortcut_profiles

__all__ = ["Blocks", "blocks_of", "shortcut_all", "sweep_parts"]

_LEAST_ROBOTS = 1200  # of a block: in smaller ones too many robots are at a border
_AT_MOST = 32  # more blocks than any host has cores for


class Blocks(NamedTuple):
    """Robots in blocks that have nothing to do with each other.

    A robot inside a block has neighbours in that block only: its profile, its pairs and its
    neighbours are neither read nor written while the robots inside another block are changed. The
    robots at the borders come after all others, one after another. Blocks depend on the plane
    alone, so the plan is the same on any number of threads.

    Args:
        inside: rows of the robots inside each block.
        border: rows of the others, increasing.
    """

    inside: list[Rows]
    border: Rows

    def waves(self, backwards: bool) -> list[list[Rows]]:
        """Return the rows that are visited: several at once side by side, wave after wave.

        Args:
            backwards: whether the rows of a wave decrease.
        """
        step = -1 if backwards else 1
        waves = [[rows[::step] for rows in self.inside], [self.border[::step]]]
        return [wave for wave in waves if sum(map(len, wave))]


def blocks_of(robots: int, near: Neighbours) -> Blocks:
    """Return the blocks of a plane with robots that are sorted by their places.

    Args:
        robots: their number.
        near: neighbours of every body; fixtures, from row `robots` on, are in no block.
    """
    number = max(1, min(robots // _LEAST_ROBOTS, _AT_MOST))
    bounds = np.array([robots * k // number for k in range(number + 1)])
    block = np.repeat(np.arange(number), np.diff(bounds))
    at_border = _at_border(near.offsets, near.body, block)
    rows = np.arange(robots)
    inside = [rows[first:last] for first, last in zip(bounds[:-1], bounds[1:])]
    return Blocks([some[~at_border[some]] for some in inside], rows[at_border])


@nb.njit(cache=True)
def _at_border(offsets: Offsets, body: Ints, block: Ints) -> Bools:
    found = np.zeros(len(block), dtype=np.bool_)
    for i in range(len(block)):
        for e in range(offsets[i], offsets[i + 1]):
            if body[e] < len(block) and block[body[e]] != block[i]:
                found[i] = True
    return found


def sweep_parts(
    scene: Scene,
    plan: PlanState,
    step_s: float,
    folding: float,
    number: int,
    parts: list[Rows],
    draws: int,
) -> int:
    """Visit the robots of some blocks side by side, see `sweep`.

    Args:
        parts: robots of one wave, of each block some.

    Other arguments as for `sweep`.

    Returns:
        Number of moves evaluated.
    """
    evaluated = [0] * len(parts)

    def visit(first: int, last: int) -> None:
        for k in range(first, last):
            evaluated[k] = sweep(scene, plan, step_s, folding, number, parts[k], draws)

    share_out(visit, len(parts), 1)
    return sum(evaluated)


def shortcut_all(
    scene: Scene, plan: PlanState, step_s: float, lines: int, moved: int, blocks: Blocks
) -> None:
    """Remove breakpoints from the profiles of all robots, block beside block.

    Args:
        blocks: all robots.

    Other arguments as for `shortcut_profiles`.
    """
    for wave in blocks.waves(backwards=False):

        def visit(first: int, last: int, wave: list[Rows] = wave) -> None:
            for rows in wave[first:last]:
                shortcut_profiles(scene, plan, step_s, lines, moved, rows)

        share_out(visit, len(wave), 1)
