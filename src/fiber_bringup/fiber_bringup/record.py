"""From what a graph published of one plan to a recording of it."""

from collections.abc import Sequence
from dataclasses import asdict

import numpy as np

from fiber_bringup.bus_story import bus_story
from fiber_bringup.client import PlanEnd
from fiber_bringup.replay import replay
from fiber_bus_bridge.wire import Alert, Fault
from fiber_core.clearance import Safety, certify
from fiber_core.focal_plane import FocalPlane
from fiber_core.motion import SampledMotion
from fiber_core.problem import Problem
from fiber_core.report import plan_report
from fiber_core.wire_units import WireMotion, WireUnits
from fiber_msgs_py import FrameLog
from fiber_viewer import SOFTWARE, EventKind, Recording, closest_approaches

__all__ = ["record"]


def record(
    plane: FocalPlane,
    units: WireUnits,
    counts,
    targets,
    planned: tuple[np.ndarray, SampledMotion] | None,
    logs: Sequence[FrameLog],
    ended: PlanEnd,
    safety: Safety,
    about: dict,
) -> Recording:
    """Put a recording together; the motion in it is that of the bytes.

    Args:
        plane: the focal plane.
        units: tick, quantum and widths.
        counts: encoders before the plan [quanta], shape (n, 2).
        targets: ids, shape (k,), and points [mm], shape (k, 2), asked for.
        planned: ids and motion as the planner published them, None without.
        logs: frames of the plan, in the order they were published.
        ended: what became of the robots.
        safety: clearance the motion is certified for.
        about: what else is known: seed, planner, notes.

    Raises:
        FiberError: the pieces do not fit each other.
    """
    told = replay(plane, units, counts, logs)
    measured, load, events = bus_story(plane, logs, told.start_s)
    stops = events.time_s[(events.kind == EventKind.STOP) & (events.time_s >= 0)]
    wire, notes = told.motion, []
    if len(stops):
        wire = _until(wire, int(stops[0] / units.tick_s))
        notes = [f"stopped at {stops[0]:.3f} s: the orders are cut there, to a whole tick"]
    motion = wire.decoded()
    certificate = certify(plane, motion, safety)
    asked = np.full((plane.n, 2), np.nan)
    rows = plane.index_of(targets[0])
    asked[rows[rows >= 0]] = targets[1][rows >= 0]
    problem = Problem(plane, units.to_angles(counts), asked)
    ended = ended.of(plane.ids)
    report = plan_report(problem, motion, certificate, ended.outcome, ended.reason)
    ordered = told.started
    return Recording(
        problem=problem,
        units=units,
        motion=wire,
        started=ordered,
        planned=_whole(plane, problem.start, planned),
        measured=measured,
        load=load,
        events=events,
        outcome=ended.outcome,
        reason=ended.reason,
        error_mm=ended.error_mm,
        approaches=closest_approaches(plane, motion, units.tick_s),
        about={
            "software": SOFTWARE,
            "plan_ns": ended.stamp.ns,
            **about,
            "notes": [*about.get("notes", ()), *notes],
            "codes": {
                "fault": {str(int(code)): code.name.lower() for code in Fault},
                "alert": {str(int(flag)): flag.name.lower() for flag in Alert},
            },
            "report": report
            | {
                "bytes_mean": float(told.load_bytes[ordered].mean()) if ordered.any() else 0.0,
                "bus_time_s": told.bus_time_s,
            },
            "certificate": asdict(safety)
            | {
                "ok": certificate.ok,
                "unsafe_pairs": int(certificate.unsafe.sum()),
                "limits_broken": plane.ids[certificate.limits_broken].tolist(),
                "moved_disabled": plane.ids[certificate.moved_disabled].tolist(),
            },
        },
    )


def _whole(plane, start, planned):
    # robots the planner does not mention rest where they are
    if planned is None:
        return None
    ids, motion = planned
    rows = plane.index_of(ids)
    angles = np.repeat(start[:, :, None], len(motion.time_s), axis=2)
    angles[rows[rows >= 0]] = motion.angles[rows >= 0]
    return SampledMotion(motion.time_s, angles)


def _until(motion: WireMotion, ticks: int) -> WireMotion:
    """Return the orders as far as they are carried out after some ticks."""
    ends = np.cumsum(motion.ticks)
    lengths = np.diff(motion.offsets)
    profile = np.repeat(np.arange(len(lengths)), lengths)
    before = np.concatenate([[0], ends])[motion.offsets[:-1]]
    begins = ends - motion.ticks - before[profile]
    left = np.minimum(motion.ticks, ticks - begins)
    kept = left > 0
    counts = np.bincount(profile[kept], minlength=len(lengths))
    offsets = np.concatenate([[0], np.cumsum(counts)])
    return WireMotion(motion.units, motion.start, offsets, left[kept], motion.velocity[kept])
