"""A small recording with everything in it: many segments, robots held, failed, disabled, faults."""

import numpy as np
import pytest

from fiber_core import kinematics
from fiber_core.clearance import Safety, certify
from fiber_core.corridor import JointCorridors
from fiber_core.metrics import plan_metrics
from fiber_core.motion import SampledMotion
from fiber_core.outcomes import Outcome, Reason
from fiber_core.presets import preset
from fiber_core.problem import Problem
from fiber_core.wire_units import WireMotion, WireUnits
from fiber_recording import (
    SOFTWARE,
    BusLoad,
    EventKind,
    Events,
    Measured,
    Phase,
    Recording,
    closest_approaches,
    counts_at,
    executed,
    save_recording,
)

ROBOTS = 37
HELD, FAILED, DISABLED = 5, 11, 20  # rows


STOP_US, ON_US = 300_300, 455_001  # when all are stopped, and when some go on


def stopped(motion, rng):
    """Return orders as far as STOP_US, and the rest of them from ON_US on, without one robot."""
    n, tick_us = len(motion.start), motion.units.tick_us
    rows = np.flatnonzero(1e6 * motion.decoded().durations.max(axis=1) > STOP_US)
    stop_us, stop = np.full(n, -1), np.zeros((n, 2), dtype=int)
    stop_us[rows] = STOP_US
    stop_us[FAILED] = 211_000  # by itself
    stop[rows] = counts_at([Phase.whole(motion)], rows, stop_us[rows]) + rng.integers(-3, 4)
    first = Phase(motion, 0, stop_us, stop)
    passed, lengths = STOP_US // tick_us, np.zeros((n, 2), dtype=int)
    ticks, velocity = [], []
    for row in rows[rows != FAILED]:
        for joint in (0, 1):
            part = slice(*motion.offsets[2 * row + joint : 2 * row + joint + 2])
            left = np.clip(np.cumsum(motion.ticks[part]) - passed, 0, motion.ticks[part])
            ticks += left[left > 0].tolist()
            velocity += motion.velocity[part][left > 0].tolist()
            lengths[row, joint] = (left > 0).sum()
    offsets = np.concatenate([[0], np.cumsum(lengths)])
    again = WireMotion(motion.units, first.end, offsets, ticks, velocity)
    return first, Phase.whole(again, ON_US)


def margins_of(motion, rng):
    """Return walls at random distances from what is done."""
    decoded = motion.decoded()
    lasts = decoded.durations.max(axis=1)
    sent = np.stack(
        [np.stack([decoded(t)[row] for t in np.linspace(0, lasts[row], 7)], axis=-1)
         for row in range(decoded.n)]
    )  # fmt: skip
    return JointCorridors(
        lasts, sent - rng.uniform(0.01, 1, sent.shape), sent + rng.uniform(0.01, 1, sent.shape)
    )


def random_recording(seed: int, name: str = "desi", goes_wrong: bool = False) -> Recording:
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
    phases = stopped(motion, rng) if goes_wrong else (Phase.whole(motion),)
    decoded = executed(phases)
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
    counts = counts_at(phases, row, time_us) + off
    safety = Safety()
    certificate = certify(plane, decoded, safety)
    report = plan_metrics(problem, decoded, certificate, outcome, reason)
    return Recording(
        problem=problem,
        units=units,
        phases=phases,
        started=started,
        planned=planned,
        corridors=margins_of(motion, rng),
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
def resumed() -> Recording:
    """All were stopped on the way and went on, but for one."""
    return random_recording(2, goes_wrong=True)


@pytest.fixture(scope="session")
def recording_file(recording, tmp_path_factory):
    path = tmp_path_factory.mktemp("recording") / "recording.npz"
    save_recording(path, recording)
    return path


@pytest.fixture(scope="session")
def resumed_file(resumed, tmp_path_factory):
    path = tmp_path_factory.mktemp("recording") / "resumed.npz"
    save_recording(path, resumed)
    return path
