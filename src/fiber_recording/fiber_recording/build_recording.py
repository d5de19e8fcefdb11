"""From what a graph published of one plan to a recording of it."""

from collections.abc import Sequence
from dataclasses import asdict

import numpy as np

from fiber_bus_bridge.bus import Ack
from fiber_bus_bridge.wire import Alert, Fault
from fiber_core.clearance import Safety, certify
from fiber_core.corridor import JointCorridors
from fiber_core.focal_plane import FocalPlane
from fiber_core.frame_log import FrameLog
from fiber_core.metrics import plan_metrics
from fiber_core.motion import SampledMotion
from fiber_core.outcomes import PlanOutcome
from fiber_core.problem import Problem
from fiber_core.wire_units import WireUnits
from fiber_recording.bus_events import bus_events
from fiber_recording.closest import closest_approaches
from fiber_recording.recording import SOFTWARE, Recording
from fiber_recording.replay import Replay, replay

__all__ = ["record"]

_NAMED = 5  # robots named in a note
_LINES = {Ack.LOST: "taken by others", Ack.STUCK: "sda low", Ack.TIMED_OUT: "scl low"}


def record(
    plane: FocalPlane,
    units: WireUnits,
    counts,
    targets,
    planned: tuple[np.ndarray, SampledMotion] | None,
    corridors: tuple[np.ndarray, JointCorridors] | None,
    logs: Sequence[FrameLog],
    heard,
    ended: PlanOutcome,
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
        corridors: ids and corridors as the discretizer published them, None without.
        logs: frames of the plan, in the order they were published.
        heard: where encoders were heard to be at its end [quanta], shape (n, 2).
        ended: what became of the robots.
        safety: clearance the motion is certified for.
        about: what else is known: seed, planner, notes.

    Raises:
        FiberError: the pieces do not fit each other.
    """
    told = replay(plane, units, counts, logs, heard)
    measured, load, events = bus_events(plane, logs, told.start_s)
    asked = np.full((plane.n, 2), np.nan)
    rows = plane.index_of(targets[0])
    asked[rows[rows >= 0]] = targets[1][rows >= 0]
    problem = Problem(plane, units.to_angles(counts), asked)
    ended = ended.of(plane.ids)
    report, certificate = _proven(problem, told, ended, safety)
    return Recording(
        problem=problem,
        units=units,
        phases=told.phases,
        started=told.started,
        planned=_whole(plane, problem.start, planned),
        corridors=_of_all(plane, problem.start, corridors),
        measured=measured,
        load=load,
        events=events,
        outcome=ended.outcome,
        reason=ended.reason,
        error_mm=ended.error_mm,
        approaches=closest_approaches(plane, told.executed, units.tick_s),
        about={
            "software": SOFTWARE,
            "plan_ns": ended.stamp_ns,
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
    # What was sent is certified to its end, each phase; how near they came is of what was done.
    plane, started = problem.plane, told.started
    sent = [certify(plane, phase.motion.decoded(), safety) for phase in told.phases]
    stopped = len(told.phases) > 1 or told.phases[0].stopped.any()
    done = certify(plane, told.executed, safety) if stopped else sent[0]
    ok = sent[0].ok and all(_safe(one, phase) for one, phase in zip(sent[1:], told.phases[1:]))
    segments = np.concatenate([np.diff(phase.motion.offsets) for phase in told.phases])
    segments = segments[segments > 0]
    report = plan_metrics(problem, told.executed, done, ended.outcome, ended.reason) | {
        "certified": ok,
        "segments_mean": float(segments.mean()) if len(segments) else 0.0,
        "segments_max": int(segments.max(initial=0)),
        "ordered": int(started.sum()),
        "bytes_mean": float(told.load_bytes[started].mean()) if started.any() else 0.0,
        "bus_time_s": told.bus_time_s,
        "phases": len(told.phases),
    }
    broken = np.any([one.limits_broken for one in sent], axis=0)
    moved = np.any([one.moved_disabled for one in sent], axis=0)
    return report, asdict(safety) | {
        "ok": ok,
        "unsafe_pairs": int(sum(one.unsafe.sum() for one in sent)),
        "limits_broken": plane.ids[broken].tolist(),
        "moved_disabled": plane.ids[moved].tolist(),
    }


def _safe(certificate, phase):
    # of two that were stopped too near to each other nobody moves, and that is safe
    moves = np.diff(phase.motion.offsets).reshape(-1, 2).any(axis=1)
    moves = np.append(moves, np.zeros(certificate.pairs.max(initial=0) + 1, dtype=bool))
    unsafe = moves[certificate.pairs[certificate.unsafe]].any()
    return not (unsafe or certificate.limits_broken.any() or certificate.moved_disabled.any())


def _notes(plane, told: Replay) -> list[str]:
    notes = []
    for phase, after in zip(told.phases, [*told.phases[1:], None]):
        if not phase.stopped.any():
            continue
        at_s = 1e-6 * phase.stop_us.max()
        if after is None:
            notes.append(f"stopped at {at_s:.3f} s")
            continue
        on = np.diff(after.motion.offsets).reshape(-1, 2).any(axis=1)
        left = plane.ids[phase.stopped & ~on]
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
    ids, corridors = told
    rows = plane.index_of(ids)
    known = rows >= 0
    lasts_s = np.zeros(plane.n)
    lasts_s[rows[known]] = corridors.lasts_s[known]
    low, high = np.repeat(start[None, :, :, None], corridors.low.shape[2], axis=3).repeat(2, axis=0)
    low[rows[known]], high[rows[known]] = corridors.low[known], corridors.high[known]
    return JointCorridors(lasts_s, low, high)
