#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Solve one problem with sdss-kaiju, in a Python that has it.

A program of its own, as sdss-kaiju needs numpy 1: `rivals.py` writes the problem and reads the
answer. It imports nothing of this repository.

    python3 bench/kaiju_adapter.py problem.npz answer.npz
"""

import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
from kaiju.cKaiju import RobotGrid as PlainGrid  # pyright: ignore[reportMissingModuleSource]
from kaiju.robotGrid import RobotGrid  # pyright: ignore[reportMissingModuleSource]
from numpy.typing import NDArray

_GREED, _PHOBIA = 0.8, 0.2  # as in the tests of sdss-kaiju


def grid_of(problem: dict[str, NDArray]) -> RobotGrid:
    """Return a grid of robots that stand on their targets and are to fold.

    sdss-kaiju plans from the targets to the folded arms, and plays that backwards.

    Args:
        problem: arrays as `rivals.py` writes them.
    """
    grid = RobotGrid(seed=int(problem["seed"]))
    theta_arm, phi_arm = map(float, problem["arms_mm"])
    fibre = (phi_arm, 0.0)
    for robot, (x, y) in enumerate(problem["centre_mm"]):
        PlainGrid.addRobot(  # that of its subclass wants the calibration of SDSS-V
            grid, robotID=robot, holeID=str(robot), basePos=(x, y, 0.0), iHat=(1.0, 0.0, 0.0),
            jHat=(0.0, 1.0, 0.0), kHat=(0.0, 0.0, 1.0), dxyz=(0.0, 0.0, 0.0), alphaLen=theta_arm,
            alphaOffDeg=0.0, betaOffDeg=0.0, elementHeight=0.0, scaleFac=1.0, metBetaXY=fibre,
            bossBetaXY=fibre, apBetaXY=fibre, collisionSegBetaXY=((0.0, 0.0), fibre),
            hasApogee=True, collisionBuffer=float(problem["radius_mm"]), lefthanded=False,
        )  # fmt: skip
    grid.initGrid()
    for robot, goal_deg in enumerate(problem["goal_deg"]):
        grid.robotDict[robot].setAlphaBeta(*goal_deg)
        grid.robotDict[robot].setDestinationAlphaBeta(*problem["fold_deg"])
    return grid


def solve(problem: dict[str, NDArray]) -> dict[str, Any]:
    """Return the paths from folded arms to the targets, as its own program sends them.

    Args:
        problem: arrays as `rivals.py` writes them.
    """
    grid = grid_of(problem)
    tips = np.array([grid.robotDict[robot].metWokXYZ[:2] for robot in range(grid.nRobots)])
    begin = time.process_time()
    if str(problem["algorithm"]) == "greedy":
        grid.pathGenGreedy()
    else:
        grid.pathGenMDP(_GREED, _PHOBIA)
    _, paths = grid.getPathPair(speed=float(problem["speed_deg_s"]) / 6.0, pathDelay=0.0)
    cpu_s = time.process_time() - begin
    rows = [
        (robot, joint, time_s, angle_deg)
        for robot in range(grid.nRobots)
        for joint, axis in enumerate(("alpha", "beta"))
        for angle_deg, time_s in paths[robot][axis]
    ]
    reached = np.ones(grid.nRobots, dtype=bool)
    reached[grid.deadlockedRobots()] = False
    return {"points": np.array(rows), "reached": reached, "tips_mm": tips, "cpu_s": cpu_s}


def main(argv: list[str]) -> int:
    """Read the problem, write the answer; returns the exit code."""
    problem, answer = map(Path, argv)
    with np.load(problem) as arrays:
        np.savez(answer, **solve(dict(arrays)))
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
