# SPDX-License-Identifier: Apache-2.0
"""Example recordings of random motions, for trying the player and the figures, and for tests.

A quick look at the player, without ROS and without a simulation::

    from pathlib import Path
    from fiber_recording import save_recording
    from fiber_recording.examples import random_recording

    save_recording(Path("example.npz"), random_recording(seed=1, interrupted=True))

and then ``ros2 run fiber_viewer player example.npz``.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from fiber_core import kinematics
from fiber_core.clearance import Safety, certify
from fiber_core.corridor import JointCorridors
from fiber_core.drive import Drive
from fiber_core.focal_plane import FocalPlane
from fiber_core.metrics import plan_metrics
from fiber_core.motion import SampledMotion, SegmentMotion
from fiber_core.outcomes import Outcome, Reason, Verdict
from fiber_core.presets import preset
from fiber_core.problem import Problem
from fiber_core.ragged import Parts
from fiber_core.wire_units import WireMotion, WireUnits
from fiber_recording.closest import closest_approaches
from fiber_recording.images import Images
from fiber_recording.phases import Phase, counts_at, executed_motion
from fiber_recording.recording import (
    SOFTWARE,
    BusLoad,
    EventKind,
    Events,
    Measured,
    Recording,
)

__all__ = ["random_recording", "seen_by_a_camera"]

_ROBOTS = 37
_NO_TARGET, _HELD, _FAILED, _DISABLED = 3, 5, 11, 20  # rows of robots with another outcome
_MOST_SEGMENTS, _MOST_TICKS, _MOST_SPEED = 4, 200, 500  # of a motor; [ticks]; [quanta a tick]
_STOP_US, _RESUME_US = 300_300, 455_001  # of an interrupted motion [us]
_FAILED_STOP_US = 211_000  # the failed robot has stopped by itself [us]
_BLIND_MM, _CORRECTED_MM, _CAMERA_MM = 0.05, 0.006, 0.003  # errors of images
_STILL, _DARK = 4, 7  # rows of robots with a remark
_FAR_MM = 1.5  # from its target, of a robot that was not moved there
_PLAN_NS = 1_790_000_000_000_000_000


def random_recording(
    seed: int, preset_name: str = "desi", *, interrupted: bool = False
) -> Recording:
    """Return a recording of 37 robots that move at random, with one of everything in it.

    One robot each is held, failed, disabled and without a target. The orders ignore the
    neighbours, so arms may overlap; the recorded certificate says so.

    Args:
        seed: of the random numbers; the same seed gives the same recording.
        preset_name: a preset of fiber_core.
        interrupted: the failed robot stops by itself, all others are stopped and then resumed:
            the recording has two phases.
    """
    rng = np.random.default_rng(seed)
    plane = preset(preset_name, _ROBOTS).with_enabled(np.arange(_ROBOTS) != _DISABLED)
    units = WireUnits.for_plane(plane)
    started = ~np.isin(np.arange(_ROBOTS), [_HELD, _DISABLED])
    orders = _random_orders(plane, units, started, rng)
    phases = _interrupted(orders, rng) if interrupted else (Phase.whole(orders),)
    motion = executed_motion(phases)
    targets = kinematics.forward(plane, motion.end)[1]
    targets[_NO_TARGET] = np.nan
    problem = Problem(plane, motion.start, targets)
    outcome, reason = _outcomes()
    planned = _sampled(motion)
    measured = _random_readings(phases, started, rng)
    report, certificate = _report_and_certificate(problem, motion, outcome, reason)
    return Recording(
        problem=problem,
        units=units,
        phases=tuple(phases),
        started=started,
        planned=planned,
        corridors=_random_corridors(orders.decoded(), rng),
        measured=measured,
        load=BusLoad(
            buses=np.array([0]),
            begin_s=-0.02,
            bin_s=0.005,
            frames=rng.integers(0, 9, (1, 300)),
            bytes=rng.integers(0, 99, (1, 300)),
        ),
        events=_events(),
        outcome=outcome,
        reason=reason,
        error_mm=np.where(outcome == Outcome.REACHED, 0.002, np.nan),
        approaches=closest_approaches(plane, motion, units.tick_s),
        about={
            "software": SOFTWARE,
            "plan_ns": _PLAN_NS,
            "seed": seed,
            "planner": "none",
            "notes": [],
            "codes": {"fault": {"33": "memory"}, "alert": {"1": "refused", "4": "rebooted"}},
            "report": report,
            "certificate": certificate,
        },
    )


def _random_orders(
    plane: FocalPlane, units: WireUnits, started: np.ndarray, rng: np.random.Generator
) -> WireMotion:
    start = units.to_counts(rng.uniform(plane.limits[..., 0], plane.limits[..., 1]))
    lengths = rng.integers(0, _MOST_SEGMENTS + 1, 2 * _ROBOTS) * np.repeat(started, 2)
    offsets = Parts.from_counts(lengths).offsets
    ticks = rng.integers(1, _MOST_TICKS, offsets[-1])
    velocity = rng.integers(-_MOST_SPEED, _MOST_SPEED, offsets[-1])
    return WireMotion(units, start, offsets, ticks, velocity)


def _interrupted(orders: WireMotion, rng: np.random.Generator) -> tuple[Phase, Phase]:
    """Orders up to a stop of all robots, and the remaining motion without the failed robot."""
    n, tick_us = len(orders.start), orders.units.tick_us
    rows = np.flatnonzero(1e6 * orders.decoded().durations.max(axis=1) > _STOP_US)
    stop_us, stop = np.full(n, -1), np.zeros((n, 2), dtype=int)
    stop_us[rows] = _STOP_US
    stop_us[_FAILED] = _FAILED_STOP_US
    stop[rows] = counts_at([Phase.whole(orders)], rows, stop_us[rows]) + rng.integers(-3, 4)
    first = Phase(orders, 0, stop_us, stop)
    elapsed, lengths = _STOP_US // tick_us, np.zeros((n, 2), dtype=int)
    ticks, velocity = [], []
    for row in rows[rows != _FAILED]:
        for joint in (0, 1):
            part = orders.parts.slice(2 * row + joint)
            left = np.clip(np.cumsum(orders.ticks[part]) - elapsed, 0, orders.ticks[part])
            ticks += left[left > 0].tolist()
            velocity += orders.velocity[part][left > 0].tolist()
            lengths[row, joint] = (left > 0).sum()
    offsets = Parts.from_counts(lengths).offsets
    remaining = WireMotion(orders.units, first.end, offsets, np.array(ticks), np.array(velocity))
    return first, Phase.whole(remaining, _RESUME_US)


def _outcomes() -> tuple[np.ndarray, np.ndarray]:
    outcome, reason = np.zeros((2, _ROBOTS), dtype=int)
    outcome[[_HELD, _DISABLED, _NO_TARGET]] = Outcome.HELD
    reason[[_HELD, _DISABLED, _NO_TARGET]] = Reason.UNSAFE, Reason.DISABLED, Reason.NO_TARGET
    outcome[_FAILED], reason[_FAILED] = Outcome.FAILED, Reason.STALLED
    return outcome, reason


def _sampled(motion: SegmentMotion) -> SampledMotion:
    times = np.linspace(0.0, motion.makespan_s, 60)
    return SampledMotion(times, np.stack([motion(t) for t in times], axis=-1))


def _random_readings(
    phases: Sequence[Phase], started: np.ndarray, rng: np.random.Generator
) -> Measured:
    """Six encoder readings of each started robot, at most 90 quanta from its orders."""
    row = np.repeat(np.flatnonzero(started), 6)
    time_us = np.tile(rng.integers(0, 3_000_000, 6), int(started.sum())) + np.arange(len(row))
    off = rng.integers(-90, 90, (len(row), 2))
    return Measured(row, time_us, counts_at(phases, row, time_us) + off)


def _random_corridors(ordered: SegmentMotion, rng: np.random.Generator) -> JointCorridors:
    """Corridors at random distances from the ordered motion."""
    lasts_s = ordered.durations.max(axis=1)
    angles = np.stack(
        [
            np.stack([ordered(t)[row] for t in np.linspace(0, lasts_s[row], 7)], axis=-1)
            for row in range(ordered.n)
        ]
    )
    low = angles - rng.uniform(0.01, 1, angles.shape)
    high = angles + rng.uniform(0.01, 1, angles.shape)
    return JointCorridors(lasts_s, low, high)


def _events() -> Events:
    return Events(
        time_s=np.array([0.0, 0.3, 0.4]),
        kind=np.array([EventKind.GO, EventKind.NO_ADDRESS, EventKind.FAULT]),
        bus=np.zeros(3, dtype=int),
        row=np.array([-1, _FAILED, _FAILED]),
        detail=np.array([0, 0, 33]),
    )


def _report_and_certificate(
    problem: Problem, motion: SegmentMotion, outcome: np.ndarray, reason: np.ndarray
) -> tuple[dict, dict]:
    safety = Safety()
    certificate = certify(problem.plane, motion, safety)
    report = plan_metrics(problem, motion, certificate, outcome, reason, safety.margin_mm)
    return (
        report | {"bytes_mean": 10.0, "bus_time_s": 0.02},
        {"margin_mm": safety.margin_mm, "ok": certificate.ok},
    )


def seen_by_a_camera(recording: Recording, seed: int) -> Recording:
    """Return a recording with two images, of a plane of three sectors and four power supplies.

    One robot had not moved in the first image, and takes no part in the correction; one is dark.
    Robots that the plan held are far from their targets.

    Args:
        recording: the recording; it must have at least 8 robots.
        seed: of the random numbers.
    """
    plane, targets = recording.problem.plane, recording.problem.targets
    rng, n = np.random.default_rng(seed), plane.n
    true = targets + rng.normal(size=(2, n, 2)) * np.reshape([_BLIND_MM, _CORRECTED_MM], (2, 1, 1))
    place = true + _CAMERA_MM * rng.normal(size=true.shape)
    verdict = np.full((2, n), int(Verdict.MEASURED))
    verdict[0, _STILL], verdict[:, _DARK] = Verdict.NOT_MOVED, Verdict.DARK
    place[:, _STILL] += _FAR_MM
    place[:, recording.outcome != Outcome.REACHED] += _FAR_MM
    place[:, _DARK] = np.nan
    images = Images(place, verdict, true, {int(code): code.name.lower() for code in Verdict})
    drive = Drive(n, supply=4 * np.arange(n) // n, motors_on=0.55)
    plane = replace(plane, sector=3 * np.arange(n) // n, drive=drive)
    problem = replace(recording.problem, plane=plane)
    return replace(recording, problem=problem, images=images)
