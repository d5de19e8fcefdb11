"""From what a graph published of one plan to a recording of it."""

from collections.abc import Sequence
from dataclasses import asdict

import numpy as np

from fiber_bringup.bus_story import bus_story
from fiber_bringup.client import PlanEnd
from fiber_bringup.replay import Replay, replay
from fiber_bus_bridge.bus import Ack
from fiber_bus_bridge.wire import Alert, Fault
from fiber_core.clearance import Safety, certify
from fiber_core.focal_plane import FocalPlane
from fiber_core.margins import JointMargins
from fiber_core.motion import SampledMotion
from fiber_core.problem import Problem
from fiber_core.report import plan_report
from fiber_core.wire_units import WireUnits
from fiber_msgs_py import FrameLog
from fiber_viewer import SOFTWARE, Recording, closest_approaches

__all__ = ["record"]

_NAMED = 5  # robots named in a note
_LINES = {Ack.LOST: "taken by others", Ack.STUCK: "sda low", Ack.TIMED_OUT: "scl low"}


def record(
    plane: FocalPlane,
    units: WireUnits,
    counts,
    targets,
    planned: tuple[np.ndarray, SampledMotion] | None,
    margins: tuple[np.ndarray, JointMargins] | None,
    logs: Sequence[FrameLog],
    heard,
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
        margins: ids and margins as the discretizer published them, None without.
        logs: frames of the plan, in the order they were published.
        heard: where encoders were heard to be at its end [quanta], shape (n, 2).
        ended: what became of the robots.
        safety: clearance the motion is certified for.
        about: what else is known: seed, planner, notes.

    Raises:
        FiberError: the pieces do not fit each other.
    """
    told = replay(plane, units, counts, logs, heard)
    measured, load, events = bus_story(plane, logs, told.start_s)
    asked = np.full((plane.n, 2), np.nan)
    rows = plane.index_of(targets[0])
    asked[rows[rows >= 0]] = targets[1][rows >= 0]
    problem = Problem(plane, units.to_angles(counts), asked)
    ended = ended.of(plane.ids)
    report, certificate = _proven(problem, told, ended, safety)
    return Recording(
        problem=problem,
        units=units,
        legs=told.legs,
        started=told.started,
        planned=_whole(plane, problem.start, planned),
        margins=_of_all(plane, problem.start, margins),
        measured=measured,
        load=load,
        events=events,
        outcome=ended.outcome,
        reason=ended.reason,
        error_mm=ended.error_mm,
        approaches=closest_approaches(plane, told.executed, units.tick_s),
        about={
            "software": SOFTWARE,
            "plan_ns": ended.stamp.ns,
            **about,
            "notes": [*about.get("notes", ()), *_notes(plane, told)],
            "codes": {
                "fault": {str(int(code)): code.name.lower() for code in Fault},
                "alert": {str(int(flag)): flag.name.lower() for flag in Alert},
                "line": {str(int(ack)): words for ack, words in _LINES.items()},
            },
            "report": report,
            "certificate": certificate,
        },
    )


def _proven(problem, told, ended, safety):
    # What was sent is certified to its end, each leg; how near they came is of what was done.
    plane, started = problem.plane, told.started
    sent = [certify(plane, leg.motion.decoded(), safety) for leg in told.legs]
    stopped = len(told.legs) > 1 or told.legs[0].stopped.any()
    done = certify(plane, told.executed, safety) if stopped else sent[0]
    ok = sent[0].ok and all(_safe(one, leg) for one, leg in zip(sent[1:], told.legs[1:]))
    segments = np.concatenate([np.diff(leg.motion.offsets) for leg in told.legs])
    segments = segments[segments > 0]
    report = plan_report(problem, told.executed, done, ended.outcome, ended.reason) | {
        "certified": ok,
        "segments_mean": float(segments.mean()) if len(segments) else 0.0,
        "segments_max": int(segments.max(initial=0)),
        "ordered": int(started.sum()),
        "bytes_mean": float(told.load_bytes[started].mean()) if started.any() else 0.0,
        "bus_time_s": told.bus_time_s,
        "legs": len(told.legs),
    }
    broken = np.any([one.limits_broken for one in sent], axis=0)
    moved = np.any([one.moved_disabled for one in sent], axis=0)
    return report, asdict(safety) | {
        "ok": ok,
        "unsafe_pairs": int(sum(one.unsafe.sum() for one in sent)),
        "limits_broken": plane.ids[broken].tolist(),
        "moved_disabled": plane.ids[moved].tolist(),
    }


def _safe(certificate, leg):
    # of two that were stopped too near to each other nobody moves, and that is safe
    moves = np.diff(leg.motion.offsets).reshape(-1, 2).any(axis=1)
    moves = np.append(moves, np.zeros(certificate.pairs.max(initial=0) + 1, dtype=bool))
    unsafe = moves[certificate.pairs[certificate.unsafe]].any()
    return not (unsafe or certificate.limits_broken.any() or certificate.moved_disabled.any())


def _notes(plane, told: Replay) -> list[str]:
    notes = []
    for leg, after in zip(told.legs, [*told.legs[1:], None]):
        if not leg.stopped.any():
            continue
        at_s = 1e-6 * leg.stop_us.max()
        if after is None:
            notes.append(f"stopped at {at_s:.3f} s")
            continue
        on = np.diff(after.motion.offsets).reshape(-1, 2).any(axis=1)
        left = plane.ids[leg.stopped & ~on]
        without = f" without {_listed(left)}" if len(left) else ""
        notes.append(f"stopped at {at_s:.3f} s, went on at {1e-6 * after.begin_us:.3f} s{without}")
    if told.unheard.any():
        silent = _listed(plane.ids[told.unheard])
        notes.append(f"not heard of again, where they are drawn is a guess: {silent}")
    return notes


def _listed(ids) -> str:
    named = ", ".join(str(robot) for robot in ids[:_NAMED])
    more = f" and {len(ids) - _NAMED} more" if len(ids) > _NAMED else ""
    return f"robot{'s' if len(ids) > 1 else ''} {named}{more}"


def _whole(plane, start, planned):
    # robots the planner does not mention rest where they are
    if planned is None:
        return None
    ids, motion = planned
    rows = plane.index_of(ids)
    angles = np.repeat(start[:, :, None], len(motion.time_s), axis=2)
    angles[rows[rows >= 0]] = motion.angles[rows >= 0]
    return SampledMotion(motion.time_s, angles)


def _of_all(plane, start, told):
    # robots of which no margin is told have none
    if told is None:
        return None
    ids, margins = told
    rows = plane.index_of(ids)
    known = rows >= 0
    lasts_s = np.zeros(plane.n)
    lasts_s[rows[known]] = margins.lasts_s[known]
    low, high = np.repeat(start[None, :, :, None], margins.low.shape[2], axis=3).repeat(2, axis=0)
    low[rows[known]], high[rows[known]] = margins.low[known], margins.high[known]
    return JointMargins(lasts_s, low, high)
