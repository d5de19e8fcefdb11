# SPDX-License-Identifier: Apache-2.0
"""The recorder in a running graph: its recordings agree with the graph and the frames."""

import os
import select

import numpy as np
import pytest
from rcl_interfaces.srv import GetParameters

from fiber_bringup.processes import Processes
from fiber_core.clearance import Safety, certify
from fiber_core.outcomes import Outcome, Reason
from fiber_core.presets import preset
from fiber_core.wire_units import WireUnits
from fiber_discretizer import joint_corridors
from fiber_msgs_py import PlanStamp, joint_states, layout, outcome, progress, targets, topics
from fiber_node import BRIDGE, Claim, RosClient
from fiber_recording import EventKind
from fiber_recording.node import RecorderNode, recording_name

pytestmark = pytest.mark.timeout(900)  # the first plan of all compiles every core


def test_the_recorded_motion_is_that_of_the_bytes(run):
    motion = run.done.motion
    for name in ("start", "offsets", "ticks", "velocity"):
        np.testing.assert_array_equal(getattr(motion, name), getattr(run.replayed.motion, name))
    np.testing.assert_array_equal(motion.start, run.before)
    np.testing.assert_array_equal(motion.end, run.after)
    np.testing.assert_array_equal(run.done.started, run.replayed.started)
    assert run.done.started.all() and motion.moves.any()


def test_the_recording_has_targets_and_outcomes(run):
    problem = run.done.problem
    np.testing.assert_array_equal(problem.plane.ids[problem.asked], run.targets[0])
    np.testing.assert_allclose(problem.targets[problem.asked], run.targets[1])
    np.testing.assert_array_equal(run.done.outcome, run.ended.outcome)
    np.testing.assert_allclose(run.done.error_mm, run.ended.error_mm)
    about = run.done.about
    assert (about["seed"], about["planner"], about["plan_ns"]) == (5, "direct", run.ended.stamp_ns)
    assert problem.plane.name == "desi" and about["notes"] == []
    assert about["report"]["reached"] == run.ended.count(Outcome.REACHED)


def test_the_certificate_belongs_to_the_motion(run):
    certificate = certify(run.done.problem.plane, run.done.executed, Safety())
    assert run.done.about["certificate"]["ok"] is certificate.ok is True
    assert run.done.about["report"]["min_clearance_mm"] == certificate.min_gap_mm


def test_the_corridors_belong_to_the_orders(run):
    recording = run.done
    exact = joint_corridors(recording.problem.plane, recording.executed, Safety())
    for name in ("low", "high"):
        recorded, bound = getattr(recording.corridors, name), getattr(exact, name)
        np.testing.assert_allclose(recorded, bound, atol=1.1e-3)  # rounded inwards
    assert (exact.high - exact.low).max() > 1.0
    assert run.home.corridors is None  # home does not pass the discretizer
    assert run.replaced.corridors is not None


def test_planned_curves_begin_and_end_with_the_motion(run):
    planned, motion = run.done.planned, run.done.executed
    np.testing.assert_allclose(planned.start, motion.start, atol=1e-5)
    np.testing.assert_allclose(planned.end, motion.end, atol=2e-3)


def test_encoders_follow_the_orders(run):
    measured, motion, units = run.done.measured, run.done.executed, run.done.units
    moving = measured.time_us > 0
    assert moving.sum() > len(run.before) and set(measured.row[moving]) == set(
        range(len(run.before))
    )
    exact = np.array(
        [motion(t)[r] for t, r in zip(measured.time_us[moving] * 1e-6, measured.row[moving])]
    )
    off = np.abs(units.to_angles(measured.counts[moving]) - exact)
    # a frame lasts 0.2 ms, a robot starts up to 20 us late: at 3 rad/s less than a milliradian
    assert off.max() < 1e-3


def test_all_frames_are_counted_and_go_is_an_event(run):
    load, events = run.done.load, run.done.events
    assert load.frames.sum() > 3 * len(run.before) and load.bytes.sum() > 20 * len(run.before)
    assert load.edges_s[0] < 0 < load.edges_s[-1]
    assert events.kind.tolist() == [EventKind.GO]
    assert -0.2 < events.time_s[0] < 0.0  # the countdown begins there
    assert not events.unexpected.any()
    assert run.done.about["codes"]["fault"]["33"] == "memory"


def test_a_stopped_plan_is_recorded_as_far_as_it_went(run):
    stopped = run.stopped
    kinds = stopped.events.kind.tolist()
    assert kinds.count(EventKind.GO) == 1 and kinds.count(EventKind.STOP) >= 1
    at_s = stopped.events.time_s[kinds.index(EventKind.STOP)]
    # robots receive STOP at its end, and stand where their encoders say
    assert 0 < at_s < stopped.executed.makespan_s < at_s + 3e-4
    assert any("stopped at" in note for note in stopped.about["notes"])
    assert (stopped.reason == Reason.STOPPED).any()
    np.testing.assert_array_equal(stopped.outcome, run.halted.outcome)
    np.testing.assert_array_equal(stopped.phases[-1].end, run.at_rest)
    np.testing.assert_allclose(
        stopped.executed.end, stopped.units.to_angles(run.at_rest), atol=1e-12
    )


def test_home_is_recorded_without_targets(run):
    home = run.home
    assert not home.problem.asked.any() and home.planned is None
    assert home.started.any() and (home.executed.end[:, 1] > 3.0).any()
    np.testing.assert_array_equal(home.motion.start, run.after)


def test_a_plan_that_was_replaced_is_recorded_as_one_that_did_not_run(run):
    replaced = run.replaced
    assert not replaced.started.any() and replaced.executed.makespan_s == 0.0
    assert replaced.problem.asked.any() and replaced.planned is not None
    assert (replaced.reason == Reason.STOPPED).any()
    assert replaced.about["notes"] == ["no frames were received: no robot was started"]
    assert replaced.load.frames.sum() == 0 and len(replaced.events.kind) == 0


class Bridge:
    """What a recorder hears of a bridge: a plane at rest, and plans that end."""

    def __init__(self, peer):
        self.plane = preset("desi", 7)
        self._ended = topics.OUTCOME.publisher(peer.node)
        self.kept = topics.LAYOUT.publisher(peer.node), topics.JOINT_STATES.publisher(peer.node)
        self.begin(peer.node)

    def begin(self, node):
        self.claim = Claim(node, BRIDGE)
        self.now_ns, self.session = node.get_clock().now().nanoseconds, self.claim.id
        layouts, states = self.kept
        ids, still, units = self.plane.ids, np.zeros((7, 2)), WireUnits.for_plane(self.plane)
        layouts.publish(layout.encode(self.plane, units, PlanStamp(self.now_ns), self.session))
        states.publish(joint_states.encode(ids, still + 3.0, still, self.now_ns, self.session))

    def restart(self, peer):
        """Be another bridge, with a session of its own."""
        self.claim.release()
        self.begin(peer.node)

    def end(self, stamp):
        held = np.full(7, Outcome.HELD), np.full(7, Reason.NO_TARGET), np.full(7, np.nan)
        self._ended.publish(outcome.encode(self.plane.ids, *held, stamp, self.session))


def test_a_recorder_that_writes_answers_at_once(tmp_path):
    with RosClient("bridge") as peer, Processes(tmp_path) as nodes:
        bridge, reports = Bridge(peer), peer.collect(topics.PROGRESS)
        stamp = PlanStamp(bridge.now_ns + 3600 * 10**9)
        slow = tmp_path / (recording_name(stamp) + ".part")
        os.mkfifo(slow)  # it opens when it is read
        nodes.start("fiber_recording", "recorder", {"folder": str(tmp_path)})
        asked = peer.node.create_client(GetParameters, "recorder/get_parameters")
        peer.wait_for(asked.service_is_ready, 60.0, "the recorder")
        bridge.end(stamp)
        peer.wait_for(
            lambda: any("writing" in each.text for each in map(progress.decode, reports)),
            60.0,
            "a recording that is being written",
        )
        answer = asked.call_async(GetParameters.Request(names=["folder"]))
        peer.wait_for(answer.done, 20.0, "an answer of the recorder")
        reader = os.open(slow, os.O_RDONLY | os.O_NONBLOCK)
        peer.wait_for(lambda: select.select([reader], [], [], 0)[0], 20.0, "the recording")
        os.set_blocking(reader, True)
        with open(reader, "rb") as file:
            assert file.read()


def test_an_outcome_that_is_told_again_leaves_the_recording_as_it_is(tmp_path):
    with RosClient("bridge") as peer:
        bridge = Bridge(peer)
        peer.add_node(RecorderNode, folder=str(tmp_path))
        stamps = [PlanStamp(bridge.now_ns + k * 10**9) for k in (3600, 3700)]
        paths = [tmp_path / recording_name(stamp) for stamp in stamps]
        bridge.end(stamps[0])
        peer.wait_for(paths[0].exists, 60.0, "a recording")
        paths[0].unlink()
        for stamp in stamps:  # a bridge tells of the plan of the bridge before
            bridge.end(stamp)
        peer.wait_for(paths[1].exists, 60.0, "a recording of the next plan")
        assert not paths[0].exists()


def test_another_plan_with_the_stamp_of_an_earlier_one_has_a_recording_of_its_own(tmp_path):
    with RosClient("bridge") as peer:
        bridge = Bridge(peer)
        peer.add_node(RecorderNode, folder=str(tmp_path))
        sender = topics.TARGETS.publisher(peer.node)
        peer.wait_for(sender.get_subscription_count, 60.0, "the recorder")
        stamp = PlanStamp(bridge.now_ns + 3600 * 10**9)

        def ask():
            xy_mm = bridge.plane.centers + 3.0
            sender.publish(targets.encode(bridge.plane.ids, xy_mm, stamp, bridge.session))
            peer.wait_quietly(0.5, lambda: 0)

        first, second = (tmp_path / recording_name(stamp, number) for number in (1, 2))
        ask()
        bridge.end(stamp)
        peer.wait_for(first.exists, 60.0, "a recording")
        bridge.restart(peer)  # and its clock was set back
        ask()
        bridge.end(stamp)
        peer.wait_for(second.exists, 60.0, "a recording of the other plan")
        assert sorted(path.name for path in tmp_path.iterdir()) == sorted([first.name, second.name])


def test_a_plan_that_the_recorder_missed_is_named_and_keeps_the_recording_it_may_have(tmp_path):
    with RosClient("bridge") as peer:
        bridge, reports = Bridge(peer), peer.collect(topics.PROGRESS)
        before, after = PlanStamp(bridge.now_ns), PlanStamp(bridge.now_ns + 3600 * 10**9)
        for stamp in (before, after):
            bridge.end(stamp)
        peer.add_node(RecorderNode, folder=str(tmp_path))
        later = tmp_path / recording_name(after)
        peer.wait_for(later.exists, 60.0, "the recording of a plan that ended later")
        assert [path.name for path in tmp_path.iterdir()] == [later.name]

        def refusals():
            return [each for each in map(progress.decode, reports) if each.refused]

        peer.wait_for(refusals, 60.0, "the plan that was not recorded")
        refused = refusals()
        assert [each.attempt.plan for each in refused] == [before]
        assert "not recorded: this recorder began after it" in refused[0].text
