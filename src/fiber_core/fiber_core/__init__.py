# SPDX-License-Identifier: Apache-2.0
"""The focal plane of fibre positioners, the motions of its robots, and their certificates.

Lengths are in mm, angles in rad counter-clockwise, times in s; phi = 0 is the stretched arm.
Outlines, gaps and the certificate of clearance are in ``fiber_core.clearance``, the names of
array types in ``fiber_core.array_types``.
"""

from fiber_core.assignment import Assignment, assign
from fiber_core.corridor import JointCorridors
from fiber_core.custom_plane import hexagonal
from fiber_core.drive import CurveMotion, Drive, carried_out
from fiber_core.drive.named import DRIVES, with_accelerations, with_drive
from fiber_core.errors import FiberError, FieldError, LayoutError, MotionError, TargetsError
from fiber_core.fields import Field, random_field, random_problem
from fiber_core.focal_plane import FocalPlane
from fiber_core.frame_log import FrameLog
from fiber_core.kinematics import forward, inverse, jacobian
from fiber_core.metrics import lower_bound_s, plan_metrics
from fiber_core.motion import SampledMotion, SegmentMotion
from fiber_core.outcomes import Outcome, PlanOutcome, Reason, first_reason, holds
from fiber_core.presets import PRESETS, Preset, plane_from, preset
from fiber_core.problem import Problem, load_plan, load_problem, save_plan, save_problem
from fiber_core.wire_units import WireMotion, WireUnits

__all__ = [
    "DRIVES",
    "PRESETS",
    "Assignment",
    "CurveMotion",
    "Drive",
    "FiberError",
    "Field",
    "FieldError",
    "FocalPlane",
    "FrameLog",
    "JointCorridors",
    "LayoutError",
    "MotionError",
    "Outcome",
    "PlanOutcome",
    "Preset",
    "Problem",
    "Reason",
    "SampledMotion",
    "SegmentMotion",
    "TargetsError",
    "WireMotion",
    "WireUnits",
    "assign",
    "carried_out",
    "first_reason",
    "forward",
    "hexagonal",
    "holds",
    "inverse",
    "jacobian",
    "load_plan",
    "load_problem",
    "lower_bound_s",
    "plan_metrics",
    "plane_from",
    "preset",
    "random_field",
    "random_problem",
    "save_plan",
    "save_problem",
    "with_accelerations",
    "with_drive",
]
