# SPDX-License-Identifier: Apache-2.0
"""What browsers are told: which plan can be started, what is an alert, and the plane as a file."""

import io
import json

import numpy as np
import pytest

from fiber_console import PlaneFeed
from fiber_core.outcomes import Outcome, PlanOutcome, Reason
from fiber_core.presets import preset
from fiber_msgs_py import Attempt, Level, PlanStamp, Progress, Status

PLANE = preset("desi", 7)
PLAN = PlanStamp(1_000_000_005)


def progress(stage, fraction, text="", refused=False):
    return Progress(stage, fraction, text, Attempt.first(PLAN), refused=refused)


def ended(outcome, reason):
    codes = np.full(7, outcome), np.full(7, reason)
    return PlanOutcome(PLAN.ns, PLANE.ids, *codes, np.zeros(7))


def test_a_plan_can_be_started_from_its_orders_to_its_motion():
    feed = PlaneFeed()
    feed.set_plane(PLANE)
    seen = []
    for stage, fraction in (
        ("planner", 1.0), ("bridge", 0.0), ("bridge", 1.0), ("bridge", 0.2), ("bridge", 1.0)
    ):  # fmt: skip
        feed.add_progress(progress(stage, fraction))
        seen.append(feed.status()["ready"])
    assert seen == [None, None, str(PLAN), None, None]


@pytest.mark.parametrize("outcome_first", [True, False])
def test_an_ended_plan_cannot_be_started(outcome_first):
    feed = PlaneFeed()
    feed.add_progress(progress("bridge", 1.0))
    steps = [
        lambda: feed.set_outcome(ended(Outcome.REACHED, Reason.OK)),
        lambda: feed.add_progress(progress("bridge", 1.0)),
    ]
    for step in steps if outcome_first else steps[::-1]:
        step()
    assert feed.status()["ready"] is None


def test_robots_without_a_target_are_not_counted():
    feed = PlaneFeed()
    outcome = ended(Outcome.HELD, Reason.NO_TARGET)
    outcome.outcome[:3], outcome.reason[:3] = Outcome.REACHED, Reason.OK
    feed.set_outcome(outcome)
    assert feed.status()["ended"] == {"plan": str(PLAN), "reached": 3, "held": 0, "failed": 0}


def test_a_status_that_becomes_worse_and_a_refusal_are_alerts():
    feed = PlaneFeed()
    for level in (Level.OK, Level.WARN, Level.WARN, Level.ERROR, Level.OK):
        feed.add_status(Status("bridge: bus 3", level, level.name))
    feed.add_progress(progress("planner", 0.0, "no such robot", refused=True))
    status = feed.status()
    assert [alert["level"] for alert in status["alerts"]] == ["warn", "error", "error"]
    assert "refused: no such robot" in status["alerts"][-1]["text"]
    assert status["buses"] == [{"name": "bridge: bus 3", "level": "ok", "text": "OK"}]
    json.dumps(status)


@pytest.mark.parametrize("outcome_first", [True, False])
def test_the_plane_is_a_file_with_targets_and_outcomes(outcome_first):
    feed = PlaneFeed()
    assert feed.plane_file() is None
    if not outcome_first:  # a console that begins late may hear the outcome before the layout
        feed.set_plane(PLANE)
        feed.set_targets(np.array([PLANE.ids[2], 999]), np.array([[1.0, 2.0], [0.0, 0.0]]))
    feed.set_outcome(ended(Outcome.FAILED, Reason.STOPPED))
    feed.set_plane(PLANE)
    data = np.load(io.BytesIO(feed.plane_file()))
    assert np.array_equal(data["id"], PLANE.ids)
    assert (data["outcome"] == Outcome.FAILED).all()
    assert np.isfinite(data["target_mm"]).sum() == (0 if outcome_first else 2)
    other = preset("desi", 19)
    feed.set_plane(other)
    data = np.load(io.BytesIO(feed.plane_file()))
    assert (data["outcome"] == 255).all() and len(data["id"]) == 19


def test_motion_is_angles_and_speeds_as_floats():
    angles = np.arange(14.0).reshape(7, 2)
    message = np.frombuffer(PlaneFeed.motion_message(angles, -angles), "<f4")
    assert message.tolist() == [*range(14), *(-k for k in range(14))]
