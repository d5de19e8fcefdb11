# SPDX-License-Identifier: Apache-2.0
"""The judge of `soak.py`: the true motion of the robots of a campaign, and no report of theirs."""

from collections import Counter
from dataclasses import dataclass, field

import numpy as np

from fiber_bus_bridge import LoadedPlan, PlanResult, Session
from fiber_bus_bridge.capture import Tap
from fiber_bus_bridge.simulation import Movements, TrueMotion
from fiber_core.clearance import Safety, certify_arms, neighbour_pairs
from fiber_core.outcomes import Outcome
from fiber_positioners import Orders

__all__ = ["SAFETY", "Campaign", "Setup", "judge_motion", "judge_outcomes"]

SAFETY = Safety()


@dataclass
class Campaign:
    """Result of a campaign; an empty `wrong` means that it passed.

    Args:
        kind: one of KINDS.
        seed: seed of all random numbers.
        wrong: events that must never happen and did.
        log: the course of the campaign, in words.
        outcomes: number of robots by outcome.
        gap_mm: smallest true gap between outlines [mm].
        apart_ms: longest time between the first and the last stop of one motion [ms].
        ended_s: simulated end time [s].
        tap: the captured traffic, if requested.
    """

    kind: str
    seed: int
    wrong: list[str] = field(default_factory=list)
    log: list[str] = field(default_factory=list)
    outcomes: Counter[str] = field(default_factory=Counter)
    gap_mm: float = np.inf
    apart_ms: float = 0.0
    ended_s: float = 0.0
    tap: Tap | None = None


@dataclass
class Setup:
    """A session with simulated robots, and the phases of its plans so far."""

    orders: Orders
    session: Session
    truth: TrueMotion
    stop_s: float  # simulated time of an operator's stop, inf for none
    phases: list[LoadedPlan] = field(default_factory=list)


def judge_motion(campaign: Campaign, setup: Setup, t: float) -> None:
    """Judge the true motion until time t [s]: orders, stops and gaps."""
    plane = setup.orders.plane
    campaign.ended_s = t
    moves = setup.truth.movements(t)
    _judge_movements(campaign, moves, setup.phases)
    campaign.apart_ms = 1e3 * _apart_s(moves, setup.phases, setup.orders.units.tick_s)
    motion = setup.truth.motion(t)
    exact = Safety(0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    truth = certify_arms(plane, motion, exact, neighbour_pairs(plane))
    campaign.gap_mm = truth.min_gap_mm
    if truth.unsafe.any():
        at = int(np.argmin(truth.gap_mm))
        campaign.wrong.append(
            f"arms touch: robots {truth.pairs[at].tolist()} at {truth.time_s[at]:.4f} s, "
            f"gap {truth.gap_mm[at]:.4f} mm"
        )


def judge_outcomes(
    campaign: Campaign, name: str, t: float, session: Session, result: PlanResult | None
) -> None:
    """Check that every robot has exactly one outcome and one reason."""
    if result is None or not len(result.outcome) == len(result.reason) == session.plane.n:
        campaign.wrong.append(f"{name}: not every robot has one outcome")
        return
    counts = Counter(Outcome(o).name.lower() for o in result.outcome)
    campaign.outcomes += counts
    campaign.log.append(f"{t:.4f} s: {name} ended {session.state.name}: {dict(counts)}")


def _judge_movements(campaign: Campaign, moves: Movements, phases: list[LoadedPlan]) -> None:
    """Check that each movement is, from first to last segment, a verified order."""
    for k, row in enumerate(moves.row):
        if not moves.ended_s[k] > moves.started_s[k]:
            if np.isnan(moves.ended_s[k]):
                campaign.wrong.append(f"robot {row} never came to rest")
            continue  # cancelled in its countdown
        late = [abs(moves.started_s[k] - phase.start_s) for phase in phases]
        phase = phases[int(np.argmin(late))] if late else None
        if phase is None or min(late) > SAFETY.start_skew_s or not phase.started[row]:
            campaign.wrong.append(f"robot {row} moved at {moves.started_s[k]:.4f} s unverified")
            continue
        wire = phase.motion
        for joint in range(2):
            part = slice(*wire.offsets[2 * row + joint : 2 * row + joint + 2])
            count = moves.counts[k, joint]
            same = (
                count == part.stop - part.start
                and np.array_equal(moves.ticks[k, joint, :count], wire.ticks[part])
                and np.array_equal(moves.velocity[k, joint, :count], wire.velocity[part])
            )
            if not same:
                campaign.wrong.append(f"robot {row} executed another order than was verified")


def _apart_s(moves: Movements, phases: list[LoadedPlan], tick_s: float) -> float:
    """Longest time between the first and the last stop of a phase that was broken off [s]."""
    used = np.arange(moves.ticks.shape[2]) < moves.counts[..., None]
    lasts = (moves.ticks * used).sum(axis=2)
    broken = moves.ended_s > moves.started_s
    broken &= moves.ended_s < moves.started_s + (1 - 1e-3) * lasts.max(axis=1) * tick_s
    apart = [0.0]
    for phase in phases:
        of_phase = broken & (np.abs(moves.started_s - phase.start_s) <= SAFETY.start_skew_s)
        apart.append(float(np.ptp(moves.ended_s[of_phase])) if of_phase.any() else 0.0)
    return max(apart)
