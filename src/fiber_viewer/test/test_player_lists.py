# SPDX-License-Identifier: Apache-2.0
"""What the page lists: states, reasons, faults and stops in order of their causes."""

from dataclasses import replace

import numpy as np
import pytest

from fiber_core.outcomes import Outcome, Reason, Verdict
from fiber_recording import save_recording
from fiber_recording.examples import seen_by_a_camera


def test_a_robot_without_a_target_is_not_held_whatever_its_reason(node, recording, tmp_path):
    reason = recording.reason.copy()
    reason[3] = Reason.NOT_PLANNED
    save_recording(tmp_path / "other.npz", replace(recording, reason=reason))
    states, figures = node(
        tmp_path / "other.npz",
        """
        const { stateAt, STATE_NAMES } = opened;
        answer = [[3, 5].map((row) => STATE_NAMES[stateAt(recording, row, 9)]),
          headline.figuresOf(recording)];
        """,
    )
    assert states == ["no target", "held"]
    assert (figures["asked"], figures["held"], figures["disabled"]) == (36, 1, 1)


def test_a_reason_names_the_bus_that_failed(node, recording, tmp_path):
    reason = recording.reason.copy()
    reason[11] = Reason.BUS_FAILED
    plane = recording.problem.plane
    problem = replace(recording.problem, plane=replace(plane, bus=np.full(plane.n, 4)))
    save_recording(tmp_path / "other.npz", replace(recording, problem=problem, reason=reason))
    texts = node(
        tmp_path / "other.npz",
        "answer = [opened.reasonOf(recording, 11), opened.reasonOf(recording, 5)];",
    )
    assert texts == ["failed: bus 4 failed", "held: unsafe"]


def test_the_cause_of_a_stop_is_listed_before_it(node, resumed, tmp_path):
    late = replace(resumed.events, time_s=np.array([0.0, 0.35, 0.4]))  # the bus tells of it later
    other = np.array([-1, 12, 12])  # robot 12 did not stop by itself
    for name, row, expected in (
        ("own", resumed.events.row, [[0.211, 11], [0.3003, None], [0.35, 11], [0.455, None]]),
        ("other", other, [[0.35, 12], [0.3003, None], [0.4, 12], [0.455, None]]),
    ):
        events = replace(late, row=row)
        outcome = np.where(resumed.outcome == Outcome.FAILED, Outcome.REACHED, resumed.outcome)
        save_recording(tmp_path / name, replace(resumed, events=events, outcome=outcome))
        history = node(
            tmp_path / f"{name}",
            """
            answer = opened.historyOf(recording, opened.faultsOf(recording))
              .map(({ time, fault }) => [time, fault ? fault.row : null]);
            """,
        )
        assert history == [[pytest.approx(time_s, abs=1e-3), row] for time_s, row in expected]


@pytest.mark.parametrize("high", [20.0, 40.0])
def test_grey_begins_where_the_corridor_ends(node, recording_file, high):
    below, above = node(
        recording_file,
        "answer = profiles.forbiddenBands([0, 5, 9, 1, -3, 30], 0, inputs.high);",
        high=high,
    )
    assert below == [0, 0, 5, 1, 0, 0]
    assert above == [0, 9, high, 1, min(30, high), high]


def test_robots_that_fail_together_are_one_fault_when_they_stopped(node, resumed, tmp_path):
    rows = np.arange(len(resumed.outcome))
    together = (rows < 9) & resumed.phases[0].stopped
    bad = together | (rows == 11)  # robot 11 stopped by itself
    names = vars(resumed.events)
    failed = replace(
        resumed,
        outcome=np.where(bad, Outcome.FAILED, Outcome.REACHED),
        reason=np.where(bad, Reason.NOT_ACKNOWLEDGED, Reason.OK),
        phases=(resumed.phases[0],),  # no robot is resumed
        events=replace(resumed.events, **{n: getattr(resumed.events, n)[:1] for n in names}),
    )
    save_recording(tmp_path / "failed.npz", failed)
    answer = node(
        tmp_path / "failed.npz",
        "answer = opened.faultsOf(recording).map(({ time, row, kind }) => [time, row, kind]);",
    )
    assert together.sum() > 3
    assert answer == [
        [pytest.approx(0.211), 11, "failed: not acknowledged"],
        [pytest.approx(0.3003), -1, f"{together.sum()} robots failed: not acknowledged"],
    ]


def test_a_robot_that_did_not_move_stays_flagged_and_one_off_its_model_is_counted(
    node, recording, tmp_path
):
    seen = seen_by_a_camera(recording, 1)
    verdict = np.full((3, recording.problem.plane.n), int(Verdict.MEASURED))
    verdict[:, 8] = Verdict.THETA_NOT_MOVED, Verdict.DARK, Verdict.MEASURED
    verdict[:, 9] = Verdict.OFF_MODEL, Verdict.MEASURED, Verdict.MEASURED
    verdict[:, 10] = Verdict.MERGED, Verdict.MEASURED, Verdict.MISSING
    verdict[:, 12] = Verdict.MEASURED, Verdict.MEASURED, Verdict.PHI_NOT_MOVED
    place = seen.images.place_mm[[0, 1, 1]]
    images = replace(seen.images, place_mm=place, true_mm=None, verdict=verdict)
    save_recording(tmp_path / "three.npz", replace(seen, images=images))
    flagged, counted = node(
        tmp_path / "three.npz",
        """
        const rows = (k) => images.residualsOf(recording, k).rows;
        answer = [images.flaggedOf(recording), [0, 1, 2].map(rows)];
        """,
    )
    told = {each["row"]: f"{each['verdict']} {each['text']}" for each in flagged}
    assert sorted(told) == [8, 9, 10, 12]
    assert told[8].startswith("theta not moved after the move: theta did not turn")
    assert told[9].startswith("off model after the move: its drive does not explain")
    assert told[10].startswith("missing after correction 2: no light")
    for rows in counted:
        assert 9 in rows and 8 not in rows and 12 not in rows
