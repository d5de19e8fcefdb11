# SPDX-License-Identifier: Apache-2.0
"""The node `recorder`: writes a recording of every plan that ends.

The recorder is a process of its own, which publishes nothing that the plan depends on. While
robots move it only keeps messages; it builds the recording after the plan has ended.
"""

import itertools
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from sensor_msgs.msg import JointState, PointCloud2
from trajectory_msgs.msg import JointTrajectory

from fiber_core.array_types import Counts
from fiber_core.bounds import Range, check_ranges
from fiber_core.clearance import Safety
from fiber_core.errors import FiberError
from fiber_core.focal_plane import FocalPlane
from fiber_core.outcomes import PlanOutcome
from fiber_core.wire_units import WireUnits
from fiber_msgs_py import (
    Attempt,
    PlanStamp,
    corridors,
    frames,
    guarded,
    joint_states,
    layout,
    measured,
    outcome,
    progress,
    session_of,
    targets,
    topics,
    trajectory,
    true_places,
)
from fiber_node import AcceptedAttempts, PlaneNode, Reporter, SessionGate, run
from fiber_recording.build_recording import build_recording
from fiber_recording.measured_images import ImagesOfPlans, with_images
from fiber_recording.received_plans import ReceivedPlan, ReceivedPlans
from fiber_recording.recording_file import load_recording, save_recording
from fiber_recording.replay import replay, unexplained

__all__ = ["RecorderNode", "main", "recording_name"]

_CHECK_PERIOD_S = 0.2  # time between two checks of the plans that have ended
_COMPLETION_S = 10.0  # longest wait for the last frames and encoder readings of an ended plan
_HEARD = 64
_RESTED = 8  # readings of encoders at rest that are kept after an outcome
_NO_FRAMES_S = 1.0  # an ended plan without frames for this long had none


def recording_name(stamp: PlanStamp, number: int = 1) -> str:
    """Return the file name of the recording of a plan.

    Args:
        stamp: names the plan.
        number: of the plans with this stamp, of which a clock that was set back makes more.
    """
    return f"plan-{stamp}.npz" if number == 1 else f"plan-{stamp}.{number}.npz"


@dataclass(frozen=True)
class _PlaneWithStates:
    """The focal plane and joint states of its robots."""

    plane: FocalPlane
    units: WireUnits
    states: JointState

    @property
    def counts(self) -> Counts:
        """Encoders [quanta], shape (n, 2)."""
        return self.units.to_counts(joint_states.decode(self.states)[1])


@dataclass(frozen=True)
class RecorderConfig:
    """Where recordings are written, and what is noted in them about the graph.

    Args:
        folder: folder of the recordings; it is made when the first one is written.
        seed: seed of the random starts, noted in the recordings; -1 for none.
        planner: name of the planner, noted in the recordings.
        preset: name of the instrument, noted in the recordings; the layout has none.

    Raises:
        FiberError: the seed is no whole number or out of bounds.
    """

    RANGES: ClassVar = {"seed": Range(-1, 2**63 - 1, whole=True)}

    folder: str = "recordings"
    seed: int = -1
    planner: str = ""
    preset: str = ""

    def __post_init__(self) -> None:
        check_ranges(self, self.RANGES, FiberError)


class RecorderNode(PlaneNode):
    """Writes `plan-STAMP.npz` into a folder for every plan with an outcome.

    Args:
        options: keyword arguments of rclpy.node.Node.
    """

    def __init__(self, **options: Any):
        super().__init__("recorder", **options)
        self._config = self.parameters.declare(RecorderConfig)
        self._safety = self.parameters.declare(Safety, "safety")
        self.parameters.finish()
        self._plane: FocalPlane | None = None
        self._units: WireUnits | None = None
        self._states: JointState | None = None
        self._states_at_rest: JointState | None = None
        self._received, self._images = ReceivedPlans(), ImagesOfPlans()
        # plans whose outcome has come, with the session of their targets
        self._heard: dict[PlanStamp, str | None] = {}
        self._paths: dict[PlanStamp, Path] = {}  # of recordings, the last of each stamp
        self._began_ns = self.get_clock().now().nanoseconds
        self._report = Reporter(self, "recorder")
        # a recording takes a second to write, in which the default group serves parameters
        work = MutuallyExclusiveCallbackGroup()
        gate = self._gate = SessionGate(self, self._report.refuse_message, work)
        self._accepted = AcceptedAttempts(self, gate, work)
        for topic, observe in (
            (topics.LAYOUT, self._on_layout),
            (topics.JOINT_STATES, self._on_joint_states),
            (topics.OUTCOME, self._on_outcome),
        ):
            gate.subscription(topic, self._refusing(topic.name, observe))
        for topic, observe in (
            (topics.TARGETS, self._on_targets),
            (topics.MEASURED, self._on_measured),
            (topics.TRUE_PLACES, self._on_true_places),
            (topics.PROGRESS, self._on_progress),
            (topics.TRAJECTORY, self._on_trajectory),
            (topics.CORRIDORS, self._on_corridors),
            (topics.FRAMES, self._on_frames),
        ):
            topic.subscription(self, self._refusing(topic.name, observe), callback_group=work)
        self.create_timer(
            _CHECK_PERIOD_S,
            guarded(self, "recordings", self._write_ended_plans),
            callback_group=work,
            clock=Clock(clock_type=ClockType.STEADY_TIME),
        )
        folder = self._config.value.folder
        self.get_logger().info(f"waits for a bridge and for plans that end, to record in {folder}")

    def _refusing(self, topic: str, observe: Callable[[Any], None]) -> Callable[[Any], None]:
        """Return a callback that reports why a message was refused."""
        name = topic.rpartition("/")[2]

        def receive(message: Any) -> None:
            try:
                observe(message)
            except FiberError as error:
                self._report.refuse(f"{name} refused: {error}", name)

        return receive

    def _on_layout(self, message: PointCloud2) -> None:
        if self._plane is None:
            self._report.info("the plane has come")
        plane, self._units = layout.decode(message)
        self._plane = replace(plane, name=self._config.value.preset)

    def _on_joint_states(self, message: JointState) -> None:
        joint_states.decode(message)  # refuses a malformed message, which would be read too late
        self._states = message
        if not np.any(message.velocity):
            self._states_at_rest = message
            for _, plan, _ in self._received.ended():
                if len(plan.rested) < _RESTED:
                    plan.rested.append(message)

    def _on_targets(self, message: PointCloud2) -> None:
        try:
            attempt = targets.decode_attempt(message)
        except FiberError:
            return  # the planner refuses them
        self._received.announce(attempt)
        self._forget_same_stamp(attempt, session_of(message))
        if attempt.number == 1:  # later attempts have some of these targets again
            straight = targets.decode_straight(message)
            self._accepted.when_accepted(
                attempt.stamp, lambda accepted, _: self._images.begin(accepted.plan, straight)
            )
            self._received.plan(attempt.plan).targets = message

    def _forget_same_stamp(self, attempt: Attempt, session: str | None) -> None:
        """Take targets of another open session with the stamp of a plan that has ended for new.

        A bridge tells again how a plan has ended, but never sends its targets.
        """
        stamp = attempt.stamp
        if attempt.number != 1 or self._heard.get(stamp, session) == session or session is None:
            return
        if self._gate.is_open(session):
            del self._heard[stamp]
            self._report.info(
                f"plan {stamp} is another one with the stamp of an earlier plan: was the clock set "
                "back? Both are recorded"
            )

    def _on_progress(self, message: DiagnosticStatus) -> None:
        self._received.announce(progress.decode(message).attempt)

    def _on_trajectory(self, message: JointTrajectory) -> None:
        self._received.attempt(PlanStamp.of(message)).trajectory = message

    def _on_corridors(self, message: PointCloud2) -> None:
        self._received.attempt(PlanStamp.of(message)).corridors = message

    def _on_frames(self, message: PointCloud2) -> None:
        log = frames.decode(message)
        attempt = self._received.attempt(PlanStamp.of(message))
        before = self._plane_with(self._states_at_rest)
        if attempt.counts is None and before is not None:
            attempt.plane, attempt.counts = before.plane, before.counts
        attempt.logs.append(log)

    def _on_outcome(self, message: PointCloud2) -> None:
        stamp = PlanStamp.of(message)
        ended = PlanOutcome(stamp.ns, *outcome.decode(message))
        if stamp in self._heard:
            return  # a bridge tells again how the last plan of the bridge before has ended
        plan = self._received.plan(stamp)
        self._heard[stamp] = None if plan.targets is None else session_of(plan.targets)
        for old in list(self._heard)[:-_HEARD]:
            del self._heard[old]
        plan.rested = [] if self._states_at_rest is None else [self._states_at_rest]
        plan.outcome, plan.outcome_s = ended, time.monotonic()
        self._report.debug(f"plan {stamp} has ended: waits for the last frames")

    def _on_measured(self, message: PointCloud2) -> None:
        self._images.add(PlanStamp.of(message), measured.decode(message))

    def _on_true_places(self, message: PointCloud2) -> None:
        self._images.expose(true_places.decode(message))

    def _plane_with(self, states: JointState | None) -> _PlaneWithStates | None:
        if self._plane is None or self._units is None or states is None:
            return None
        return _PlaneWithStates(self._plane, self._units, states)

    def _write_ended_plans(self) -> None:
        now = self._plane_with(self._states)
        if now is None:
            return
        self._write_images()
        for stamp, plan, ended in self._received.ended():
            try:
                late = time.monotonic() > plan.outcome_s + _COMPLETION_S
                explained = self._is_explained(stamp, plan, ended, now)
                if self._is_complete(stamp, plan, explained) or late:
                    if self._is_missed(stamp, plan):
                        self._report.refuse(
                            f"plan {stamp} not recorded: this recorder began after it",
                            attempt=Attempt.first(stamp),
                        )
                    else:
                        self._write(stamp, plan, ended, now, explained)
                    self._received.drop(stamp)
            except (FiberError, OSError) as error:
                self._report.refuse(
                    f"plan {stamp} not recorded: {error}", attempt=Attempt.first(stamp)
                )
                self._received.drop(stamp)
            except Exception:
                self._received.drop(stamp)  # the guard of this callback reports the error
                raise

    def _write_images(self) -> None:
        for stamp, tables in self._images.waiting():
            path = self._paths.get(stamp)
            if path is None or not path.exists():
                continue  # its recording is not written yet, or was moved away
            self._images.take(stamp)
            try:
                save_recording(path, with_images(load_recording(path), tables))
            except (FiberError, OSError) as error:
                self._report.refuse(f"images after plan {stamp} not recorded: {error}")
            else:
                self._report.info(f"plan {stamp}: {len(tables)} images recorded in {path}")

    def _is_missed(self, stamp: PlanStamp, plan: ReceivedPlan) -> bool:
        """Return whether a plan began before this node, and may have a recording of another."""
        return plan.targets is None and stamp.ns < self._began_ns

    def _is_explained(
        self, stamp: PlanStamp, plan: ReceivedPlan, ended: PlanOutcome, now: _PlaneWithStates
    ) -> bool:
        """Return whether the frames of a plan lead to the encoders of all robots.

        An image may have set the present ones: a robot is explained by any reading since the end.
        """
        attempts = self._received.attempts(stamp)
        if attempts.first.counts is None:
            return False
        followed = replay(now.plane, now.units, attempts.first.counts, attempts.logs)
        readings = (*(replace(now, states=states) for states in list(plan.rested)), now)
        off = [unexplained(now.plane, followed, ended, each.counts) for each in readings]
        return not np.all(off, axis=0).any()

    def _is_complete(self, stamp: PlanStamp, plan: ReceivedPlan, explained: bool) -> bool:
        """Return whether all messages of an ended plan have been received."""
        attempts = self._received.attempts(stamp)
        count = len(attempts.logs)
        has_new, plan.checked_logs = count > plan.checked_logs, count
        if has_new or self._received.has_unannounced_frames(stamp):
            return False  # an outcome can overtake the last frames, frames their announcement
        if not count:
            return time.monotonic() > plan.outcome_s + _NO_FRAMES_S
        first = attempts.first
        if first.trajectory is not None and first.corridors is None:
            if self._corridors_are_published():
                return False
        return explained

    def _corridors_are_published(self) -> bool:
        return self.count_publishers(topics.CORRIDORS.name) > 0

    def _write(
        self,
        stamp: PlanStamp,
        plan: ReceivedPlan,
        ended: PlanOutcome,
        now: _PlaneWithStates,
        explained: bool,
    ) -> None:
        self._report.progress(Attempt.first(stamp), 0.0, "writing the recording")
        attempts, config = self._received.attempts(stamp), self._config.value
        first, logs, count = attempts.first, attempts.logs, max(len(attempts.executed), 1)
        notes = []
        if count > 1:
            notes = [f"{count} attempts: planned again around robots that cannot be commanded"]
        if not logs:
            notes = ["no frames were received: no robot was started"]
        elif not explained:
            notes += ["the frames received do not explain where all robots are"]
        plane = now.plane if first.plane is None else first.plane
        recording = build_recording(
            plane if plan.targets is None else targets.plane_for(plane, plan.targets),
            now.units,
            logs=logs,
            outcome=ended,
            counts_before=now.counts if first.counts is None else first.counts,
            counts_after=now.counts,
            targets=None if plan.targets is None else targets.decode(plan.targets),
            planned=None if first.trajectory is None else trajectory.decode(first.trajectory)[:2],
            corridors=None if first.corridors is None else corridors.decode(first.corridors),
            safety=self._safety.value,
            about={"seed": config.seed, "planner": config.planner, "attempts": count},
            notes=notes,
        )
        folder = Path(config.folder)
        folder.mkdir(parents=True, exist_ok=True)
        path = self._paths[stamp] = _free_path(folder, stamp)
        save_recording(path, recording)
        self._report.done(Attempt.first(stamp), f"recorded in {path}")


def _free_path(folder: Path, stamp: PlanStamp) -> Path:
    """The file of the next recording of a stamp: none takes the place of another plan's."""
    paths = (folder / recording_name(stamp, number) for number in itertools.count(1))
    return next(path for path in paths if not path.exists())


def main(args: list[str] | None = None) -> int:
    """Run the recorder until it is interrupted; return the exit code.

    Args:
        args: arguments for ROS; by default those of the process.
    """
    return run(RecorderNode, args)
