# SPDX-License-Identifier: Apache-2.0
"""Builds the recording of one plan from its frame log and from what else is known of the plan."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict

import numpy as np
from numpy.typing import ArrayLike

from fiber_bus_bridge.bus import Ack
from fiber_bus_bridge.wire import Alert, Fault
from fiber_core.array_types import Angles, Ids, Points
from fiber_core.clearance import Certificate, Safety, certify
from fiber_core.corridor import JointCorridors
from fiber_core.focal_plane import FocalPlane
from fiber_core.frame_log import FrameLog
from fiber_core.metrics import plan_metrics
from fiber_core.motion import SampledMotion
from fiber_core.outcomes import PlanOutcome
from fiber_core.problem import Problem
from fiber_core.wire_units import WireUnits
from fiber_recording.bus_events import at_own_stops, bus_events
from fiber_recording.closest import closest_approaches
from fiber_recording.phases import Phase
from fiber_recording.recording import SOFTWARE, Recording
from fiber_recording.replay import Replay, replay

__all__ = ["build_recording"]

_MOST_NAMED = 5  # robots that a note names by their ids
_LINE_FAILURES = {Ack.LOST: "taken by others", Ack.STUCK: "sda low", Ack.TIMED_OUT: "scl low"}


def build_recording(
    plane: FocalPlane,
    units: WireUnits,
    *,
    logs: Iterable[FrameLog],
    outcome: PlanOutcome,
    counts_before: ArrayLike,
    counts_after: ArrayLike | None = None,
    targets: tuple[ArrayLike, ArrayLike] | None = None,
    planned: tuple[ArrayLike, SampledMotion] | None = None,
    corridors: tuple[ArrayLike, JointCorridors] | None = None,
    safety: Safety | None = None,
    about: Mapping[str, object] | None = None,
    notes: Sequence[str] = (),
) -> Recording:
    """Build the recording of a plan; the motion in the recording is decoded from the bus frames.

    Needs no ROS. The frame log and the outcome are enough; everything else that is given is
    recorded too.

    Args:
        plane: the focal plane as it was before the first frame.
        units: tick and quantum of the orders.
        logs: the frames of the plan, in the order in which the buses carried them.
        outcome: how every robot of the plane ended the plan; its stamp names the plan.
        counts_before: encoders before the plan [quanta], shape (n, 2).
        counts_after: encoders when the plan had ended [quanta], shape (n, 2). They place the
            robots that stopped answering; by default the last reply in the frames does.
        targets: ids, shape (k,), and targets [mm], shape (k, 2); nan: no target.
        planned: ids, shape (k,), and the trajectory that the planner made for these robots.
        corridors: ids, shape (k,), and the corridors of these robots in the first phase.
        safety: the clearance that the recorded motion is certified for; the defaults of Safety
            if not given.
        about: plain values for JSON to keep with the recording, as `seed` and `planner`.
        notes: sentences to keep with the recording; notes on stops and lost robots are added.

    Returns:
        The recording: phases, certificate and report are of the motion in the frames.

    Raises:
        FiberError: the values do not fit the plane or each other; names the value.
    """
    safety = Safety() if safety is None else safety
    logs = list(logs)
    followed = replay(plane, units, counts_before, logs, counts_after)
    measured, load, events = bus_events(plane, logs, followed.start_s)
    start = units.to_angles(followed.motion.start)
    problem = Problem(plane, start, _targets_of_all(plane, targets))
    outcome = outcome.of(plane.ids)
    return Recording(
        problem=problem,
        units=units,
        phases=followed.phases,
        started=followed.started,
        planned=_planned_of_all(plane, start, planned),
        corridors=_corridors_of_all(plane, start, corridors),
        measured=measured,
        load=load,
        events=at_own_stops(events, followed.phases),
        outcome=outcome.outcome,
        reason=outcome.reason,
        error_mm=outcome.error_mm,
        approaches=closest_approaches(plane, followed.executed, units.tick_s),
        about={
            "software": SOFTWARE,
            "plan_ns": outcome.stamp_ns,
            "seed": -1,
            "planner": "",
            **(about or {}),
            "notes": [*notes, *_notes(plane, followed)],
            "codes": _code_names(),
            **_report_and_certificate(problem, followed, outcome, safety),
        },
    )


def _code_names() -> dict[str, dict[str, str]]:
    """Names of the details of fault, alert and line events, by kind and number."""
    return {
        "fault": {str(code.value): code.name.lower() for code in Fault},
        "alert": {str(flag.value): (flag.name or "").lower() for flag in Alert},
        "line": {str(ack.value): words for ack, words in _LINE_FAILURES.items()},
    }


def _report_and_certificate(
    problem: Problem, followed: Replay, outcome: PlanOutcome, safety: Safety
) -> dict[str, dict[str, object]]:
    """Metrics and certificate of a plan, as `report` and `certificate`.

    The orders of each phase are certified to their end; the clearance in the report is that of
    the executed motion.
    """
    plane, started, phases = problem.plane, followed.started, followed.phases
    ordered = [certify(plane, phase.motion.decoded(), safety) for phase in phases]
    interrupted = len(phases) > 1 or any(phase.stopped.any() for phase in phases)
    executed = certify(plane, followed.executed, safety) if interrupted else ordered[0]
    resumed_ok = (_resumed_safely(one, phase) for one, phase in zip(ordered[1:], phases[1:]))
    ok = ordered[0].ok and all(resumed_ok)
    segments = np.concatenate([phase.motion.parts.counts for phase in phases])
    segments = segments[segments > 0]
    metrics = plan_metrics(
        problem, followed.executed, executed, outcome.outcome, outcome.reason, safety.margin_mm
    )
    report = metrics | {
        "certified": ok,
        "segments_mean": float(segments.mean()) if len(segments) else 0.0,
        "segments_max": int(segments.max(initial=0)),
        "ordered": int(started.sum()),
        "bytes_mean": float(followed.load_bytes[started].mean()) if started.any() else 0.0,
        "bus_time_s": followed.bus_time_s,
        "phases": len(phases),
    }
    limits_broken = np.any([one.limits_broken for one in ordered], axis=0)
    moved_disabled = np.any([one.moved_disabled for one in ordered], axis=0)
    certificate = asdict(safety) | {
        "ok": ok,
        "unsafe_pairs": int(sum(one.unsafe.sum() for one in ordered)),
        "limits_broken": plane.ids[limits_broken].tolist(),
        "moved_disabled": plane.ids[moved_disabled].tolist(),
    }
    return {"report": report, "certificate": certificate}


def _resumed_safely(certificate: Certificate, phase: Phase) -> bool:
    # Two robots that were stopped too near to each other are safe as long as both rest.
    moves = phase.motion.moves
    last = certificate.pairs.max(initial=0)  # rows of fixed discs follow those of the robots
    moves = np.append(moves, np.zeros(last + 1, dtype=bool))
    unsafe = bool(moves[certificate.pairs[certificate.unsafe]].any())
    return not (unsafe or certificate.limits_broken.any() or certificate.moved_disabled.any())


def _notes(plane: FocalPlane, followed: Replay) -> list[str]:
    notes = []
    for phase, following in zip(followed.phases, [*followed.phases[1:], None]):
        if not phase.stopped.any():
            continue
        stop_s = 1e-6 * phase.stop_us.max()
        if following is None:
            notes.append(f"stopped at {stop_s:.3f} s")
            continue
        resumed = following.motion.moves
        left = plane.ids[phase.stopped & ~resumed]
        without = f" without {_robots(left)}" if len(left) else ""
        begin_s = 1e-6 * following.begin_us
        notes.append(f"stopped at {stop_s:.3f} s, resumed at {begin_s:.3f} s{without}")
    if followed.changed.any():
        changed = _robots(plane.ids[followed.changed])
        notes.append(
            "counters were set, or lost with the power, which is no motion; places are those that "
            f"the orders lead to: {changed}"
        )
    if followed.lost.any():
        lost = _robots(plane.ids[followed.lost])
        notes.append(f"nothing tells where it stopped, the place shown is a guess: {lost}")
    return notes


def _robots(ids: Ids) -> str:
    """Robots by their ids, the first few only: "robots 3, 4 and 12 more"."""
    named = ", ".join(str(robot) for robot in ids[:_MOST_NAMED])
    more = f" and {len(ids) - _MOST_NAMED} more" if len(ids) > _MOST_NAMED else ""
    return f"robot{'s' if len(ids) > 1 else ''} {named}{more}"


def _targets_of_all(plane: FocalPlane, targets: tuple[ArrayLike, ArrayLike] | None) -> Points:
    """Targets of all robots [mm], shape (n, 2), nan for a robot without a target."""
    points = np.full((plane.n, 2), np.nan)
    if targets is not None:
        rows = plane.index_of(targets[0])
        points[rows[rows >= 0]] = np.asarray(targets[1])[rows >= 0]
    return points


def _planned_of_all(
    plane: FocalPlane, start: Angles, planned: tuple[ArrayLike, SampledMotion] | None
) -> SampledMotion | None:
    """The trajectory of all robots; robots that it does not contain rest where they are."""
    if planned is None:
        return None
    ids, motion = planned
    rows = plane.index_of(ids)
    angles = np.repeat(start[:, :, None], len(motion.time_s), axis=2)
    angles[rows[rows >= 0]] = motion.angles[rows >= 0]
    return SampledMotion(motion.time_s, angles)


def _corridors_of_all(
    plane: FocalPlane, start: Angles, corridors: tuple[ArrayLike, JointCorridors] | None
) -> JointCorridors | None:
    """Corridors of all robots; a robot without one gets an empty interval at its start."""
    if corridors is None:
        return None
    ids, known = corridors
    rows = plane.index_of(ids)
    found = rows >= 0
    lasts_s = np.zeros(plane.n)
    lasts_s[rows[found]] = known.lasts_s[found]
    low = np.repeat(start[:, :, None], known.low.shape[2], axis=2)
    high = low.copy()
    low[rows[found]], high[rows[found]] = known.low[found], known.high[found]
    return JointCorridors(lasts_s, low, high)
