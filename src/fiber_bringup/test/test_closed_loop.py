# SPDX-License-Identifier: Apache-2.0
"""The loop in the graph: blind move, image, correction, image; and images that cannot be used."""

import json

import numpy as np
import pytest
from night import COMPILE_S, WAIT_S, Night
from rclpy.parameter import Parameter

from fiber_bus_bridge.plant import touching
from fiber_client.errors import PlaneError, PlaneRefusal
from fiber_client.reconfigure import main as reconfigure
from fiber_client.turning import Turning
from fiber_client.wiring import main as wiring
from fiber_core.arm_bounds import arms_within, interval_of_tips
from fiber_core.clearance import neighbour_pairs
from fiber_core.outcomes import Outcome, Reason, Verdict
from fiber_metrology import ImageError
from fiber_metrology.knowledge import Knowledge
from fiber_msgs_py import PlanStamp, layout, spots, targets, topics, turns
from fiber_recording import load_recording
from fiber_recording.node import recording_name


@pytest.fixture(scope="module")
def night(tmp_path_factory, new_domain):
    made = Night(tmp_path_factory.mktemp("night"), new_domain())
    yield made
    made.end()


@pytest.fixture(scope="module")
def first(night):
    """The first field: its robots, targets and end; some joints stick in this motion."""
    ids, xy_mm = night.field(1)
    blind = night.client.reconfigure(ids, xy_mm, COMPILE_S)
    return ids, xy_mm, blind, night.loop().run(ids, xy_mm, blind)


def test_corrections_bring_fibres_to_their_targets_by_what_the_camera_sees(night, first):
    ids, xy_mm, blind, end = first
    # the counters see nothing; pairs whose arms may touch as they stand are held
    asked = blind.of(ids)
    assert asked.count(Outcome.REACHED) + asked.count(Outcome.HELD) == len(ids)
    assert asked.count(Outcome.HELD) <= 2
    rms_um = [figures["rms_um"] for figures in end.images()]
    assert rms_um[0] > 25.0 and rms_um[-1] < 8.0
    assert len(end.errors_mm) == len(end.corrected) + 1 and not end.ended
    # the judge knows where the arms are
    ended = end.outcome.of(ids)
    off_um = 1e3 * np.hypot(*(night.true_fibres()[night.client.plane.index_of(ids)] - xy_mm).T)
    reached = ended.outcome == Outcome.REACHED
    assert reached.sum() > 0.85 * len(ids) and off_um[reached].max() < 30.0
    told = np.isfinite(ended.error_mm)
    assert np.abs(1e3 * ended.error_mm - off_um)[told].max() < 20.0
    assert (off_um[ended.reason == Reason.NOT_MOVED] > 300.0).all()


def test_the_recording_of_the_blind_move_has_the_images_after_it_and_its_corrections(night, first):
    _, _, blind, end = first
    path = night.recordings / recording_name(PlanStamp(blind.stamp_ns))

    def images():
        found = load_recording(path).images if path.exists() else None
        return 0 if found is None else len(found.place_mm)

    night.client.wait_for(lambda: images() >= len(end.places), WAIT_S)
    found = load_recording(path).images
    np.testing.assert_allclose(found.place_mm, end.places, atol=1e-4)
    told = np.isfinite(found.place_mm).all(axis=2)
    off_um = 1e3 * np.hypot(*np.moveaxis(found.place_mm - found.true_mm, 2, 0))
    assert np.isfinite(found.true_mm).all() and 0.0 < np.median(off_um[told]) < 20.0
    names = np.vectorize(found.names.get)(found.verdict)
    flagged = np.isin(night.client.plane.ids, list(end.flagged))
    assert all("not_moved" in name for name in names[0, flagged])
    assert (names[0, ~flagged] == "measured").mean() > 0.8


def test_images_after_a_refused_plan_are_of_the_plan_that_was_carried_out(night, first):
    ids, xy_mm = night.field(12)
    blind = night.client.reconfigure(ids, xy_mm, WAIT_S)
    plane = night.client.plane
    late = targets.encode(plane.ids, plane.centers + 1.0, PlanStamp(5), night.client.session)
    night.client.send_message(late)
    night.client.wait_for(lambda: night.client.refusals.get(PlanStamp(5)), WAIT_S)
    end = night.loop().run(ids, xy_mm, blind)
    assert len(end.places) > 1
    path = night.recordings / recording_name(PlanStamp(blind.stamp_ns))

    def images():
        found = load_recording(path).images if path.exists() else None
        return 0 if found is None else len(found.place_mm)

    night.client.wait_for(lambda: images() >= len(end.places), WAIT_S)


def test_a_robot_that_sticks_is_flagged_and_an_obstacle_and_the_others_go_on(night, first):
    ids, _, _, end = first
    sticks = night.camera._mechanics.still_in == 0
    stuck = night.client.plane.ids[sticks.any(axis=1)]
    assert end.flagged and set(end.flagged) <= set(stuck.tolist())
    for robot, verdict in end.flagged.items():
        theta, phi = sticks[night.client.plane.index_of([robot])[0]]
        assert (
            verdict
            == {
                (True, True): Verdict.NOT_MOVED,
                (True, False): Verdict.THETA_NOT_MOVED,
                (False, True): Verdict.PHI_NOT_MOVED,
            }[theta, phi]
        )
    flagged = np.isin(night.client.plane.ids, list(end.flagged))
    assert not night.client.plane.enabled[flagged].any()
    assert night.client.plane.enabled[~flagged].all()
    ended = end.outcome.of(list(end.flagged))
    assert set(ended.reason) == {Reason.NOT_MOVED} and set(ended.outcome) == {Outcome.FAILED}
    again = night.field(2)
    assert not np.isin(again[0], list(end.flagged)).any()
    blind = night.client.reconfigure(*again, WAIT_S)
    assert night.loop().run(*again, blind).images()[-1]["rms_um"] < 8.0


def test_a_dark_fibre_is_told_and_its_outlines_are_wider(night, first):
    ids, _, _, end = first
    dark = ~night.camera._lit
    assert dark.any()
    ended = end.outcome.of(night.client.plane.ids[dark])
    assert set(ended.reason) == {Reason.NOT_SEEN} and np.isnan(ended.error_mm).all()
    exact = night.graph.nodes[0]._hardware.plane
    blind_mm = arms_within(exact, interval_of_tips(exact, 2.0 * 0.04))[1]
    wider_mm = np.sqrt((night.client.plane.phi_radius - exact.phi_radius) ** 2 - blind_mm**2)
    assert wider_mm[dark].min() > 2.0 * np.median(wider_mm[~dark]) > 0.0


def test_the_command_corrects_and_prints_what_the_images_show(night, first, monkeypatch, capfd):
    monkeypatch.setenv("ROS_DOMAIN_ID", str(night.domain))
    assert reconfigure(["random:4", "--tolerance-um", "12", "--iterations", "2", "--json"]) == 0
    printed = json.loads(capfd.readouterr().out.splitlines()[-1])
    assert printed["images"][-1]["rms_um"] < 8.0 < printed["images"][0]["rms_um"]
    assert printed["reached"] + printed["held"] == printed["asked"] and not printed["ended"]
    assert reconfigure(["random:4", "--iterations", "2"]) == 1


class Shots:
    """A camera of the test: it answers expose with the spots that it was given."""

    def __init__(self, night):
        self.night, self.node = night, night.client.node
        self.spots = None  # None for a camera that stops
        self.stamp_ns = None  # of the exposures; the present by default
        self.publisher = topics.SPOTS.publisher(self.node)
        night.metrology.set_parameters([Parameter("expose", value=False)])

    def image(self):
        """Ask for an image while the given spots come; return the answer of the metrology."""
        client = self.night.client
        asks = topics.MEASURE.client(self.node)
        client.wait_for(asks.service_is_ready, WAIT_S)
        stale = self.night.metrology._camera._exposures
        stale[:] = [ImageError("of before the call")]
        future = asks.call_async(topics.MEASURE.type.Request())
        sent = 0

        def done():
            nonlocal sent
            if self.spots is not None and sent < 3 and (not stale or sent):
                ns = client.now_ns() if self.stamp_ns is None else self.stamp_ns
                self.publisher.publish(spots.encode(*self.spots, PlanStamp(ns)))
                sent += 1
            return future.done()

        client.wait_for(done, WAIT_S, "answer of measure")
        return future.result()


@pytest.fixture
def shots(night, first):
    made = Shots(night)
    yield made
    night.metrology.set_parameters([Parameter("expose", value=True)])


def seen_by(night, shift_mm=0.0, plane=1.0):
    """Spots of the plane as it is, shifted, or of another plane."""
    tips = night.true_fibres()
    places = (tips + shift_mm) * plane
    fiducials = (night.camera._fiducials + shift_mm) * plane
    return night.camera._camera.expose(
        places, fiducials, night.camera._lit, night.camera._rng
    ).spots


@pytest.fixture
def learned(monkeypatch):
    """The images that the metrology has learned from."""
    images, learn = [], Knowledge.learn
    monkeypatch.setattr(Knowledge, "learn", lambda *given: images.append(given) or learn(*given))
    return images


@pytest.mark.parametrize(
    ("make", "reason"),
    [
        (lambda night: None, "gave 0 of 3 exposures in 1 s"),
        (lambda night: (np.zeros((0, 2)), np.zeros(0), np.zeros(0)), "no light"),
        (lambda night: seen_by(night, shift_mm=3.0), "is shifted by"),
        (lambda night: seen_by(night, plane=-1.0), "another plane"),
    ],
    ids=["a camera that stops", "no light", "a shifted image", "another plane"],
)
def test_an_image_that_cannot_be_used_is_refused_and_nothing_is_learned(
    night, shots, learned, make, reason
):
    session = night.graph.nodes[0]._session
    before, outlines = session.counts.copy(), session.plane.phi_radius.copy()
    shots.spots = make(night)
    most_s = WAIT_S if shots.spots is not None else 1.0
    night.metrology.set_parameters([Parameter("timeout_s", value=most_s)])
    answer = shots.image()
    assert not answer.success and reason in answer.message
    assert not learned
    assert np.array_equal(session.counts, before)
    assert np.array_equal(session.plane.phi_radius, outlines)


def test_exposures_of_before_the_motion_do_not_count_however_late_they_come(night, shots, learned):
    early = seen_by(night)
    early_ns = night.client.now_ns()
    night.client.reconfigure(*night.field(5), WAIT_S)
    night.metrology.set_parameters([Parameter("timeout_s", value=1.0)])
    shots.spots, shots.stamp_ns = early, early_ns
    answer = shots.image()
    assert not answer.success and "gave 0 of 3 exposures" in answer.message
    assert "before the robots rested" in answer.message
    assert not learned
    night.metrology.set_parameters([Parameter("timeout_s", value=COMPILE_S)])
    shots.spots, shots.stamp_ns = seen_by(night), None
    assert shots.image().success and len(learned) == 1


def test_a_measurement_that_the_bridge_refuses_teaches_the_metrology_nothing(night, first, learned):
    inputs = night.graph.nodes[0]._attempts.inputs
    newest = inputs.newest
    inputs.newest = PlanStamp(night.client.now_ns() + 10**9)  # as if a plan had begun since
    with pytest.raises(PlaneRefusal, match="has not taken it over: measured refused: it is of"):
        night.loop().take_image()
    assert not learned
    inputs.newest = newest
    night.loop().take_image()
    assert len(learned) == 1


def test_what_the_bridge_may_take_over_after_the_time_out_is_forgotten(night, first):
    night.loop().take_image()
    bridge, before = night.graph.nodes[0], night.metrology._knowledge
    taken = bridge._measured._images
    night.metrology.set_parameters([Parameter("timeout_s", value=2.0)])
    with bridge._lock:  # it is at work on something that takes longer
        with pytest.raises(PlaneRefusal, match="has not taken it over in 2 s"):
            night.loop().take_image()
    night.client.wait_for(lambda: bridge._measured._images == taken + 1, WAIT_S)
    night.metrology.set_parameters([Parameter("timeout_s", value=COMPILE_S)])
    assert night.metrology._knowledge is not before and not night.metrology._knowledge._lit.any()
    # the counters that the bridge has set come later: an image before them would be refused
    told = bridge._session.units.to_angles(bridge._session.counts)
    heard = night.metrology._motions.at_rest
    night.client.wait_for(lambda: np.allclose(heard().counters, told, atol=1e-9), WAIT_S)
    night.loop().take_image()
    ids, xy_mm = night.field(11)
    blind = night.client.reconfigure(ids, xy_mm, WAIT_S)
    assert night.loop().run(ids, xy_mm, blind).images()[-1]["rms_um"] < 8.0


def test_after_home_an_image_expects_robots_that_may_not_have_moved(night, first):
    night.loop().take_image()
    before = np.array(night.client.angles)
    night.client.home(WAIT_S)
    night.loop().take_image()
    learned = night.metrology._knowledge
    night.client.wait_for(lambda: not np.allclose(night.client.angles, before), WAIT_S)
    # a second image has the counters of the first: nothing moved between them
    assert learned._begin is None
    ids, xy_mm = night.field(9)
    blind = night.client.reconfigure(ids, xy_mm, WAIT_S)
    assert night.loop().run(ids, xy_mm, blind).images()[-1]["rms_um"] < 8.0


def test_outlines_hold_the_errors_of_a_blind_move_and_in_a_correction_what_was_measured(
    night, first
):
    layouts = night.client.collect(topics.LAYOUT)
    ids, xy_mm = night.field(10)
    exact = night.graph.nodes[0]._hardware.plane
    blind_mm = arms_within(exact, interval_of_tips(exact, 2.0 * 0.04))[1]
    blind = night.client.reconfigure(ids, xy_mm, WAIT_S)
    session = night.graph.nodes[0]._session
    assert (session.plane.phi_radius - exact.phi_radius >= blind_mm - 1e-9).all()
    layouts.clear()
    end = night.loop(iterations=1).run(ids, xy_mm, blind)
    assert len(end.corrected) == 1
    radii = [layout.decode(each)[0].phi_radius - exact.phi_radius for each in layouts]
    assert min(float(np.median(each)) for each in radii) < 0.5 * blind_mm.min()
    assert (radii[-1] >= blind_mm - 1e-9).all()


def test_without_a_camera_the_loop_ends_with_its_reason_and_its_results(night, first):
    ids, xy_mm = night.field(7)
    blind = night.client.reconfigure(ids, xy_mm, WAIT_S)
    night.camera.trigger_deactivate()
    end = night.loop().run(ids, xy_mm, blind)
    night.camera.trigger_activate()
    assert "the camera is inactive" in end.ended and end.errors_mm == []
    ended = end.outcome.of(ids)
    assert set(ended.reason) == {Reason.NOT_SEEN} and set(ended.outcome) == {Outcome.HELD}
    # nothing was lost: the next image finds the robots
    end = night.loop().run(ids, xy_mm, blind)
    assert end.images()[-1]["rms_um"] < 8.0 and not end.ended


def test_no_image_is_taken_while_a_plan_waits(night, first):
    stamp = night.client.send_targets(*night.field(8))
    night.client.wait_until_ready(stamp, WAIT_S)
    with pytest.raises(PlaneRefusal, match="has not ended: start it, or clear"):
        night.loop().take_image()
    night.client.call_service(topics.CLEAR, WAIT_S)
    night.client.wait_for_outcome(stamp, WAIT_S)
    night.loop().take_image()


def test_impossible_loops_are_refused(night):
    for tolerance_um, iterations in ((0.0, 1), (np.nan, 1), (5.0, -1)):
        with pytest.raises(PlaneError, match="tolerance|iterations"):
            night.loop(tolerance_um, iterations)


def test_code_words_tell_swapped_plugs_on_a_running_plane(night, first, monkeypatch, capfd):
    client, camera, plane = night.client, night.camera, night.client.plane
    night.loop().take_image()  # with it robots at rest are known best
    usable, pairs = plane.enabled & camera._lit, neighbour_pairs(plane)
    pairs = pairs[(pairs < plane.n).all(axis=1)]
    a, b = pairs[usable[pairs].all(axis=1)][3]
    before, counted = night.true_fibres(), client.angles
    swapped = np.arange(plane.n)
    swapped[[a, b]] = b, a
    exact, truth = night.graph.nodes[0]._hardware.plane, camera._truth.since(0)
    since, touched = truth.next, touching(exact, truth, camera._mechanics).unsafe
    camera._arm_of, own = swapped, camera._arm_of
    images = client.measured.copy()
    monkeypatch.setenv("ROS_DOMAIN_ID", str(night.domain))
    code = wiring(["--timeout", str(COMPILE_S), "--images", "16"])
    told, ids = capfd.readouterr().out, plane.ids
    assert code == 1 and "image 16 of 16" in told
    for one, other in ((a, b), (b, a)):
        assert f"robot {ids[one]}: orders move the fibre at the place of robot {ids[other]}" in told
    assert told.count("these two are swapped") == 2 and "three robots" not in told
    counts = json.loads(told.splitlines()[-1])
    assert counts["not_turned"] == 0 and counts["swapped"] == 2
    assert counts["in_place"] >= 0.9 * usable.sum() - 2
    # all are back, whatever moved them, nothing was learned of it, and no true arms have touched
    off_um = 1e3 * np.hypot(*(night.true_fibres() - before).T)
    assert off_um.max() < 10.0 and np.abs(client.angles - counted).max() < 1e-4
    assert client.measured.keys() == images.keys()
    truth = camera._truth.since(0)
    row = truth.moves.row.copy()
    row[since:] = swapped[row[since:]]
    moved = truth._replace(moves=truth.moves._replace(row=row))
    assert not (touching(exact, moved, camera._mechanics).unsafe & ~touched).any()
    camera._arm_of = own


def test_turns_of_another_session_or_plane_are_refused_and_none_waits(night, first):
    client = night.client
    publisher = topics.TURNS.publisher(client.node)
    client.wait_for(lambda: publisher.get_subscription_count() > 0, WAIT_S)
    now_ns = client.now_ns()
    for ns, ids, session, why in (
        (now_ns, [1], f"session_{7:024x}", "turns: of session_0"),
        (now_ns + 1, [99_999], client.session, "robot 99999"),
        (73, [1], client.session, "not older"),
    ):
        publisher.publish(turns.encode(ids, [1], PlanStamp(ns), session))
        with pytest.raises(PlaneRefusal, match=why):
            client.wait_until_ready(PlanStamp(ns), WAIT_S)
    with pytest.raises(PlaneRefusal, match="no turns wait"):
        client.call_service(topics.TURN, WAIT_S)
    with pytest.raises(PlaneRefusal, match="no robot that can be commanded is at an unknown"):
        Turning(client, WAIT_S).turn_unplaced()
    heard = PlanStamp(client.now_ns())
    publisher.publish(turns.encode(client.plane.ids[:1], [1], heard, client.session))
    client.wait_until_ready(heard, WAIT_S)
    client.call_service(topics.CLEAR, WAIT_S)  # and forgets it
    with pytest.raises(PlaneRefusal, match="clear, configure, home or another motion made this"):
        client.call_service(topics.TURN, WAIT_S)


def test_spots_in_the_pixels_of_images_close_the_loop_as_lists_of_spots_do(night, first):
    metrology, camera = night.metrology, night.camera
    metrology.set_parameters([Parameter("pixels", value=True)])
    assert metrology.trigger_deactivate() and metrology.trigger_cleanup()  # it hears another topic
    assert metrology.trigger_configure() and metrology.trigger_activate()
    night.client.wait_for(lambda: camera._images.get_subscription_count() == 1, WAIT_S)
    night.client.wait_for(lambda: camera._spots.get_subscription_count() == 0, WAIT_S)
    night.client.wait_for(lambda: metrology._knowledge is not None, WAIT_S)
    ids, xy_mm = night.field(13)
    blind = night.client.reconfigure(ids, xy_mm, WAIT_S)
    end = night.loop().run(ids, xy_mm, blind)
    assert end.images()[-1]["rms_um"] < 8.0 < end.images()[0]["rms_um"] and not end.ended
    off_um = 1e3 * np.hypot(*(end.places[-1] - night.true_fibres()).T)
    assert np.isfinite(off_um).sum() > 0.85 * len(ids) and np.nanmedian(off_um) < 8.0
    # a closed shutter: pixels without light are refused, and nothing is learned
    camera._lit, lit = np.zeros_like(camera._lit), camera._lit
    fiducials, camera._fiducials = camera._fiducials, np.zeros((0, 2))
    with pytest.raises(PlaneRefusal, match="no light, or the shutter was closed"):
        night.loop().take_image()
    camera._lit, camera._fiducials = lit, fiducials


def test_a_metrology_that_begins_between_targets_and_motion_names_a_joint_that_sticks(night, first):
    client, metrology, camera = night.client, night.metrology, night.camera
    ids, xy_mm = night.field(14)
    far = np.hypot(*(night.true_fibres()[client.plane.index_of(ids)] - xy_mm).T)
    row = client.plane.index_of(ids[camera._lit[client.plane.index_of(ids)] & (far > 3.0)][:1])[0]
    stamp = client.send_targets(ids, xy_mm)
    client.wait_until_ready(stamp, WAIT_S)
    assert metrology.trigger_deactivate() and metrology.trigger_cleanup()
    assert metrology.trigger_configure() and metrology.trigger_activate()
    client.wait_for(lambda: metrology._motions._at_rest, WAIT_S)
    mechanics, stuck = camera._mechanics, np.array(camera._mechanics.stuck_from)
    stuck[row] = 0  # both joints of this robot do not turn any more
    camera._mechanics = mechanics.with_(stuck_from=stuck)
    client.start(WAIT_S)
    client.wait_for_outcome(stamp, WAIT_S)
    image = night.loop().take_image()
    assert image.verdict[np.flatnonzero(image.ids == client.plane.ids[row])[0]] == Verdict.NOT_MOVED
    camera._mechanics = mechanics
