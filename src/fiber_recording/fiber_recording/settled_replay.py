"""The replay of a plan that a client followed, once all its frames have come in."""

from fiber_client.client import PlaneClient
from fiber_core.outcomes import PlanOutcome
from fiber_msgs_py import PlanStamp
from fiber_recording.replay import Replay, replay, unexplained

__all__ = ["settled_replay"]


def settled_replay(client: PlaneClient, ended: PlanOutcome, counts, timeout_s: float) -> Replay:
    """Wait until the frames a client heard explain where all encoders are; return the replay.

    Of a plan with several attempts it is the replay of the last.

    Args:
        client: has followed the plan.
        ended: what became of it; failed robots may be anywhere.
        counts: encoders before the plan [quanta], shape (n, 2).
        timeout_s: for the last frames and readings to come in [s].

    Raises:
        WaitError: they did not; names the first robot that is elsewhere.
    """
    plan, told = PlanStamp(ended.stamp_ns), None

    def elsewhere():
        nonlocal told
        last = client.last_attempt(plan)
        before = counts if last == plan else client.counts_before[last]
        told = replay(client.plane, client.units, before, client.frames.get(last, ()))
        off = unexplained(client.plane, told, ended, client.units.to_counts(client.angles))
        return client.plane.ids[off]

    client.wait_for(
        lambda: not len(elsewhere()),
        timeout_s,
        lambda: f"frames that explain where robot {elsewhere()[0]} is",
    )
    return told
