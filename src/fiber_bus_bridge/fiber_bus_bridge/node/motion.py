# SPDX-License-Identifier: Apache-2.0
"""The time of the buses, and the timer that supervises robots while they move."""

import threading

import numpy as np
from rclpy.callback_groups import CallbackGroup
from rclpy.clock import Clock
from rclpy.clock_type import ClockType

from fiber_bus_bridge.node.attempts import Attempts
from fiber_bus_bridge.node.hardware import SLICE_S, Hardware
from fiber_bus_bridge.node.locked_calls import LockedCalls
from fiber_bus_bridge.node.publishers import Publishers
from fiber_bus_bridge.node.remembered import Remembered
from fiber_bus_bridge.session import Session
from fiber_bus_bridge.session_state import SessionState
from fiber_msgs_py import guarded
from fiber_node import ManagedNode

__all__ = ["BusTime", "Motion"]

_TICK_S = 0.05  # time of the buses between two publications while robots move
_SOON_S = 1e-3


class BusTime:
    """The time of the buses, which never goes back.

    Args:
        session: the session that uses the buses.
        hardware: the buses, and their clock.
    """

    def __init__(self, session: Session, hardware: Hardware):
        self._session, self._hardware = session, hardware
        self._newest_s = 0.0

    def now_s(self) -> float:
        """Return the time of the buses [s]."""
        free_s = self._session.transactions.now_s
        self._newest_s = max(self._newest_s, free_s, self._hardware.clock())
        return self._newest_s


class Motion:
    """Supervises robots while they move, tick by tick, and publishes what has changed.

    A caller holds the lock of the bridge.

    Args:
        node: the node of the bridge.
        calls: makes the callback of the timer hold the lock.
        session: the session with the robots.
        hardware: the buses, and their clock.
        time: the time of the buses.
        attempts: the plan that is under way.
        outgoing: publishes encoders and frames.
        remembered: the memory of the robots.
        stopping: set while a stop is requested.
        scale: simulated seconds per second; 0 for as fast as possible.
        group: callback group of the timer.
    """

    def __init__(
        self,
        node: ManagedNode,
        calls: LockedCalls,
        session: Session,
        hardware: Hardware,
        time: BusTime,
        attempts: Attempts,
        outgoing: Publishers,
        remembered: Remembered,
        stopping: threading.Event,
        scale: float,
        group: CallbackGroup,
    ):
        self._session, self._hardware, self._time = session, hardware, time
        self._attempts, self._outgoing, self._remembered = attempts, outgoing, remembered
        self._reporter, self._stopping = node.reporter, stopping
        self._due_s = 0.0
        in_real_time = hardware.in_real_time
        pause_s = _SOON_S if in_real_time or not scale else _TICK_S / scale
        # simulated buses follow the clock of the node, as one of use_sim_time; real ones cannot
        self._timer = node.create_timer(
            pause_s,
            guarded(node, "tick", calls.locked(self._on_tick)),
            callback_group=group,
            clock=Clock(clock_type=ClockType.STEADY_TIME) if in_real_time else node.get_clock(),
            autostart=False,
        )

    def begin(self) -> None:
        """Supervise robots that have just been started, until they rest."""
        self._due_s = self._time.now_s()
        self._timer.reset()

    def _on_tick(self) -> None:
        if self._session.state is SessionState.MOVING:
            self._advance()
            moving = self._session.state is SessionState.MOVING
            if not (moving and self._stopping.is_set()):  # a stop waits for the lock, and publishes
                self.publish_changes()
        else:
            # in this thread and never in the one that serves stop: a timer that is cancelled
            # when it is due fails in rclpy as it is taken, with its whole callback group
            self._timer.cancel()

    def _advance(self) -> None:
        # from tick to tick, independent of the time that the polls take on the buses
        clock, slice_s = self._hardware.clock, min(self._hardware.slice_s, SLICE_S)
        until_s = max(self._due_s, clock()) + _TICK_S
        while self._due_s < until_s and self._session.state is SessionState.MOVING:
            self._due_s = min(max(self._due_s, clock()) + slice_s, until_s)
            self._session.advance(self._due_s)
            if self._stopping.is_set():
                return

    def publish_changes(self, last: bool = False) -> None:
        """Publish the changes of a call, and save the memory of robots that rest.

        Args:
            last: whether a plan that has ended gets no further attempt.
        """
        self._publish_state(last)
        if self._session.state is not SessionState.MOVING:
            self._remembered.save_or_warn()

    def _publish_state(self, last: bool) -> None:
        now_s, current = self._time.now_s(), self._attempts.current
        self._outgoing.publish_frames(None if current is None else current.stamp)
        self._outgoing.publish_encoders()
        if current is None:
            return
        loaded_plan = self._session.loaded_plan
        if self._session.state is SessionState.MOVING and loaded_plan is not None:
            makespan_s = max(loaded_plan.motion.decoded().makespan_s, _TICK_S)
            fraction = np.clip((now_s - loaded_plan.start_s) / makespan_s, 0.0, 1.0)
            self._reporter.progress(current, float(fraction), "robots are moving")
        elif (result := self._session.take_result()) is not None:
            self._attempts.finish(current, result, last)
