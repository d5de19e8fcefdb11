# SPDX-License-Identifier: Apache-2.0
"""The loop of images and corrections, with a client that plays the graph."""

import argparse
from contextlib import nullcontext
from types import SimpleNamespace

import numpy as np
import pytest

from fiber_client.closed_loop import CameraLoop, show_images
from fiber_client.errors import PlaneError, PlaneRefusal
from fiber_client.reconfigure import _run
from fiber_core.outcomes import Outcome, PlanOutcome, Reason, Verdict
from fiber_core.presets import preset
from fiber_msgs_py import PlanStamp
from fiber_msgs_py.measured import Measured

PLANE = preset("desi", 7)
N = PLANE.n
TARGETS = PLANE.centers + 1.0


class Graph:
    """A client, and the images that its metrology will take: offsets from targets [um], verdicts.

    An image that is an error is raised, and so is the answer to a correction.
    """

    def __init__(self, images, correction=None):
        self.images, self.correction = list(images), correction
        self.plane, self.measured, self.corrected = PLANE, {}, []
        logger = SimpleNamespace(warning=lambda text: None)
        asks = SimpleNamespace(
            service_is_ready=lambda: True,
            call_async=lambda request: SimpleNamespace(done=lambda: True, result=self._measure),
        )
        self.node = SimpleNamespace(
            get_logger=lambda: logger, create_client=lambda *given, **named: asks
        )

    def _measure(self):
        image = self.images.pop(0)
        if isinstance(image, str):
            return SimpleNamespace(success=False, message=image)
        off_um, verdicts = image
        places = TARGETS + np.array([1e-3, 0.0]) * np.asarray(off_um, dtype=float)[:, None]
        nothing = np.zeros((N, 2))
        self.measured[PlanStamp(len(self.measured) + 1)] = Measured(
            PLANE.ids, np.asarray(verdicts), places, nothing, nothing,
            np.zeros(N), np.zeros(N), nothing,
        )  # fmt: skip
        return SimpleNamespace(success=True, message="")

    def wait_for(self, condition, timeout_s, what=""):
        assert condition(), what

    def send_targets(self, ids, xy_mm, straight):
        assert straight
        self.corrected.append(list(ids))
        return PlanStamp(99)

    def wait_until_ready(self, stamp, timeout_s):
        if self.correction is not None:
            raise self.correction

    def stops_on_error(self, timeout_s):
        return nullcontext()

    def start(self, timeout_s):
        pass

    def wait_for_outcome(self, stamp, timeout_s):
        return blind()


def blind():
    return PlanOutcome(
        1, PLANE.ids, np.full(N, Outcome.REACHED), np.full(N, Reason.OK), np.zeros(N)
    )


def run(graph, iterations=2):
    return CameraLoop(graph, 10.0, iterations, 1.0).run(PLANE.ids, TARGETS, blind())


SEEN = [Verdict.MEASURED] * N
STUCK = [Verdict.MEASURED] * 2 + [Verdict.NOT_MOVED] + [Verdict.MEASURED] * (N - 3)


def test_a_flagged_robot_is_never_reached_wherever_its_light_is():
    graph = Graph([([50.0] * N, STUCK), ([2.0] * N, SEEN)])
    end = run(graph)
    assert graph.corrected == [[robot for robot in PLANE.ids if robot != 2]]
    assert end.flagged == {2: Verdict.NOT_MOVED} and not end.ended
    assert (end.outcome.outcome[2], end.outcome.reason[2]) == (Outcome.FAILED, Reason.NOT_MOVED)
    others = np.arange(N) != 2
    assert (end.outcome.outcome[others] == Outcome.REACHED).all()
    assert end.images()[-1]["measured"] == N - 1


def test_a_robot_that_is_held_in_a_correction_counts_with_what_the_move_before_it_left():
    graph = Graph([([50.0] * N, SEEN), ([2.0] * 3 + [50.0] + [2.0] * (N - 4), SEEN)])
    held, reason = np.full(N, Outcome.REACHED), np.full(N, Reason.OK)
    held[3], reason[3] = Outcome.HELD, Reason.UNSAFE
    ended = PlanOutcome(1, PLANE.ids, held, reason, np.zeros(N))
    graph.wait_for_outcome = lambda stamp, timeout_s: ended
    end = run(graph, iterations=1)
    assert end.outcome.reason[3] == Reason.UNSAFE
    assert [figures["measured"] for figures in end.images()] == [N, N]
    assert end.images()[-1]["most_um"] == pytest.approx(50.0)


def test_a_correction_that_fails_ends_the_loop_with_what_the_images_showed():
    refused = PlaneRefusal("planner", "no plan today")
    graph = Graph([([50.0, 3.0] + [50.0] * (N - 2), SEEN)], correction=refused)
    end = run(graph)
    assert "no plan today" in end.ended and len(end.errors_mm) == 1
    assert end.corrected == [N - 1]
    assert end.outcome.outcome.tolist() == [
        Outcome.REACHED if row == 1 else Outcome.HELD for row in range(N)
    ]
    assert set(end.outcome.reason[np.arange(N) != 1]) == {Reason.OFF_TARGET}
    np.testing.assert_allclose(end.outcome.error_mm[0], 0.05)
    said = []
    assert show_images(end, said.append)["ended"] == end.ended
    assert any("ended early" in line for line in said)


def test_an_image_is_taken_once_more_and_then_the_loop_ends():
    graph = Graph(["no light", ([2.0] * N, SEEN)])
    assert not run(graph).ended
    end = run(Graph(["no light", "no light", ([2.0] * N, SEEN)]))
    assert "no light" in end.ended and not end.errors_mm
    assert set(end.outcome.reason) == {Reason.NOT_SEEN}


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"iterations": 2}, "needs --tolerance-um"),
        ({"tolerance_um": 10.0, "no_start": True}, "--no-start"),
        ({"tolerance_um": -1.0}, "not a positive number"),
        ({"form": "desi"}, "not given"),
    ],
)
def test_options_that_exclude_each_other_are_refused_before_the_graph_is_waited_for(given, words):
    options = {"tolerance_um": None, "iterations": None, "no_start": False, "results": None}
    options |= {"form": None, "timeout": 1.0} | given
    client = SimpleNamespace(node=None)  # nothing of a graph is there to wait for
    with pytest.raises(PlaneError, match=words):
        _run(client, argparse.Namespace(**options), None)
