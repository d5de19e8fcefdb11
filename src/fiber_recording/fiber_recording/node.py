"""Listens to the graph and writes a recording of every plan that ends.

A process of its own: while robots move it keeps messages and does nothing with them; the
work begins when a plan has ended. It asks the graph for nothing.
"""

import time
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from rclpy.node import Node

from fiber_core.clearance import Safety
from fiber_core.errors import FiberError
from fiber_core.focal_plane import FocalPlane
from fiber_core.frame_log import FrameLog
from fiber_core.outcomes import PlanOutcome
from fiber_msgs_py import (
    Attempt,
    AttemptTable,
    PlanStamp,
    corridors,
    frames,
    joint_states,
    layout,
    outcome,
    progress,
    targets,
    topics,
    trajectory,
)
from fiber_node import Reporter, declare_parameters, run
from fiber_recording import save_recording
from fiber_recording.build_recording import build_recording
from fiber_recording.replay import replay, unexplained

__all__ = ["RecorderNode", "main", "recording_name"]

_PLANS_KEPT = 4
_ATTEMPTS_KEPT = 16
_LOOK_S = 0.2  # how often a plan that has ended is looked at
_SETTLE_S = 10.0  # for the last frames and encoder readings to come in
_QUIET_S = 1.0  # without a frame of a plan that has ended, there were none


def recording_name(stamp: PlanStamp) -> str:
    """Return the file name of the recording of a plan."""
    return f"plan-{stamp}.npz"


@dataclass
class _AttemptData:
    """What was received under the stamp of an attempt."""

    plane: FocalPlane | None = None  # as it was before the first frame
    counts: np.ndarray | None = None  # encoders then
    trajectory: object = None
    corridors: object = None
    logs: list[FrameLog] = field(default_factory=list)


@dataclass
class _PlanData:
    """What was received of a plan, whatever its attempts."""

    targets: object = None
    looked_at: int = 0  # how many logs there were at the last look
    ended: PlanOutcome | None = None
    ended_s: float = 0.0  # when the outcome was received


@dataclass(frozen=True)
class _Attempts:
    """The attempts of one plan, in their order."""

    announced: list[_AttemptData]

    @property
    def ran(self) -> list[_AttemptData]:
        """The attempts that put frames on the buses."""
        return [data for data in self.announced if data.logs]

    @property
    def first(self) -> _AttemptData:
        """The first attempt that put frames on the buses, else the first of all."""
        return (self.ran + self.announced)[0]

    @property
    def logs(self) -> list[FrameLog]:
        """Frames of all attempts: robots go on where the attempt before left them."""
        return [log for data in self.ran for log in data.logs]


class RecorderNode(Node):
    """Writes `plan-STAMP.npz` into a folder for every plan with an outcome.

    Args:
        options: keyword arguments of rclpy.node.Node.
    """

    def __init__(self, **options):
        super().__init__("recorder", **options)
        self._folder = Path(self.declare_parameter("folder", "recordings").value)
        self._about = {
            "seed": self.declare_parameter("seed", -1).value,
            "planner": self.declare_parameter("planner", "").value,
        }
        self._name = self.declare_parameter("preset", "").value  # the layout does not tell it
        self._safety = declare_parameters(self, Safety, "safety")
        self._plane = self._units = self._state = self._rest = None
        self._plans: dict[PlanStamp, _PlanData] = {}
        self._data: dict[PlanStamp, _AttemptData] = {}  # by the stamp of the attempt
        self._announced = AttemptTable()
        self._began_ns = self.get_clock().now().nanoseconds
        self._report = Reporter(self, "recorder")
        for topic, heard in (
            (topics.LAYOUT, self._on_layout),
            (topics.JOINT_STATES, self._on_joint_states),
            (topics.TARGETS, self._on_targets),
            (topics.PROGRESS, self._on_progress),
            (topics.TRAJECTORY, self._on_trajectory),
            (topics.CORRIDORS, self._on_corridors),
            (topics.FRAMES, self._on_frames),
            (topics.OUTCOME, self._on_outcome),
        ):
            topic.subscription(self, heard)
        self.create_timer(_LOOK_S, self._write_ended)

    def _plan(self, stamp) -> _PlanData:
        for old in sorted(self._plans)[: -(_PLANS_KEPT - 1)]:
            if old < stamp:
                self._forget(old)
        return self._plans.setdefault(stamp, _PlanData())

    def _of_attempt(self, message) -> _AttemptData:
        # its plan may not be known yet: it is asked for when a plan has ended
        stamp = PlanStamp.of(message)
        for old in sorted(self._data)[: -(_ATTEMPTS_KEPT - 1)]:
            if old < stamp:
                del self._data[old]
        return self._data.setdefault(stamp, _AttemptData())

    def _attempts(self, plan) -> _Attempts:
        stamps = [attempt.stamp for attempt in self._announced.of_plan(plan)]
        return _Attempts([self._data.get(stamp, _AttemptData()) for stamp in stamps])

    def _unannounced(self, plan) -> bool:
        """Whether frames were received that may belong to a later attempt of a plan."""
        return any(
            stamp > plan and data.logs and self._announced.find(stamp) is None
            for stamp, data in self._data.items()
        )

    def _forget(self, plan):
        for attempt in self._announced.of_plan(plan):
            self._data.pop(attempt.stamp, None)
        del self._plans[plan]

    def _on_layout(self, message):
        try:
            plane, self._units = layout.decode(message)
            self._plane = replace(plane, name=self._name)
        except FiberError as error:
            self._report.refuse(f"layout refused: {error}")

    def _on_joint_states(self, message):
        self._state = message
        if not np.any(message.velocity):
            self._rest = message

    def _on_targets(self, message):
        try:
            attempt = targets.decode_attempt(message)
        except FiberError:
            return  # the planner refuses them
        self._announced.add(attempt)
        if attempt.number == 1:  # later attempts ask for some of these again
            self._plan(attempt.plan).targets = message

    def _on_progress(self, message):
        try:
            self._announced.add(progress.decode(message).attempt)
        except FiberError as error:
            self._report.refuse(f"progress refused: {error}")

    def _on_trajectory(self, message):
        self._of_attempt(message).trajectory = message

    def _on_corridors(self, message):
        self._of_attempt(message).corridors = message

    def _on_frames(self, message):
        data = self._of_attempt(message)
        try:
            if data.counts is None and self._rest is not None and self._units is not None:
                data.plane, data.counts = self._plane, self._counts(self._rest)
            data.logs.append(frames.decode(message))
        except FiberError as error:
            self._report.refuse(f"frames refused: {error}")

    def _on_outcome(self, message):
        stamp = PlanStamp.of(message)
        plan = self._plan(stamp)
        try:
            plan.ended = PlanOutcome(stamp.ns, *outcome.decode(message))
        except FiberError as error:
            self._report.refuse(f"outcome refused: {error}")
            return
        plan.ended_s = time.monotonic()

    def _counts(self, message):
        return self._units.to_counts(joint_states.decode(message)[1])

    def _write_ended(self):
        for stamp, plan in list(self._plans.items()):
            if plan.ended is None or self._plane is None or self._state is None:
                continue
            try:
                late = time.monotonic() > plan.ended_s + _SETTLE_S
                if self._complete(stamp, plan) or late:
                    if not self._ended_before(stamp, plan):
                        self._write(stamp, plan, late)
                    self._forget(stamp)
            except (FiberError, OSError) as error:
                self._report.refuse(f"plan {stamp} not recorded: {error}")
                self._forget(stamp)

    def _ended_before(self, stamp, plan) -> bool:
        """Whether a plan ended before this recorder began: it may have its recording."""
        only_latched = plan.targets is None and not self._attempts(stamp).ran
        return only_latched and stamp.ns < self._began_ns

    def _complete(self, stamp, plan) -> bool:
        attempts = self._attempts(stamp)
        count = len(attempts.logs)
        more, plan.looked_at = count > plan.looked_at, count
        if more or self._unannounced(stamp):
            return False  # the outcome can overtake the last frames, frames their announcement
        if not count:
            return time.monotonic() > plan.ended_s + _QUIET_S
        first = attempts.first
        if first.trajectory is not None and first.corridors is None and self._margins_are_made():
            return False
        return self._explained(attempts, plan.ended)

    def _explained(self, attempts, ended) -> bool:
        if attempts.first.counts is None:
            return False
        told = replay(self._plane, self._units, attempts.first.counts, attempts.logs)
        now = self._counts(self._state)
        return not unexplained(self._plane, told, ended, now).any()

    def _margins_are_made(self):
        return self.count_publishers(topics.CORRIDORS.name) > 0

    def _write(self, stamp, plan, late):
        self._report.progress(Attempt.first(stamp), 0.0, "writing the recording")
        attempts = self._attempts(stamp)
        first, logs, count = attempts.first, attempts.logs, max(len(attempts.ran), 1)
        notes = []
        if count > 1:
            notes = [f"{count} attempts: planned again around robots that cannot be commanded"]
        if not logs:
            notes = ["no frames were received: no robot was started"]
        elif late and not self._explained(attempts, plan.ended):
            notes += ["the frames received do not explain where all robots are"]
        now = self._counts(self._state)
        recording = build_recording(
            self._plane if first.plane is None else first.plane,
            self._units,
            logs=logs,
            outcome=plan.ended,
            counts_before=now if first.counts is None else first.counts,
            counts_after=now,
            targets=None if plan.targets is None else targets.decode(plan.targets),
            planned=None if first.trajectory is None else trajectory.decode(first.trajectory)[:2],
            corridors=None if first.corridors is None else corridors.decode(first.corridors),
            safety=self._safety,
            about=self._about | {"attempts": count},
            notes=notes,
        )
        self._folder.mkdir(parents=True, exist_ok=True)
        path = self._folder / recording_name(stamp)
        save_recording(path, recording)
        self._report.done(Attempt.first(stamp), f"recorded in {path}")


def main(args=None) -> int:
    """Run the recorder until it is interrupted."""
    return run(RecorderNode, args)
