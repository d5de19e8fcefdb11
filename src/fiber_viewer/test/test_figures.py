# SPDX-License-Identifier: Apache-2.0
"""The figures show the numbers of the recording: assertions on data and artists."""

from dataclasses import replace

import numpy as np
import pytest
from matplotlib.collections import QuadMesh
from matplotlib.patches import Polygon

from fiber_core import kinematics
from fiber_core.clearance import gaps
from fiber_core.motion import SegmentMotion
from fiber_core.outcomes import Outcome, Reason
from fiber_core.presets import preset
from fiber_core.problem import Problem, save_plan, save_problem
from fiber_viewer import figures
from fiber_viewer.figures import command
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


def _phi_arms(axes):
    return next(c for c in axes.collections if c.get_gid() == "phi arms")


def _line(axes, label):
    return next(line for line in axes.lines if line.get_label() == label)


def _stairs(axes, label):
    return next(p for p in axes.patches if p.get_label() == label).get_data()


def test_arms_are_drawn_in_the_places_of_the_kinematics():
    problem, motion, outcome = _case()
    before, after = figures.before_and_after(problem, motion, outcome).axes
    for axes, angles in ((before, motion.start), (after, motion.end)):
        elbow, tip = kinematics.forward(problem.plane, angles)
        drawn = np.array(_phi_arms(axes).get_segments())
        np.testing.assert_allclose(drawn, np.stack([elbow, tip], axis=1))


def test_reached_held_and_no_target_have_different_colours():
    problem, motion, outcome = _case()
    _, after = figures.before_and_after(problem, motion, outcome).axes
    colors = _phi_arms(after).get_colors()
    assert len({tuple(c) for c in colors[:3]}) == 3
    labels = {text.get_text() for text in after.get_legend().get_texts()}
    assert labels == {"reached (1)", "held (1)", "no target (5)"}


def test_the_command_snapshot_draws_from_the_exchange_files(tmp_path):
    problem, motion, outcome = _case()
    save_problem(tmp_path / "problem.npz", problem)
    save_plan(tmp_path / "plan.npz", motion, outcome, np.full(7, Reason.OK))
    picture = tmp_path / "plane.png"
    code = main([str(tmp_path / "problem.npz"), str(tmp_path / "plan.npz"), "-o", str(picture)])
    assert code == 0
    assert picture.read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize("t", [0.0, 0.37, np.inf])
def test_the_plane_is_drawn_at_the_given_time(recording, t):
    (axes,) = figures.plane(recording, t).axes
    motion = recording.executed
    elbow, tip = kinematics.forward(recording.problem.plane, motion(min(t, motion.makespan_s)))
    drawn = np.array(_phi_arms(axes).get_segments())
    np.testing.assert_allclose(drawn, np.stack([elbow, tip], axis=1))
    assert f"{min(t, motion.makespan_s):.2f} s" in axes.get_title()


def test_the_outcome_map_has_every_robot_under_its_outcome(recording):
    (axes,) = figures.outcomes(recording).axes
    found = {c.get_label().split(" (")[0]: c.get_offsets() for c in axes.collections}
    assert {name: len(points) for name, points in found.items()} == {
        "reached": 33, "held": 1, "failed": 1, "no target": 1, "disabled": 1
    }  # fmt: skip
    np.testing.assert_allclose(found["failed"][0], recording.problem.plane.centers[11])


def test_a_conflict_is_six_moments_with_the_closest_approach_among_them(recording):
    rows = figures.conflict_rows(recording)
    near = recording.approaches
    assert set(near.pairs[0]) <= set(rows) and 2 <= len(rows) <= 3
    panels = figures.conflict(recording).axes
    assert len(panels) == 6
    pairs = near.pairs[np.isin(near.pairs, rows).all(axis=1)]
    times = []
    for axes in panels:
        time_s, gap = (float(word) for word in axes.get_title().split()[::2])
        times.append(time_s)
        angles = recording.executed(time_s)
        assert gap == pytest.approx(
            gaps(recording.problem.plane, pairs, angles).min(), abs=0.02
        )  # the title's time is rounded to a millisecond
    assert times == sorted(times)
    assert min(abs(t - near.time_s[0]) for t in times) < 1e-3


def test_an_outline_has_its_width_and_length(recording):
    rows = figures.conflict_rows(recording)
    axes = figures.conflict(recording, rows).axes[0]
    plane, t = recording.problem.plane, float(axes.get_title().split()[0])
    elbow, tip = kinematics.forward(plane, recording.executed(t))
    outlines = [p.get_xy() for p in axes.patches if isinstance(p, Polygon)]
    for row in rows:
        middle = 0.5 * (elbow + tip)[row]
        along = (tip - elbow)[row] / plane.arms[row, 1]
        across = np.array([-along[1], along[0]])
        nearest = min(outlines, key=lambda xy: np.linalg.norm(xy.mean(axis=0) - middle))
        widest = np.abs((nearest - middle) @ across).max()
        longest = np.abs((nearest - middle) @ along).max()
        assert widest == pytest.approx(plane.phi_radius[row], rel=2e-3)
        reach = 0.5 * plane.arms[row, 1] + plane.phi_radius[row]
        assert longest == pytest.approx(reach, rel=0.02)


def test_velocities_are_those_of_the_segments_and_of_the_trajectory(recording):
    rows = [0, 6]
    panels = np.reshape(figures.velocities(recording, rows).axes, (2, 2))
    motion, planned = recording.executed, recording.planned
    for row, pair in zip(rows, panels):
        for joint, axes in enumerate(pair):
            chosen = slice(*motion.offsets[2 * row + joint : 2 * row + joint + 2])
            values, edges, _ = _stairs(axes, "sent")
            np.testing.assert_allclose(values, np.rad2deg(motion.velocity_rad_s[chosen]))
            np.testing.assert_allclose(np.diff(edges), motion.duration_s[chosen])
            values, edges, _ = _stairs(axes, "planned")
            np.testing.assert_allclose(edges, planned.time_s)
            middle = 0.5 * (edges[10] + edges[11])
            assert values[10] == pytest.approx(np.rad2deg(planned.velocity(middle)[row, joint]))
            limit = np.rad2deg(recording.problem.plane.speeds[row, joint])
            levels = sorted({line.get_ydata()[0] for line in axes.lines})
            np.testing.assert_allclose(levels, [-limit, limit])


@pytest.mark.parametrize("name", ["recording", "resumed"])
def test_positions_show_trajectory_corridor_segments_and_readings(request, name):
    recording = request.getfixturevalue(name)
    row = int(recording.order_segments[0].sum(axis=1).argmax())
    planned, corridors, phase = recording.planned, recording.corridors, recording.phases[0]
    for joint, axes in enumerate(figures.positions(recording, [row]).axes):
        np.testing.assert_allclose(
            _line(axes, "planned").get_ydata(), np.rad2deg(planned.angles[row, joint])
        )
        sent = _line(axes, "sent")
        for t, angle in zip(*sent.get_data()):
            assert angle == pytest.approx(np.rad2deg(recording.executed(t)[row, joint]))
        chosen = recording.measured.row == row
        counts = recording.measured.counts[chosen, joint]
        read = _line(axes, "encoder")
        np.testing.assert_allclose(read.get_ydata(), np.rad2deg(recording.units.to_angles(counts)))
        forbidden = [c for c in axes.collections if c.get_label() == "outside the corridor"]
        edges = [band.get_paths()[0].vertices for band in forbidden]
        ends = 1e-6 * phase.stop_us[row] if phase.stopped[row] else corridors.lasts_s[row]
        bottom, top = axes.get_ylim()
        for edge, from_deg, bound in zip(edges, (bottom, top), (corridors.low, corridors.high)):
            assert edge[:, 0].max() == pytest.approx(ends)
            for k, t in enumerate(corridors.times_s(row)):
                if t < ends:
                    drawn = edge[np.isclose(edge[:, 0], t), 1]
                    both = sorted([from_deg, np.rad2deg(bound[row, joint, k])])
                    np.testing.assert_allclose([drawn.min(), drawn.max()], both)


def test_without_corridors_there_is_no_band(recording):
    axes = figures.positions(replace(recording, corridors=None), [6]).axes[0]
    assert not axes.collections


def test_the_time_in_which_all_robots_were_stopped_is_shaded(resumed):
    (pause,) = resumed.pauses_s
    assert pause == pytest.approx((0.3003, 0.455001))
    for figure in (figures.velocities(resumed, [6]), figures.positions(resumed, [6])):
        for axes in figure.axes:
            (span,) = (p for p in axes.patches if p.get_label() == "all stopped")
            box = span.get_extents().transformed(axes.transData.inverted())
            assert (box.x0, box.x1) == pytest.approx(pause)


def test_every_pair_is_in_the_histogram_of_clearances(recording):
    (axes,) = figures.clearances(recording).axes
    heights = [patch.get_height() for patch in axes.patches]
    assert sum(heights) == (recording.approaches.gap_mm >= 0).sum()
    assert heights[-1] == (recording.approaches.gap_mm >= 2.95).sum()
    assert _line(axes, "margin 0.05 mm").get_xdata()[0] == 0.05


def test_the_number_of_moving_robots_is_0_from_the_makespan_on(recording):
    (axes,) = figures.makespan(recording).axes
    (steps,) = axes.patches
    values, edges, _ = steps.get_data()
    motion = recording.executed
    for t in (0.1, 0.5, 0.9 * motion.makespan_s):
        moving = (motion.durations.max(axis=1) > t).sum()
        assert values[np.searchsorted(edges, t, side="right") - 1] == moving
    assert edges[-1] == motion.makespan_s
    assert _line(axes, "lower bound").get_xdata()[0] == recording.about["report"]["lower_bound_s"]


def test_no_robot_moves_while_all_are_stopped(resumed):
    (axes,) = figures.makespan(resumed).axes
    values, edges, _ = next(p for p in axes.patches if hasattr(p, "get_data")).get_data()
    resuming = resumed.phases[1].motion.decoded().counts.any(axis=1).sum()
    lasts = np.delete(resumed.phases[0].motion.decoded().durations.max(axis=1), 11)  # it had failed
    for t, moving in ((0.25, (lasts > 0.25).sum()), (0.4, 0), (0.456, resuming)):
        assert values[np.searchsorted(edges, t, side="right") - 1] == moving


def test_every_moving_motor_is_in_the_figure_of_segments(recording):
    (axes,) = figures.segments(recording).axes
    counts = recording.executed.counts
    for joint, name in enumerate(("theta", "phi")):
        bars = next(c for c in axes.containers if c.get_label() == name)
        assert [bar.get_height() for bar in bars] == [
            (counts[:, joint] == k).sum() for k in range(1, counts.max() + 1)
        ]


def test_every_byte_is_in_the_figure_of_the_buses(recording):
    axes = figures.bus_load(recording).axes[0]
    (mesh,) = (c for c in axes.collections if isinstance(c, QuadMesh))
    carried = mesh.get_array().sum() * recording.load.bin_s * 1e3
    assert carried == pytest.approx(recording.load.bytes.sum())
    assert _line(axes, "fault").get_xdata().tolist() == [0.3, 0.4]


def test_the_command_draws_the_named_figures(recording_file, tmp_path, capsys):
    out = tmp_path / "figures"
    names = ["conflict", "segments"]
    assert command.main([str(recording_file), "-o", str(out), "--only", ",".join(names)]) == 0
    for name in names:
        assert (out / f"{name}.pdf").read_bytes().startswith(b"%PDF")
        assert (out / f"{name}.png").read_bytes().startswith(b"\x89PNG")
    assert len(list(out.iterdir())) == 4
    assert command.main([str(recording_file), "-o", str(out), "--robots", "999"]) == 1
    assert "999" in capsys.readouterr().err
    with pytest.raises(SystemExit):
        command.main([str(recording_file), "--only", "nothing"])
