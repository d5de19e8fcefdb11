# SPDX-License-Identifier: Apache-2.0
"""A recording is built from the frame log of a session, without ROS."""

import subprocess
import sys
import textwrap

import numpy as np
import pytest

from fiber_bus_bridge.simulation import Event
from fiber_core.errors import FiberError
from fiber_core.outcomes import Outcome, PlanOutcome, Reason
from fiber_recording import build_recording
from fiber_recording.recording import EventKind


def outcome_of(plan):
    result = plan.result
    return PlanOutcome(7, plan.plane.ids, result.outcome, result.reason, result.error_mm)


def recorded(plan, **given):
    return build_recording(
        plan.plane, plan.units, logs=plan.logs, outcome=outcome_of(plan), counts_before=plan.start,
        **given,
    )  # fmt: skip


def test_frame_log_and_outcome_are_enough(simulated_plan):
    plan = simulated_plan()
    recording = recorded(plan)
    np.testing.assert_array_equal(recording.motion.ticks, plan.replay.motion.ticks)
    np.testing.assert_array_equal(recording.outcome, plan.result.outcome)
    assert recording.started.all() and not recording.problem.asked.any()
    assert recording.planned is None and recording.corridors is None
    about = recording.about
    assert (about["plan_ns"], about["seed"], about["planner"], about["notes"]) == (7, -1, "", [])
    assert about["report"]["phases"] == 1 and about["certificate"]["margin_mm"] == 0.05


def test_stops_and_lost_robots_are_in_the_notes(simulated_plan):
    plan = simulated_plan([(11, 0.9, Event.POWER, 0)])
    recording = recorded(
        plan, counts_after=plan.last_counts, about={"seed": 3}, notes=["simulated"]
    )
    assert recording.outcome[11] == Outcome.FAILED and recording.about["seed"] == 3
    first, stopped, lost = recording.about["notes"]
    assert first == "simulated"
    assert stopped.startswith("stopped at") and ", resumed at" in stopped
    assert " 11," in stopped.split("without robots")[1]
    assert lost == "nothing tells where it stopped, the place shown is a guess: robot 11"
    np.testing.assert_array_equal(recording.phases[-1].end, plan.last_counts)


@pytest.mark.parametrize("dead_s", [0.003, 0.2])
def test_a_loss_of_power_in_motion_that_resets_counters_is_recorded(simulated_plan, dead_s):
    failing = (11, 0.8, Event.POWER, 0), (11, 0.8 + dead_s, Event.POWER, 1)
    plan = simulated_plan(failing, volatile=True)
    recording = recorded(plan, counts_after=plan.last_counts)
    first, second = recording.phases[0], recording.phases[-1]
    others = np.arange(plan.robots) != 11
    np.testing.assert_array_equal(second.end[others], plan.encoders[others])
    assert first.stopped[11] and first.stop_us[11] < second.begin_us
    turned = plan.units.to_angles(np.abs(second.end - plan.start)[11])
    assert turned.max() < 2.0  # and not to the counters that its loss of power has set to 0
    notes = "; ".join(recording.about["notes"])
    assert ("counters were set, or lost with the power" in notes) == (
        plan.last_counts[11] == 0
    ).all()
    assert "nothing tells where it stopped, the place shown is a guess: robot 11" in notes


@pytest.mark.parametrize(
    ("fault", "kind"),
    [((Event.JAM_THETA, 1), EventKind.FAULT), ((Event.POWER, 0), EventKind.NO_ADDRESS)],
)
def test_the_failure_of_a_robot_comes_before_the_stop_of_all(simulated_plan, fault, kind):
    plan = simulated_plan([(11, 0.9, *fault)])
    recording = recorded(plan)
    events = recording.events
    stop = np.flatnonzero(events.kind == EventKind.STOP)[0]
    cause = np.flatnonzero((events.kind == kind) & (events.row == 11))[0]
    assert cause < stop and events.time_s[stop] - 0.02 < events.time_s[cause] <= events.time_s[stop]
    assert recording.reason[11] == (Reason.STALLED if kind == EventKind.FAULT else Reason.NO_REPLY)


def test_values_that_do_not_fit_the_plane_are_refused(simulated_plan):
    plan = simulated_plan()
    with pytest.raises(FiberError, match=r"start has shape \(37, 2\), expected \(5, 2\)"):
        build_recording(
            plan.plane.permuted(np.arange(5)),
            plan.units,
            logs=[],
            outcome=outcome_of(plan),
            counts_before=plan.start,
        )


def test_it_needs_no_ros(tmp_path):
    script = f"""
        import sys
        for name in ("rclpy", "rcl_interfaces", "std_msgs", "sensor_msgs", "trajectory_msgs",
                     "fiber_msgs_py", "fiber_node", "fiber_client"):
            sys.modules[name] = None  # an import of it fails
        from pathlib import Path
        import numpy as np
        from fiber_core.outcomes import PlanOutcome
        from fiber_core.presets import preset
        from fiber_core.wire_units import WireUnits
        from fiber_recording import build_recording, load_recording, save_recording
        from fiber_recording.examples import random_recording
        plane = preset("desi", 3)
        ended = PlanOutcome(0, plane.ids, np.ones(3, int), np.ones(3, int), np.full(3, np.nan))
        recording = build_recording(
            plane, WireUnits.for_plane(plane), logs=[], outcome=ended, counts_before=[[0, 0]] * 3
        )
        path = Path({str(tmp_path / "recording.npz")!r})
        for recording in (recording, random_recording(1)):
            save_recording(path, recording)
            assert load_recording(path).problem.plane.n == recording.problem.plane.n
    """
    ran = subprocess.run(
        [sys.executable, "-c", textwrap.dedent(script)], capture_output=True, text=True
    )
    assert ran.returncode == 0, ran.stderr
