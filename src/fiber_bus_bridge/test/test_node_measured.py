# SPDX-License-Identifier: Apache-2.0
"""The bridge hears where a camera saw its robots, and knows how far blind moves may be off."""

import numpy as np
import pytest
from rest_of_graph import COUNTS, PLANE, UNITS, Rest, problem_file

from fiber_core.arm_bounds import arms_within, interval_of_tips
from fiber_core.clearance import levers_of
from fiber_core.outcomes import Outcome, Verdict
from fiber_core.wire_units import WireMotion
from fiber_msgs_py import PlanStamp, layout, measured, targets, topics
from fiber_node import RosClient

pytestmark = pytest.mark.timeout(600)
N = PLANE.n


class Seen(Rest):
    """The other nodes of the graph, and a metrology."""

    def __init__(self, peer, path, **parameters):
        super().__init__(peer, path, **parameters)
        self.measured = topics.MEASURED.publisher(peer.node)
        self.until(lambda: self.measured.get_subscription_count() == 1)

    def tell(self, ns, places, angles, verdict=Verdict.MEASURED, wider_mm=0.0):
        table = measured.Measured(
            PLANE.ids, np.full(N, verdict), places, angles, np.full((N, 2), 1e-3),
            np.where(np.isnan(places[:, 0]), np.nan, 0.01), np.zeros(N),
            np.full((N, 2), wider_mm),
        )  # fmt: skip
        self.measured.publish(measured.encode(table, PlanStamp(ns), self.session))

    def images(self):
        return self.status().values.get("images")

    def wider_mm(self):
        plane = layout.decode(self.received[topics.LAYOUT.name][-1])[0]
        radii = (plane.theta_radius - PLANE.theta_radius, plane.phi_radius - PLANE.phi_radius)
        return np.stack(radii, axis=1)


@pytest.fixture
def peer():
    with RosClient("rest") as peer:
        yield peer


NO_PLACE = np.full((N, 2), np.nan)


def test_what_was_measured_before_a_plan_that_waits_for_orders_is_refused(peer, tmp_path):
    rest = Seen(peer, problem_file(tmp_path))
    rest.ready(9)
    assert rest.call(topics.START).success
    rest.end(9)
    rest.until(lambda: not np.array_equal(rest.counts(), COUNTS))
    before = rest.counts()
    rest.ask_ends(10)  # accepted, without orders yet
    angles = UNITS.to_angles(before) + 0.01
    rest.tell(9, PLANE.centers, angles)
    rest.until(lambda: "plan 0.000000010 has begun since" in rest.status().text)
    assert rest.images() is None and np.array_equal(rest.counts(), before)
    assert rest.call(topics.CLEAR).success
    rest.end(10)
    rest.tell(10, PLANE.centers, angles)
    rest.until(lambda: rest.images() == "1")
    rest.until(lambda: np.array_equal(rest.counts(), UNITS.encoder_counts(PLANE, angles)))


def test_a_robot_that_is_told_at_a_doubtful_place_is_held_at_both(peer, tmp_path):
    rest = Seen(peer, problem_file(tmp_path))
    start = UNITS.to_angles(COUNTS)
    angles, places = start.copy(), np.array(PLANE.centers)
    angles[3] += (0.2, -0.1)  # where it would be had it not moved; its counters say otherwise
    places[3] = np.nan
    rest.tell(9, places, angles, wider_mm=0.02)
    rest.until(lambda: rest.images() == "1")
    rest.until(lambda: rest.wider_mm().any())
    assert np.array_equal(rest.counts()[3], COUNTS[3])
    off = np.abs(angles[3] - start[3]) @ levers_of(PLANE)[3]
    assert rest.wider_mm()[3].min() > 0.99 * (0.02 + off)
    others = np.arange(N) != 3
    np.testing.assert_allclose(rest.wider_mm()[others], 0.02, atol=1e-9)


def ask_straight(rest, ns, straight):
    rest.targets.publish(
        targets.encode(
            PLANE.ids, PLANE.centers + 0.5, PlanStamp(ns), rest.session, straight=straight
        )
    )
    return rest.answer(ns)


def test_outlines_of_a_blind_move_hold_the_errors_of_the_drive_and_those_of_a_correction_do_not(
    peer, tmp_path
):
    rest = Seen(peer, problem_file(tmp_path), blind_um=40.0)
    theta_mm, phi_mm = arms_within(PLANE, interval_of_tips(PLANE, 2.0 * 0.04))
    blind_mm = np.stack([theta_mm, phi_mm], axis=1)
    assert phi_mm.min() > 0.15
    np.testing.assert_allclose(rest.wider_mm(), blind_mm)
    rest.tell(8, NO_PLACE, UNITS.to_angles(COUNTS), Verdict.MISSING, wider_mm=0.03)
    rest.until(lambda: rest.images() == "1")
    rest.until(lambda: np.allclose(rest.wider_mm(), np.hypot(blind_mm, 0.03)))
    assert not ask_straight(rest, 9, straight=True).refused
    rest.until(lambda: np.allclose(rest.wider_mm(), 0.03))
    # the outlines of the certificate are those of the layout
    session = rest.bridge._session
    np.testing.assert_allclose(session.plane.phi_radius, PLANE.phi_radius + 0.03)
    # orders of a correction wait: a blind move would need other outlines
    rest.order(9, WireMotion(UNITS, COUNTS, np.zeros(2 * N + 1), [], []))
    rest.until(lambda: any(each.fraction == 1.0 for each in rest.answers(9)))
    assert ask_straight(rest, 10, straight=False).refused
    assert "while READY" in rest.status().text
    assert rest.call(topics.CLEAR).success
    rest.end(9)
    rest.until(lambda: np.allclose(rest.wider_mm(), np.hypot(blind_mm, 0.03)))


@pytest.mark.parametrize(
    ("straight", "seen", "runs"),
    [(True, True, True), (False, True, False), (True, False, False)],
    ids=["a correction", "a blind move", "a correction of what no image has seen"],
)
def test_what_passes_too_close_for_its_errors_is_held(peer, tmp_path, straight, seen, runs):
    start = np.stack([np.zeros(N), np.full(N, 2.6)], axis=1)
    rest = Seen(peer, problem_file(tmp_path, start), blind_um=700.0)
    counts = UNITS.to_counts(start)
    if seen:
        rest.tell(8, NO_PLACE, start, Verdict.MISSING, wider_mm=0.03)
        rest.until(lambda: rest.images() == "1")
    ask_straight(rest, 9, straight)
    offsets = np.repeat(np.arange(N + 1), 2)[1:]
    orders = WireMotion(UNITS, counts, offsets, np.full(N, 50), np.full(N, 700))
    rest.order(9, orders)
    rest.until(lambda: any(each.fraction == 1.0 for each in rest.answers(9)))
    rest.call(topics.START)
    result, _, _ = rest.end(9)
    assert rest.bridge._session.loaded_plan.started.any() == runs
    assert runs or (result == Outcome.HELD).all()
