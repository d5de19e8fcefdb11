"""A bridge node, and a test in place of the other nodes of the graph."""

import numpy as np

from fiber_bus_bridge.node import BridgeNode
from fiber_core.presets import preset
from fiber_core.problem import Problem, save_problem
from fiber_core.wire_units import WireMotion, WireUnits
from fiber_msgs_py import (
    PlanStamp,
    diagnostics,
    joint_states,
    outcome,
    segments,
    targets,
    topics,
)

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
    """The other nodes of the graph: publishes their messages, keeps those of the bridge."""

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
        self.bridge = peer.add_node(BridgeNode, problem=path, **{"time_scale": 0.0} | parameters)
        self.until(
            lambda: (
                self.received[topics.JOINT_STATES.name] and self.received[topics.DIAGNOSTICS.name]
            )
        )
        self.until(lambda: self.segments.get_subscription_count() == 1)

    def until(self, condition):
        self.peer.wait_for(condition, WAIT_S)

    def status(self):
        return diagnostics.decode(self.received[topics.DIAGNOSTICS.name][-1])[0]

    def counts(self):
        ids, angles, _, _ = joint_states.decode(self.received[topics.JOINT_STATES.name][-1])
        assert np.array_equal(ids, PLANE.ids)
        return UNITS.to_counts(angles)

    def order(self, ns, motion=None, ids=PLANE.ids, attempt=1):
        self.received[topics.PROGRESS.name].clear()
        stamp = self.stamp_of(ns, attempt)
        self.segments.publish(segments.encode(ids, motion or turning(), stamp))

    def stamp_of(self, ns, attempt):
        """The stamp of an attempt of a plan, from the targets of the attempt."""
        announced = map(targets.decode_attempt, self.received[topics.TARGETS.name])
        later = [a.stamp for a in announced if (a.plan.ns, a.number) == (ns, attempt)]
        return later[0] if attempt > 1 else PlanStamp(ns)

    def ask(self, ns, ids, xy_mm):
        self.targets.publish(targets.encode(ids, xy_mm, PlanStamp(ns)))
        self.until(self.targets.wait_for_all_acked)

    def ready(self, ns, motion=None):
        self.order(ns, motion)
        self.until(lambda: self.received[topics.PROGRESS.name])

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
