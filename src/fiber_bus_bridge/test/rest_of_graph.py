# SPDX-License-Identifier: Apache-2.0
"""A bridge node, and a test in place of the other nodes of the graph."""

import numpy as np
from rclpy.parameter import Parameter

from fiber_bus_bridge.node import BridgeNode
from fiber_core.kinematics import forward
from fiber_core.presets import preset
from fiber_core.problem import Problem, save_problem
from fiber_core.wire_units import WireMotion, WireUnits
from fiber_msgs_py import (
    PlanStamp,
    diagnostics,
    joint_states,
    outcome,
    progress,
    segments,
    session_of,
    targets,
    topics,
)
from fiber_node import DISCRETIZER, PLANNER, Claim

__all__ = [
    "COUNTS",
    "PLANE",
    "START",
    "TICKS",
    "UNITS",
    "VELOCITY",
    "WAIT_S",
    "Rest",
    "problem_file",
    "turning",
]

WAIT_S = 300.0  # the first motion compiles
PLANE = preset("desi", 7)
UNITS = WireUnits.for_plane(PLANE)
# folded: arms are clear of each other at every theta
START = np.stack([np.linspace(-1.0, 1.0, 7), np.full(7, 3.1)], axis=1)
COUNTS = UNITS.to_counts(START)
TICKS, VELOCITY = 50, 700


def turning(ids=PLANE.ids, ticks=TICKS):
    """Orders that turn every theta by the same angle."""
    n = len(ids)
    offsets = np.repeat(np.arange(n + 1), 2)[1:]
    return WireMotion(UNITS, COUNTS[:n], offsets, np.full(n, ticks), np.full(n, VELOCITY))


def problem_file(folder, start=START) -> str:
    """Write a problem with starts and without targets; return the file."""
    path = folder / "problem.npz"
    save_problem(path, Problem(PLANE, start, np.full((7, 2), np.nan)))
    return str(path)


class Rest:
    """The other nodes of the graph: publishes their messages, keeps those of the bridge.

    Its messages are of `session`, at first that of the bridge.
    """

    def __init__(self, peer, path, **parameters):
        self.peer = peer
        self.received = {
            topic.name: peer.collect(topic)
            for topic in (
                topics.LAYOUT,
                topics.TARGETS,
                topics.JOINT_STATES,
                topics.FRAMES,
                topics.OUTCOME,
                topics.DIAGNOSTICS,
                topics.PROGRESS,
            )
        }
        self.segments = topics.SEGMENTS.publisher(peer.node)
        self.targets = topics.TARGETS.publisher(peer.node)
        self.held = topics.HELD_BY_PLANNER.publisher(peer.node)
        self.stages = {role: Claim(peer.node, role) for role in (PLANNER, DISCRETIZER)}
        self.bridge = peer.add_node(BridgeNode, problem=path, **{"time_scale": 0.0} | parameters)
        self.until(
            lambda: (
                self.received[topics.JOINT_STATES.name] and self.received[topics.DIAGNOSTICS.name]
            )
        )
        self.until(lambda: self.segments.get_subscription_count() == 1)
        self.until(lambda: self.received[topics.LAYOUT.name])
        self.session = session_of(self.received[topics.LAYOUT.name][-1])

    def until(self, condition):
        self.peer.wait_for(condition, WAIT_S)

    def status(self):
        return diagnostics.decode(self.received[topics.DIAGNOSTICS.name][-1])[0]

    def counts(self):
        ids, angles, _, _ = joint_states.decode(self.received[topics.JOINT_STATES.name][-1])
        assert np.array_equal(ids, PLANE.ids)
        return UNITS.to_counts(angles)

    def order(self, ns, motion=None, ids=PLANE.ids, attempt=1):
        """Send orders; return those of the progress that come after."""
        self.received[topics.PROGRESS.name].clear()
        stamp = self.stamp_of(ns, attempt)
        self.segments.publish(segments.encode(ids, motion or turning(), stamp, self.session))

    def stamp_of(self, ns, attempt):
        """The stamp of an attempt of a plan, from the targets of the attempt."""
        announced = map(targets.decode_attempt, self.received[topics.TARGETS.name])
        later = [a.stamp for a in announced if (a.plan.ns, a.number) == (ns, attempt)]
        return later[0] if attempt > 1 else PlanStamp(ns)

    def ask(self, ns, ids, xy_mm):
        """Send targets; wait until the bridge has accepted or refused them."""
        self.targets.publish(targets.encode(ids, xy_mm, PlanStamp(ns), self.session))
        return self.answer(ns)

    def answer(self, ns):
        """Wait for progress of a plan; return the first."""
        self.until(lambda: self.answers(ns))
        return self.answers(ns)[0]

    def answers(self, ns):
        decoded = map(progress.decode, self.received[topics.PROGRESS.name])
        return [each for each in decoded if each.attempt.plan.ns == ns]

    def ask_ends(self, ns, motion=None):
        """Send the ends of orders as targets of the robots that move, or a target in vain."""
        motion = motion or turning()
        moves = motion.moves if motion.moves.any() else np.ones(7, dtype=bool)
        ends_mm = forward(PLANE, UNITS.to_angles(motion.end))[1]
        return self.ask(ns, PLANE.ids[moves], ends_mm[moves])

    def ready(self, ns, motion=None):
        """Send orders and wait until they are ready; first their ends, if there are no targets."""
        asked = [PlanStamp.of(m).ns for m in self.received[topics.TARGETS.name]]
        if ns not in asked:
            self.ask_ends(ns, motion)
        self.order(ns, motion)
        self.until(lambda: any(each.fraction == 1.0 for each in self.answers(ns)))

    def name_plan(self, plan):
        self.bridge.set_parameters([Parameter("start_plan", value=plan)])

    def call(self, service):
        client = service.client(self.peer.node)
        self.until(client.service_is_ready)
        future = client.call_async(service.type.Request())
        self.until(future.done)
        return future.result()

    def end(self, ns):
        """Wait for the end of a plan; return outcome, reason and error of its robots."""
        self.until(
            lambda: any(PlanStamp.of(m).ns == ns for m in self.received[topics.OUTCOME.name])
        )
        message = next(m for m in self.received[topics.OUTCOME.name] if PlanStamp.of(m).ns == ns)
        ids, result, reason, error_mm = outcome.decode(message)
        assert np.array_equal(ids, PLANE.ids)
        return result, reason, error_mm
