# SPDX-License-Identifier: Apache-2.0
"""A reconfiguration gives every robot an outcome, repeats to the byte, and is saved whole."""

import json
import logging
from dataclasses import replace

import numpy as np
import pytest

from fiber_core import kinematics
from fiber_core.assignment import assign
from fiber_core.clearance import gaps, neighbour_pairs
from fiber_core.errors import FiberError
from fiber_core.motion import SampledMotion
from fiber_core.outcomes import Outcome, Reason
from fiber_core.problem import load_plan, load_problem
from fiber_formats import read_results
from fiber_planner.direct import DirectParameters, DirectPlanner
from fiber_positioners import (
    PlannedMotion,
    Problem,
    Reconfiguration,
    Safety,
    make_orders,
    preset,
    random_problem,
    read_layout,
    reconfigure,
    run_on_simulated_buses,
    with_targets,
)
from fiber_recording import load_recording

REPORT_KEYS = [
    "planner", "seed", "plane", "drive", "robots", "enabled", "asked", "reached", "held", "failed",
    "reasons", "makespan_s", "lower_bound_s", "makespan_ratio", "supply_bound_s",
    "power_bound_s", "motors_on", "motors_on_peak", "drive_violations", "certified",
    "close_at_rest_ids",
    "min_clearance_mm", "min_clearance_ids", "min_clearance_time_s",
    "nearer_from_start",
    "segments_mean", "segments_max", "segments_bound",
    "end_error_um_rms", "end_error_um_max", "held_by_drive", "reachable_at_once", "pair_bound_s",
    "pair_bound_proven", "makespan_to_pair_bound", "bytes_mean", "bytes_bound", "bus_time_s",
    "countdown_s", "plan_s", "discretize_s", "upload_s", "certify_s", "encode_s",
]  # fmt: skip


class Resting:
    """A planner that moves no robot."""

    name = "resting"

    def plan(self, problem, progress=None):
        start = problem.start
        motion = SampledMotion([0.0, 1.0], np.repeat(start[:, :, None], 2, axis=2))
        reason = np.where(problem.asked, Reason.NOT_CONVERGED, Reason.NO_TARGET)
        return PlannedMotion(motion, start, reason)


def arrays(result):
    motion = result.motion
    return (
        motion.offsets, motion.duration_s, motion.velocity_rad_s, result.outcome, result.reason,
        result.frames.time_s, result.frames.data,
    )  # fmt: skip


def test_every_robot_of_a_random_field_reaches_its_target(result):
    assert (result.outcome == Outcome.REACHED).all() and (result.reason == Reason.OK).all()
    assert result.certificate.ok
    assert (result.error_mm <= 0.1).all()


def test_the_report_has_the_keys_of_a_results_line(result):
    assert list(result.report) == REPORT_KEYS
    assert result.report["planner"] == "direct" and result.report["seed"] == 2
    json.dumps(result.report)


def test_equal_seeds_give_equal_bytes(result):
    again = reconfigure(random_problem(preset("desi", 37), seed=1), seed=2)
    for a, b in zip(arrays(result), arrays(again)):
        assert np.array_equal(a, b)


def test_another_seed_of_the_clocks_leaves_the_motion_as_it_is(result):
    other = reconfigure(result.problem, seed=3)
    assert np.array_equal(other.motion.velocity_rad_s, result.motion.velocity_rad_s)
    assert not np.array_equal(other.frames.data, result.frames.data)


def test_a_seed_and_its_generator_draw_the_same_problem():
    plane = preset("desi", 7)
    a, b = random_problem(plane, 5), random_problem(plane, np.random.default_rng(5))
    assert np.array_equal(a.targets, b.targets) and np.array_equal(a.start, b.start)


def test_a_saved_folder_holds_the_problem_the_plan_the_report_and_the_recording(result, tmp_path):
    folder = result.save(tmp_path / "a" / "b")
    problem = load_problem(folder / "problem.npz")
    assert np.array_equal(problem.targets, result.problem.targets)
    motion, outcome = load_plan(folder / "plan.npz", result.motion.start)
    assert np.array_equal(motion.duration_s, result.motion.duration_s)
    assert np.array_equal(outcome, result.outcome)
    assert json.loads((folder / "report.json").read_text())["reached"] == 37
    recording = load_recording(folder / "recording.npz")
    assert np.array_equal(recording.outcome, result.outcome)


def test_the_recording_replays_the_same_motion_from_the_frames(result):
    recording = result.recording
    assert recording.started.all()
    times = np.linspace(0.0, result.motion.makespan_s, 7)
    for t in times:
        assert np.allclose(recording.executed(t), result.motion(t), atol=1e-9)
    assert recording.about["report"]["reached"] == result.report["reached"]
    assert recording.about["planner"] == "direct" and not recording.about["notes"]


def test_the_player_is_one_page_with_the_recording_in_it(result, tmp_path):
    page = result.player(tmp_path / "pages" / "player.html")
    text = page.read_text()
    assert text.startswith("<!") and len(text) > 50_000 and "{{" not in text[:2000]


def test_another_planner_stands_behind_the_interface():
    problem = random_problem(preset("desi", 7), seed=1)
    result = reconfigure(problem, planner=Resting())
    assert result.report["planner"] == "resting"
    assert (result.outcome == Outcome.HELD).all()
    assert (result.reason == Reason.NOT_CONVERGED).all()


def test_a_robot_that_stays_near_its_target_is_held_where_the_tolerance_is_less():
    drawn = random_problem(preset("desi", 7), seed=1)
    tips = kinematics.forward(drawn.plane, drawn.start)[1]
    problem = Problem(drawn.plane, drawn.start, tips + [0.03, 0.04])  # 50 um away
    assert (reconfigure(problem, planner=Resting()).outcome == Outcome.REACHED).all()
    corrected = reconfigure(problem, planner=Resting(), tolerance_mm=0.002)
    assert (corrected.outcome == Outcome.HELD).all()
    assert (corrected.reason == Reason.NOT_CONVERGED).all()
    with pytest.raises(FiberError, match="tolerance_mm"):
        reconfigure(problem, planner=Resting(), tolerance_mm=-1.0)


def test_a_refused_target_holds_its_robot_and_has_a_reason():
    problem = random_problem(preset("desi", 7), seed=1)
    targets = problem.targets.copy()
    targets[2] = problem.plane.centers[2] + 50.0
    result = reconfigure(Problem(problem.plane, problem.start, targets))
    assert result.outcome[2] == Outcome.HELD and result.reason[2] == Reason.UNREACHABLE
    assert (np.delete(result.outcome, 2) == Outcome.REACHED).all()


def test_an_unknown_planner_is_refused_by_name():
    problem = random_problem(preset("desi", 7), seed=1)
    with pytest.raises(FiberError, match="quickest"):
        reconfigure(problem, planner="quickest")


def test_progress_rises_from_the_plan_to_the_end():
    told = []
    problem = random_problem(preset("desi", 7), seed=1)
    reconfigure(problem, progress=lambda fraction, text: told.append((fraction, text)))
    fractions = [fraction for fraction, _ in told]
    assert fractions == sorted(fractions) and 0.0 <= fractions[0] and fractions[-1] == 1.0
    assert any("plan" in text for _, text in told) and any("moving" in text for _, text in told)


def test_a_larger_margin_is_kept(result):
    margin = Safety(margin_mm=0.15)
    other = reconfigure(result.problem, safety=margin)
    assert other.orders.safety == margin and other.certificate.ok
    assert other.certificate.min_gap_mm >= 0.15


def test_captures_of_the_buses_are_written(tmp_path):
    pytest.importorskip("vcd")
    reconfigure(random_problem(preset("desi", 2), seed=1), capture=tmp_path / "capture")
    assert (tmp_path / "capture" / "buses.vcd").stat().st_size > 0
    assert (tmp_path / "capture" / "buses.pcap").stat().st_size > 0


def test_targets_of_a_table_stand_in_for_those_of_the_problem(tmp_path):
    problem = random_problem(preset("desi", 7), seed=1)
    x, y = problem.targets[4]
    (tmp_path / "targets.csv").write_text(f"id,x_mm,y_mm\n4,{x},{y}\n")
    other = with_targets(problem, tmp_path / "targets.csv")
    assert other.asked.tolist() == [k == 4 for k in range(7)]
    assert np.allclose(other.targets[4], problem.targets[4])


def test_orders_carry_the_reasons_of_all_stages():
    problem = random_problem(preset("desi", 7), seed=1)
    orders = make_orders(problem)
    plane, start = orders.plane, orders.start_problem.start
    assigned = assign(plane, start, plane.ids, problem.targets)
    assert np.array_equal(orders.start_problem.targets, assigned.targets)
    assert (orders.reason == Reason.OK).all()
    run = run_on_simulated_buses(orders)
    result = Reconfiguration(orders, run, 0)
    assert np.array_equal(result.outcome, reconfigure(problem).outcome)


def test_a_plane_from_a_table_tells_what_the_preset_supplied(tmp_path):
    (tmp_path / "own.csv").write_text(
        "id,x_mm,y_mm,arm_theta_mm,arm_phi_mm,remark\n4,0,0,3,3,a\n9,10.4,0,3,3,b\n"
    )
    logged = []
    handler = logging.Handler()
    handler.emit = lambda record: logged.append(record.getMessage())
    logger = logging.getLogger("fiber_positioners")
    logger.addHandler(handler)
    try:
        plane = read_layout(tmp_path / "own.csv")
    finally:
        logger.removeHandler(handler)
    assert plane.ids.tolist() == [4, 9]
    assert "2 robots, 0 disabled" in logged[0] and "from preset desi" in logged[0]
    assert any("remark" in line for line in logged[1:])
    assert reconfigure(random_problem(plane, seed=1)).report["reached"] == 2


@pytest.mark.parametrize("planner", ["direct", "dnf_arms", "dnf"])
def test_no_arm_touches_a_wall(planner):
    plane = preset("desi_outlines", 37)
    sides = plane.centers + np.array([5.2, 3.0])  # between a robot and two of its neighbours
    walls = np.stack([sides[::3], sides[::3] + [0.6, 0.0], sides[::3] + [0.3, 0.6]], axis=1)
    plane = replace(plane, walls=walls)
    result = reconfigure(random_problem(plane, 3), planner=planner)
    assert result.certificate.ok
    assert (result.outcome == Outcome.REACHED).sum() >= (37 if planner == "direct" else 20)
    pairs = neighbour_pairs(plane)
    pairs = pairs[pairs[:, 1] >= plane.n]
    times = np.linspace(0.0, result.motion.makespan_s, 400)
    assert min(gaps(plane, pairs, result.motion(t)).min() for t in times) >= 0.05
    held = result.recording.problem.plane.walls
    assert np.allclose(held, walls)


@pytest.mark.parametrize("named", [True, False])
def test_the_fibre_of_a_target_is_brought_to_it(named, tmp_path):
    plain = preset("sdss_v", 19)
    places = np.array([[14.25, 0.0], [14.91, -0.36], [14.9, 0.38]])
    plane = replace(
        plain, fibres=np.broadcast_to(places, (plain.n, 3, 2)), fibre_names=tuple("mba")
    )
    problem = random_problem(plane, 5)
    if not named:
        problem = Problem(plane, problem.start, problem.targets)
    planner = DirectPlanner(DirectParameters(shortening=0.0))
    result = reconfigure(problem, planner=planner, seed=5)
    assert (result.outcome == Outcome.REACHED).all() and result.certificate.ok
    angles = result.motion.end
    on = kinematics.on_target(problem.plane, angles, problem.targets)
    error_um = 1e3 * on.error_mm
    assert error_um.max() < 1.0
    np.testing.assert_allclose(result.report["end_error_um_max"], error_um.max())
    if named:
        np.testing.assert_array_equal(on.fibre, problem.plane.fibre)
    result.write_results(tmp_path / "results.csv")
    read = read_results(tmp_path / "results.csv")
    assert [plane.fibre_names.index(name) for name in read.fibre] == on.fibre.tolist()
    np.testing.assert_allclose(read.reached_mm, on.place, atol=1e-3)
    recorded = result.recording.problem.plane
    np.testing.assert_array_equal(recorded.fibres, plane.fibres)
    np.testing.assert_array_equal(recorded.fibre, problem.plane.fibre)
