"""Qualities of service, named by purpose. All are reliable: a plan has no spare parts."""

from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy

__all__ = ["EVENTS", "LATEST", "RESULTS", "STREAM"]


def _profile(depth: int, durability: DurabilityPolicy) -> QoSProfile:
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST,
        depth=depth,
        reliability=ReliabilityPolicy.RELIABLE,
        durability=durability,
    )


# the newest message counts, and whoever comes late gets it too
LATEST = _profile(1, DurabilityPolicy.TRANSIENT_LOCAL)
# every message counts, two may come at once, and whoever comes late gets the last few too
RESULTS = _profile(10, DurabilityPolicy.TRANSIENT_LOCAL)
# every message counts, and comes alone
EVENTS = _profile(10, DurabilityPolicy.VOLATILE)
# every message counts, and several may come before the first is read
STREAM = _profile(100, DurabilityPolicy.VOLATILE)
