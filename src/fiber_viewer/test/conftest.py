"""A small recording with everything in it: many segments, robots held, failed, disabled, faults."""

import numpy as np
import pytest

from fiber_core import kinematics
from fiber_core.clearance import Safety, certify
from fiber_core.motion import SampledMotion
from fiber_core.outcomes import Outcome, Reason
from fiber_core.presets import preset
from fiber_core.problem import Problem
from fiber_core.report import plan_report
from fiber_core.wire_units import WireMotion, WireUnits
from fiber_viewer import (
    SOFTWARE,
    BusLoad,
    EventKind,
    Events,
    Measured,
    Recording,
    closest_approaches,
    save_recording,
)
from fiber_viewer.recording_file import ordered_counts

ROBOTS = 37
HELD, FAILED, DISABLED = 5, 11, 20  # rows


def random_recording(seed: int, name: str = "desi") -> Recording:
    """Draw orders that know nothing of neighbours: robots may meet, which a player must show."""
    rng = np.random.default_rng(seed)
    plane = preset(name, ROBOTS).with_enabled(np.arange(ROBOTS) != DISABLED)
    units = WireUnits.for_plane(plane)
    start = units.to_counts(rng.uniform(plane.limits[..., 0], plane.limits[..., 1]))
    lengths = rng.integers(0, 5, 2 * ROBOTS)
    started = ~np.isin(np.arange(ROBOTS), [HELD, DISABLED])
    lengths *= np.repeat(started, 2)
    offsets = np.concatenate([[0], np.cumsum(lengths)])
    ticks = rng.integers(1, 200, offsets[-1])
    velocity = rng.integers(-500, 500, offsets[-1])
    motion = WireMotion(units, start, offsets, ticks, velocity)
    decoded = motion.decoded()
    targets = kinematics.forward(plane, decoded.end)[1]
    targets[3] = np.nan
    problem = Problem(plane, decoded.start, targets)
    outcome, reason = np.zeros((2, ROBOTS), dtype=int)
    outcome[[HELD, DISABLED, 3]] = Outcome.HELD
    reason[[HELD, DISABLED, 3]] = Reason.UNSAFE, Reason.DISABLED, Reason.NO_TARGET
    outcome[FAILED], reason[FAILED] = Outcome.FAILED, Reason.NOT_ACKNOWLEDGED
    times = np.linspace(0.0, decoded.makespan_s, 60)
    planned = SampledMotion(times, np.stack([decoded(t) for t in times], axis=-1))
    row = np.repeat(np.flatnonzero(started), 6)
    time_us = np.tile(rng.integers(0, 3_000_000, 6), int(started.sum())) + np.arange(len(row))
    off = rng.integers(-90, 90, (len(row), 2))
    counts = ordered_counts(motion, row, time_us) + off
    safety = Safety()
    certificate = certify(plane, decoded, safety)
    report = plan_report(problem, decoded, certificate, outcome, reason)
    return Recording(
        problem=problem,
        units=units,
        motion=motion,
        started=started,
        planned=planned,
        measured=Measured(row, time_us, counts),
        load=BusLoad(
            [0], -0.02, 0.005, rng.integers(0, 9, (1, 300)), rng.integers(0, 99, (1, 300))
        ),
        events=Events(
            [0.0, 0.3, 0.4],
            [EventKind.GO, EventKind.NO_ADDRESS, EventKind.FAULT],
            [0, 0, 0],
            [-1, FAILED, FAILED],
            [0, 0, 33],
        ),
        outcome=outcome,
        reason=reason,
        error_mm=np.where(outcome == Outcome.REACHED, 0.002, np.nan),
        approaches=closest_approaches(plane, decoded, units.tick_s),
        about={
            "software": SOFTWARE,
            "plan_ns": 1_790_000_000_000_000_000,
            "seed": seed,
            "planner": "none",
            "notes": [],
            "codes": {"fault": {"33": "memory"}, "alert": {"1": "refused", "4": "rebooted"}},
            "report": report | {"bytes_mean": 10.0, "bus_time_s": 0.02},
            "certificate": {"margin_mm": safety.margin_mm, "ok": certificate.ok},
        },
    )


@pytest.fixture(scope="session")
def recording() -> Recording:
    return random_recording(1)


@pytest.fixture(scope="session")
def recording_file(recording, tmp_path_factory):
    path = tmp_path_factory.mktemp("recording") / "recording.npz"
    save_recording(path, recording)
    return path
