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
    PlanStamp,
    corridors,
    frames,
    joint_states,
    layout,
    outcome,
    targets,
    topics,
    trajectory,
)
from fiber_node import Reporter, declare_parameters_of, run
from fiber_recording import save_recording
from fiber_recording.build_recording import build_recording
from fiber_recording.replay import replay, unexplained

__all__ = ["RecorderNode", "main", "recording_name"]

_PLANS_KEPT = 4
_LOOK_S = 0.2  # how often a plan that has ended is looked at
_SETTLE_S = 10.0  # for the last frames and encoder readings to come in
_QUIET_S = 1.0  # without a frame of a plan that has ended, there were none


def recording_name(stamp: PlanStamp) -> str:
    """Return the file name of the recording of a plan."""
    return f"plan-{stamp}.npz"


@dataclass
class _Attempt:
    """What was heard of an attempt of a plan."""

    plane: FocalPlane | None = None  # as it was before the first frame
    counts: np.ndarray | None = None  # encoders then
    trajectory: object = None
    corridors: object = None
    logs: list[FrameLog] = field(default_factory=list)


@dataclass
class _Heard:
    """What was heard of a plan."""

    targets: object = None
    attempts: dict[int, _Attempt] = field(default_factory=dict)
    looked_at: int = 0  # how many logs there were at the last look
    ended: PlanOutcome | None = None
    ended_s: float = 0.0  # when that was heard

    def attempt(self, message) -> _Attempt:
        """Return the attempt a message is about."""
        return self.attempts.setdefault(PlanStamp.of(message).attempt, _Attempt())

    @property
    def ran(self) -> list[_Attempt]:
        """Those that put frames on the buses, in their order."""
        return [attempt for _, attempt in sorted(self.attempts.items()) if attempt.logs]

    @property
    def first(self) -> _Attempt:
        """The first of them, else what is known of the first of all."""
        return self.ran[0] if self.ran else self.attempts.get(1, _Attempt())

    @property
    def logs(self) -> list[FrameLog]:
        """Frames of all attempts: robots go on where the one before left them."""
        return [log for attempt in self.ran for log in attempt.logs]

    @property
    def latched_only(self) -> bool:
        """Whether nothing was heard of it but what whoever comes late is told too."""
        return self.targets is None and not self.ran


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
        self._safety = declare_parameters_of(self, Safety, "safety")
        self._plane = self._units = self._state = self._rest = None
        self._heard: dict[PlanStamp, _Heard] = {}
        self._began_ns = self.get_clock().now().nanoseconds
        self._report = Reporter(self, "recorder")
        for topic, heard in (
            (topics.LAYOUT, self._on_layout),
            (topics.JOINT_STATES, self._on_joint_states),
            (topics.TARGETS, self._on_targets),
            (topics.TRAJECTORY, self._on_trajectory),
            (topics.CORRIDORS, self._on_corridors),
            (topics.FRAMES, self._on_frames),
            (topics.OUTCOME, self._on_outcome),
        ):
            topic.subscription(self, heard)
        self.create_timer(_LOOK_S, self._write_ended)

    def _of(self, message) -> _Heard:
        stamp = PlanStamp.of(message).plan
        for old in sorted(self._heard)[: -(_PLANS_KEPT - 1)]:
            if old < stamp:
                del self._heard[old]
        return self._heard.setdefault(stamp, _Heard())

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
        if PlanStamp.of(message).attempt == 1:  # later ones ask some of these again
            self._of(message).targets = message

    def _on_trajectory(self, message):
        self._of(message).attempt(message).trajectory = message

    def _on_corridors(self, message):
        self._of(message).attempt(message).corridors = message

    def _on_frames(self, message):
        heard = self._of(message).attempt(message)
        try:
            if heard.counts is None and self._rest is not None and self._units is not None:
                heard.plane, heard.counts = self._plane, self._counts(self._rest)
            heard.logs.append(frames.decode(message))
        except FiberError as error:
            self._report.refuse(f"frames refused: {error}")

    def _on_outcome(self, message):
        heard = self._of(message)
        if heard.latched_only and PlanStamp.of(message).ns < self._began_ns:
            return  # it ended before this recorder began, and may have its recording
        try:
            heard.ended = PlanOutcome(PlanStamp.of(message).plan.ns, *outcome.decode(message))
        except FiberError as error:
            self._report.refuse(f"outcome refused: {error}")
            return
        heard.ended_s = time.monotonic()

    def _counts(self, message):
        return self._units.to_counts(joint_states.decode(message)[1])

    def _write_ended(self):
        for stamp, heard in list(self._heard.items()):
            if heard.ended is None or self._plane is None or self._state is None:
                continue
            try:
                late = time.monotonic() > heard.ended_s + _SETTLE_S
                if self._complete(heard) or late:
                    self._write(stamp, heard, late)
                    del self._heard[stamp]
            except (FiberError, OSError) as error:
                self._report.refuse(f"plan {stamp} not recorded: {error}")
                del self._heard[stamp]

    def _complete(self, heard) -> bool:
        more, heard.looked_at = len(heard.logs) > heard.looked_at, len(heard.logs)
        if more:  # the outcome can overtake the last frames
            return False
        if not heard.logs:
            return time.monotonic() > heard.ended_s + _QUIET_S
        first = heard.first
        if first.trajectory is not None and first.corridors is None and self._margins_are_made():
            return False
        return self._explained(heard)

    def _explained(self, heard) -> bool:
        if heard.first.counts is None:
            return False
        told = replay(self._plane, self._units, heard.first.counts, heard.logs)
        now = self._counts(self._state)
        return not unexplained(self._plane, told, heard.ended, now).any()

    def _margins_are_made(self):
        return self.count_publishers(topics.CORRIDORS.name) > 0

    def _write(self, stamp, heard, late):
        self._report.progress(stamp, 0.0, "writing the recording")
        first, attempts = heard.first, max(len(heard.ran), 1)
        notes = []
        if attempts > 1:
            notes = [f"{attempts} attempts: planned again around robots that cannot be commanded"]
        if not heard.logs:
            notes = ["no frames were received: no robot was started"]
        elif late and not self._explained(heard):
            notes += ["the frames received do not explain where all robots are"]
        now = self._counts(self._state)
        recording = build_recording(
            self._plane if first.plane is None else first.plane,
            self._units,
            logs=heard.logs,
            outcome=heard.ended,
            counts_before=now if first.counts is None else first.counts,
            counts_after=now,
            targets=None if heard.targets is None else targets.decode(heard.targets),
            planned=None if first.trajectory is None else trajectory.decode(first.trajectory)[:2],
            corridors=None if first.corridors is None else corridors.decode(first.corridors),
            safety=self._safety,
            about=self._about | {"attempts": attempts},
            notes=notes,
        )
        self._folder.mkdir(parents=True, exist_ok=True)
        path = self._folder / recording_name(stamp)
        save_recording(path, recording)
        self._report.done(stamp, f"recorded in {path}")


def main(args=None) -> int:
    """Run the recorder until it is interrupted."""
    return run(RecorderNode, args)
