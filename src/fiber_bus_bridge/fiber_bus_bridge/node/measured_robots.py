# SPDX-License-Identifier: Apache-2.0
"""Takes over where a camera saw the robots: counters, outlines, and robots that do not follow."""

from collections.abc import Callable

import numpy as np
from sensor_msgs.msg import PointCloud2

from fiber_bus_bridge.availability import Availability
from fiber_bus_bridge.errors import SessionError
from fiber_bus_bridge.measured_places import place_robots
from fiber_bus_bridge.node.attempts import Attempts
from fiber_bus_bridge.node.outlines import Outlines
from fiber_bus_bridge.node.publishers import Publishers
from fiber_bus_bridge.session import Session
from fiber_core.clearance import levers_of
from fiber_core.errors import FiberError
from fiber_core.focal_plane import FocalPlane
from fiber_core.outcomes import STILL, Reason, Verdict
from fiber_msgs_py import Attempt, MessageError, PlanStamp, measured
from fiber_node import Reporter

__all__ = ["MeasuredRobots"]

_NAMED = 5


class MeasuredRobots:
    """Tells robots at rest where the camera has seen them; nothing moves by it.

    Robots that the camera saw at a certain place count from there. All outlines hold the arms
    within their intervals from then on, in the layout and in every certificate. A robot that did
    not move when it was told to is left out of plans until the service clear or configure.

    Args:
        session: the session with the robots.
        exact: the plane with outlines as they are.
        availability: the robots that can be commanded.
        attempts: the plans that wait, or are or were under way.
        outlines: the outlines of the session.
        outgoing: publishes the layout.
        reporter: publishes what is refused.
        now_s: returns the time of the buses [s].
        save_memory: saves what is remembered of the robots.
    """

    def __init__(
        self,
        session: Session,
        exact: FocalPlane,
        availability: Availability,
        attempts: Attempts,
        outlines: Outlines,
        outgoing: Publishers,
        reporter: Reporter,
        now_s: Callable[[], float],
        save_memory: Callable[[], None],
    ):
        self._session, self._exact, self._availability = session, exact, availability
        self._attempts, self._outlines, self._outgoing = attempts, outlines, outgoing
        self._reporter, self._now_s, self._save_memory = reporter, now_s, save_memory
        self._images = 0  # taken over

    def hear(self, message: PointCloud2) -> None:
        """Take over a message of the metrology, or refuse it: nothing is learned from it then."""
        attempt: Attempt | None = None
        try:
            stamp = PlanStamp.of(message)
            attempt = Attempt.first(stamp)
            self._attempts.inputs.check_session(message, "measured")
            self._check_newest(stamp)
            self._take_over(measured.decode(message), attempt)
        except FiberError as error:
            self._reporter.refuse(f"{measured.REFUSED}: {error}", "measured", attempt)

    def _check_newest(self, stamp: PlanStamp) -> None:
        attempts = self._attempts
        if attempts.awaited is not None:
            raise SessionError(f"plan {attempts.awaited} waits for the orders of another attempt")
        begun = attempts.newest if attempts.current is None else attempts.current.plan
        last = max(filter(None, (attempts.newest, begun)), default=None)
        if last is not None and stamp < last:
            raise SessionError(f"it is of plan {stamp}, and plan {last} has begun since")

    def _take_over(self, told: measured.Measured, attempt: Attempt) -> None:
        session, plane = self._session, self._exact
        rows = plane.index_of(told.ids)
        if (rows < 0).any():
            robot = int(told.ids[rows < 0][0])
            raise MessageError("measured", "is not of this plane", robot=robot)
        # robots that the message does not name stay as they were known
        wider = np.array(self._outlines.known_mm)
        angles, certain = np.array(session.angles), np.zeros(plane.n, dtype=bool)
        certain[rows] = np.isfinite(told.places).all(axis=1)
        angles[rows], wider[rows] = told.angles, told.wider_mm
        counts = session.units.encoder_counts(plane, angles)
        turn_known = np.ones(plane.n, dtype=bool)
        turn_known[rows] = told.verdict != Verdict.UNPLACED
        took = place_robots(session, counts, certain, self._now_s(), turn_known)
        # a robot that keeps its counters may be where the camera tells, or where they say
        off = np.abs(angles - session.angles) * levers_of(plane)
        wider += np.where(took[:, None], 0.0, off.sum(axis=1, keepdims=True))
        self._outlines.learn(wider)
        self._exclude(rows, told)
        self._save_memory()
        self._outgoing.publish_layout(always=True)
        still = np.isin(told.verdict, STILL)
        text = f"{certain.sum()} robots are where the camera saw them, {still.sum()} did not move"
        kept = certain & ~took
        if kept.any():
            named = ", ".join(map(str, plane.ids[kept][:_NAMED]))
            text += f"; {kept.sum()} keep their counters: robots {named}"
        self._reporter.info(f"plan {attempt}: {text}")
        self._images += 1
        self._reporter.counters |= {"images": self._images, "measured": attempt.stamp}
        self._reporter.publish()  # a client waits for it

    def _exclude(self, rows: np.ndarray, told: measured.Measured) -> None:
        still = np.isin(told.verdict, STILL)
        self._availability.failed[rows[still]] = Reason.NOT_MOVED
