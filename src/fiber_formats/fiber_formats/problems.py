# SPDX-License-Identifier: Apache-2.0
"""A problem from files, or a random one on the plane of a file or of an instrument."""

import os
from dataclasses import dataclass, replace

import numpy as np

from fiber_core.drive.named import check_share, with_drive
from fiber_core.fields import random_problem
from fiber_core.presets import preset as preset_plane
from fiber_core.problem import Problem, load_problem
from fiber_formats.reading import Paths, read_layout, read_starts, read_targets

__all__ = ["DEFAULT_PRESET", "FoundProblem", "problem_from"]

DEFAULT_PRESET = "desi"


@dataclass(frozen=True, eq=False)
class FoundProblem:
    """A problem, and what to tell about the files that it comes from.

    Args:
        problem: the problem.
        lines: for each file one line that sums up what was read, then its notices.
    """

    problem: Problem
    lines: tuple[str, ...]


def problem_from(
    problem: str | os.PathLike[str] | None = None,
    layout: Paths | None = None,
    preset: str | None = None,
    robots: int | None = None,
    seed: int = 0,
    starts: Paths | None = None,
    targets: Paths | None = None,
    random_targets: bool = True,
    spacing_mm: float | None = None,
    drive: str | None = None,
    motors_on: float | None = None,
) -> FoundProblem:
    """Return a problem; what no file gives is random.

    Args:
        problem: problem.npz; its plane stands before layout and preset, its starts and targets
            are used where no other file gives them.
        layout: files of a layout, of any format; the preset supplies what they lack.
        preset: name of an instrument; without one the layout points to it, else `desi`.
        robots: number of robots of the preset; by default all.
        seed: of the random angles and targets.
        starts: files with the present angles of all robots.
        targets: files with targets; robots that the plane lacks are named in a line.
        random_targets: whether targets are drawn where starts come from a file and targets from
            none; otherwise no robot has a target then.
        spacing_mm: least distance between two targets, in place of that of the plane [mm].
        drive: name of the drive, one of `fiber_core.DRIVES`, in place of that of the plane.
        motors_on: largest share of the motors of a supply that may turn at once, in place of that
            of the plane.

    Raises:
        FiberError: there is no such preset or drive, the share is out of range, or a file is
            refused.
        OSError: problem.npz cannot be read.
    """
    lines: tuple[str, ...] = ()
    base = load_problem(problem) if problem else None
    if base is not None:
        plane = base.plane
    elif layout:
        read = read_layout(layout, preset or None)
        plane, lines = read.plane, (read.summary, *read.notices)
    else:
        plane = preset_plane(preset or DEFAULT_PRESET, robots or None)
    if spacing_mm is not None:
        plane = replace(plane, spacing_mm=spacing_mm)
    if drive is not None:
        plane = with_drive(plane, drive, motors_on)
    elif motors_on is not None:  # the motors stay what the plane says
        plane = replace(plane, drive=replace(plane.drive, motors_on=motors_on))
    check_share(plane)
    start = None if base is None else base.start
    if starts:
        begun = read_starts(starts, plane)
        start, lines = begun.angles, (*lines, begun.summary, *begun.notices)
    if targets:
        asked = read_targets(targets, plane)
        xy_mm, lines = asked.of(plane)[0], (*lines, asked.summary, *asked.notices)
        plane = asked.on(plane)
    else:
        xy_mm = None if base is None else base.targets
        if xy_mm is None and start is not None and not random_targets:
            xy_mm = np.full((plane.n, 2), np.nan)
    if start is None or xy_mm is None:
        drawn = random_problem(plane, np.random.default_rng(seed), start=start)
        start = drawn.start if start is None else start
        xy_mm = drawn.targets if xy_mm is None else xy_mm
    return FoundProblem(Problem(plane, start, xy_mm), lines)
