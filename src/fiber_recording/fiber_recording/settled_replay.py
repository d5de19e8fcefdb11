# SPDX-License-Identifier: Apache-2.0
"""Replays a plan that a client of the graph followed, once the client has all its frames."""

from numpy.typing import ArrayLike

from fiber_client.client import PlaneClient
from fiber_core.array_types import Ids
from fiber_core.outcomes import PlanOutcome
from fiber_msgs_py import PlanStamp
from fiber_recording.replay import Replay, replay, unexplained

__all__ = ["settled_replay"]


def settled_replay(
    client: PlaneClient, outcome: PlanOutcome, counts_before: ArrayLike, timeout_s: float
) -> Replay:
    """Wait until the frames that a client received explain all encoders; return the replay.

    The replay of a plan with several attempts is that of the last attempt.

    Args:
        client: a client that followed the plan.
        outcome: how the robots ended the plan; robots that failed may be anywhere.
        counts_before: encoders before the plan [quanta], shape (n, 2).
        timeout_s: longest time to wait for the last frames and encoder readings [s].

    Raises:
        WaitError: the time is over; names a robot that is not where the frames lead.
    """
    plan = PlanStamp(outcome.stamp_ns)
    settled: list[Replay] = []

    def follow() -> tuple[Replay, Ids]:
        last = client.last_attempt(plan)
        before = counts_before if last == plan else client.counts_before[last]
        followed = replay(client.plane, client.units, before, client.frames.get(last, ()))
        counts = client.units.to_counts(client.angles)
        off = unexplained(client.plane, followed, outcome, counts)
        return followed, client.plane.ids[off]

    def is_settled() -> bool:
        followed, off = follow()
        if not len(off):
            settled.append(followed)
        return not len(off)

    client.wait_for(
        is_settled, timeout_s, lambda: f"frames that explain where robot {follow()[1][0]} is"
    )
    return settled[-1]
