# SPDX-License-Identifier: Apache-2.0
"""What a browser is told about a running plane: robots, motion, and the state of its nodes."""

import io
import json
import threading
from collections import deque
from collections.abc import Mapping
from typing import Any

import numpy as np

from fiber_core.array_types import Angles, Codes, Floats, Ids, Points
from fiber_core.focal_plane import FocalPlane
from fiber_core.outcomes import Outcome, PlanOutcome, Reason
from fiber_core.problem import Problem, problem_columns
from fiber_msgs_py import Level, PlanStamp, Progress, Status

__all__ = ["PlaneFeed"]

_ALERTS_KEPT = 100
_BUS = "bridge: bus "
_BRIDGE = "bridge"


class PlaneFeed:
    """The newest of everything, ready to be sent; one thread writes, others read.

    `version` counts the changes of the plane, its targets and outcomes: `plane_file` gives these.
    `status` gives the rest, which is small.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._plane: FocalPlane | None = None
        self._targets: Points | None = None
        self._outcome: PlanOutcome | None = None
        self._stages: dict[str, dict[str, Any]] = {}
        self._statuses: dict[str, Status] = {}
        self._alerts: deque[dict[str, str]] = deque(maxlen=_ALERTS_KEPT)
        self._ready: str | None = None  # plan that can be started
        self._moved: str | None = None  # plan that robots have moved for
        self._ended: str | None = None  # plan with the newest outcome
        self.version = 0

    # --- what the graph says -------------------------------------------------

    def set_plane(self, plane: FocalPlane) -> None:
        """Take a layout; targets and outcome of other robots are forgotten."""
        with self._lock:
            if self._plane is not None and not np.array_equal(self._plane.ids, plane.ids):
                self._targets = self._outcome = None
            self._plane = plane
            self.version += 1

    def set_targets(self, ids: Ids, xy_mm: Points) -> None:
        """Take the targets of a new plan.

        Args:
            ids: ids of the robots with a target, shape (k,).
            xy_mm: their targets [mm], shape (k, 2).
        """
        with self._lock:
            if self._plane is None:
                return
            targets = np.full((self._plane.n, 2), np.nan)
            rows = self._plane.index_of(ids)
            targets[rows[rows >= 0]] = np.asarray(xy_mm)[rows >= 0]
            self._targets, self._outcome, self._ready = targets, None, None
            self.version += 1

    def set_outcome(self, outcome: PlanOutcome) -> None:
        """Take the outcome of a plan; it can come before the layout."""
        with self._lock:
            self._ended = str(PlanStamp(outcome.stamp_ns))
            self._outcome, self._ready = outcome, None
            self.version += 1

    def add_progress(self, progress: Progress) -> None:
        """Take the progress of a stage."""
        plan = str(progress.attempt.plan)
        with self._lock:
            self._stages[progress.stage] = {
                "stage": progress.stage,
                "fraction": progress.fraction,
                "text": progress.text,
                "plan": plan,
                "refused": progress.refused,
            }
            if progress.refused:
                self._alert(f"{progress.stage}: refused: {progress.text}", "error", plan)
            elif progress.stage == _BRIDGE:
                self._follow_bridge(plan, progress.fraction)

    def _follow_bridge(self, plan: str, fraction: float) -> None:
        # the work of the bridge is done twice: its orders are ready, and its robots have moved
        if 0.0 < fraction < 1.0:
            self._moved, self._ready = plan, None
        elif fraction == 1.0 and plan not in (self._moved, self._ended):
            self._ready = plan

    def add_status(self, status: Status) -> None:
        """Take a diagnostic status; one that has become worse is an alert."""
        with self._lock:
            before = self._statuses.get(status.name)
            self._statuses[status.name] = status
            if status.level > (Level.OK if before is None else before.level):
                if status.level is not Level.STALE:
                    self._alert(f"{status.name}: {status.text}", status.level.name.lower(), "")

    def _alert(self, text: str, level: str, plan: str) -> None:
        self._alerts.append({"text": text, "level": level, "plan": plan})

    # --- what the browser is sent --------------------------------------------

    def plane_file(self) -> bytes | None:
        """Return plane, targets and outcome as a .npz file; None before there is a layout.

        It has the arrays of a problem.npz, and `outcome`, `reason`, `error_mm` and `about` of a
        recording. Without an outcome, `outcome` is 255.
        """
        with self._lock:
            plane, targets, ended = self._plane, self._targets, self._outcome
        if plane is None:
            return None
        targets = np.full((plane.n, 2), np.nan) if targets is None else targets
        codes: Codes = np.full(plane.n, 255)
        reason: Codes = np.full(plane.n, int(Reason.NO_TARGET))
        error: Floats = np.full(plane.n, np.nan)
        if ended is not None and np.array_equal(ended.ids, plane.ids):
            codes, reason, error = ended.outcome, ended.reason, ended.error_mm
        about = {
            "names": {
                "outcome": {int(code): code.name.lower() for code in Outcome},
                "reason": {int(code): code.name.lower() for code in Reason},
            },
            "plan": None if ended is None else str(PlanStamp(ended.stamp_ns)),
        }
        columns: dict[str, Any] = problem_columns(Problem(plane, np.zeros((plane.n, 2)), targets))
        columns |= {
            "outcome": codes.astype("u1"),
            "reason": reason.astype("u1"),
            "error_mm": error,
            "about": np.frombuffer(json.dumps(about).encode(), np.uint8),
        }
        file = io.BytesIO()
        np.savez(file, **columns)
        return file.getvalue()

    def status(self) -> dict[str, Any]:
        """Return stages, alerts, buses, nodes and the plan that can be started, ready for JSON."""
        with self._lock:
            rows = [
                {"name": each.name, "level": each.level.name.lower(), "text": each.text}
                for each in self._statuses.values()
            ]
            return {
                "kind": "status",
                "version": self.version,
                "ready": self._ready,
                "ended": None if self._outcome is None else _counts(self._outcome),
                "stages": list(self._stages.values()),
                "alerts": list(self._alerts),
                "buses": [each for each in rows if each["name"].startswith(_BUS)],
                "nodes": [each for each in rows if ":" not in each["name"]],
            }

    def bridge_node(self) -> str | None:
        """Return the full name of the bridge node, as its diagnostics tell it."""
        with self._lock:
            status = self._statuses.get(_BRIDGE)
        return None if status is None else str(status.values.get("node", _BRIDGE))

    @staticmethod
    def motion_message(angles: Angles, speeds: Floats) -> bytes:
        """Return joint angles [rad] and speeds [rad/s], shapes (n, 2), as little-endian floats."""
        return np.concatenate([np.ravel(angles), np.ravel(speeds)]).astype("<f4").tobytes()


def _counts(ended: PlanOutcome) -> Mapping[str, object]:
    # robots without a target are no part of the plan, unless they failed
    asked = (ended.reason != Reason.NO_TARGET) | (ended.outcome != Outcome.HELD)
    counts = {
        code.name.lower(): int(np.count_nonzero(ended.outcome[asked] == code)) for code in Outcome
    }
    return {"plan": str(PlanStamp(ended.stamp_ns)), **counts}
