"""The night-log figures show the numbers they are given."""

import numpy as np

from fiber_core import kinematics
from fiber_core.motion import SegmentMotion
from fiber_core.outcomes import Outcome, Reason
from fiber_core.presets import preset
from fiber_core.problem import Problem, save_plan, save_problem
from fiber_viewer import before_and_after
from fiber_viewer.snapshot import main


def _case():
    plane = preset("desi", robots=7)
    start = np.tile([0.3, 2.0], (7, 1))
    offsets = np.concatenate([[0, 1], np.full(13, 1)])
    motion = SegmentMotion(start, offsets, [0.5], [1.0])
    targets = np.full((7, 2), np.nan)
    targets[:2] = kinematics.forward(plane, motion.end)[1][:2]
    outcome = np.full(7, Outcome.HELD)
    outcome[0] = Outcome.REACHED
    return Problem(plane, start, targets), motion, outcome


def _second_arms(axes):
    return next(c for c in axes.collections if c.get_gid() == "second arms")


def test_arms_are_drawn_where_the_kinematics_puts_them():
    problem, motion, outcome = _case()
    before, after = before_and_after(problem, motion, outcome).axes
    for axes, angles in ((before, motion.start), (after, motion.end)):
        elbow, tip = kinematics.forward(problem.plane, angles)
        drawn = np.array(_second_arms(axes).get_segments())
        np.testing.assert_allclose(drawn, np.stack([elbow, tip], axis=1))


def test_colours_tell_reached_from_held_and_idle():
    problem, motion, outcome = _case()
    _, after = before_and_after(problem, motion, outcome).axes
    colors = _second_arms(after).get_colors()
    assert len({tuple(c) for c in colors[:3]}) == 3
    labels = {text.get_text() for text in after.get_legend().get_texts()}
    assert labels == {"reached (1)", "held (1)", "nothing asked (5)"}


def test_command_draws_from_the_exchange_files(tmp_path):
    problem, motion, outcome = _case()
    save_problem(tmp_path / "problem.npz", problem)
    save_plan(tmp_path / "plan.npz", motion, outcome, np.full(7, Reason.OK))
    picture = tmp_path / "plane.png"
    code = main([str(tmp_path / "problem.npz"), str(tmp_path / "plan.npz"), "-o", str(picture)])
    assert code == 0
    assert picture.read_bytes().startswith(b"\x89PNG")
