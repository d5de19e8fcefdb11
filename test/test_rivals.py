# SPDX-License-Identifier: Apache-2.0
"""The table of rivals: answers are read as they are sent, and judged alike."""

import importlib
import sys
from pathlib import Path

import numpy as np
import pytest


@pytest.fixture(scope="module")
def rivals():
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(Path(__file__).parents[1] / "bench")
        yield importlib.import_module("rivals")


def _points(motion, plane):
    # robot, joint, time [s] and angle [deg] at both ends of each segment of a motion
    rows = []
    for robot in range(plane.n):
        for joint in range(2):
            part = slice(*motion.offsets[2 * robot + joint : 2 * robot + joint + 2])
            times = np.concatenate([[0.0], np.cumsum(motion.duration_s[part])])
            turned = np.cumsum(motion.duration_s[part] * motion.velocity_rad_s[part])
            angles = motion.start[robot, joint] + np.concatenate([[0.0], turned])
            rows += [(robot, joint, t, np.degrees(a)) for t, a in zip(times, angles)]
    return np.array(rows)


def test_points_become_the_motion_that_runs_through_them(rivals):
    field = rivals.field_of(37, 5)
    plane = field.problem.plane
    motion = rivals.make_orders(field.problem, planner="direct").wire.decoded()
    assert motion.counts.max() > 1
    read = rivals.motion_of(plane, _points(motion, plane))
    assert np.array_equal(read.offsets, motion.offsets)
    for t in np.linspace(0.0, motion.makespan_s, 50):
        assert read(t) == pytest.approx(motion(t), abs=1e-9)


def test_an_answer_whose_arms_overlap_is_told(rivals):
    field = rivals.field_of(37, 5)
    straight = np.array(
        [
            (robot, joint, t, angles[robot, joint])
            for robot in range(37)
            for joint in range(2)
            for t, angles in (
                (0.0, np.degrees(field.problem.start)),
                (0.5, np.tile((0.0, 0.0), (37, 1))),  # all stretched out the same way
                (1.0, np.degrees(field.goal)),
            )
        ]
    )
    motion = rivals.motion_of(field.problem.plane, straight)
    reached = np.ones(37, dtype=bool)
    row = rivals._judged(field, motion, reached, 0.0, rivals._TOUCH)
    assert (row["reached"], row["asked"], row["certified"]) == (37, 37, "no")
    assert row["overlaps"] > 10
    assert row["least_gap_mm"] <= 0.0
    late = rivals.motion_of(field.problem.plane, straight[straight[:, 2] < 1.0])
    assert rivals._judged(field, late, reached, 0.0, rivals._TOUCH)["reached"] == 0


def test_without_the_rival_the_table_has_our_rows_and_says_so(rivals, capsys, tmp_path):
    table = tmp_path / "rivals.md"
    arguments = ["--robots", "37", "--fields", "1", "--kaiju-python", "/nowhere/python"]
    assert rivals.main([*arguments, "--out", str(table)]) == 0
    assert "SKIPPED: sdss-kaiju" in capsys.readouterr().err
    lines = [line for line in table.read_text().splitlines() if line.startswith("| ")]
    assert [line.split(" | ")[0] for line in lines[2:]] == ["| direct", "| dnf_arms_priority"]


def test_the_rival_solves_the_same_problem(rivals):
    if not rivals.has_kaiju(sys.executable):
        pytest.skip("sdss-kaiju is not installed: its adapter is not run")
    field = rivals.field_of(37, 5)
    row = rivals.theirs("greedy", field, 0, sys.executable)
    assert row["reached"] > 30
    assert row["ratio"] >= 1.0 - 1e-9
