# SPDX-License-Identifier: Apache-2.0
"""Qualities of service by purpose. All are reliable: a plan needs every message."""

from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy

__all__ = ["EVENTS", "LATEST", "RESULTS", "SECTORS", "STREAM", "queued"]

_QUEUE = 100


def _profile(depth: int, durability: DurabilityPolicy) -> QoSProfile:
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST,
        depth=depth,
        reliability=ReliabilityPolicy.RELIABLE,
        durability=durability,
    )


# only the newest message counts; a late subscriber gets it too
LATEST = _profile(1, DurabilityPolicy.TRANSIENT_LOCAL)
# every message counts, two may come at once; a late subscriber gets the last ten too
RESULTS = _profile(10, DurabilityPolicy.TRANSIENT_LOCAL)
# every message counts; few come at a time
EVENTS = _profile(10, DurabilityPolicy.VOLATILE)
# every message counts; many may come before the first is read
STREAM = _profile(100, DurabilityPolicy.VOLATILE)
# what is lost is sent again by its sender, with what has changed since
SECTORS = _profile(20, DurabilityPolicy.VOLATILE)


def queued(profile: QoSProfile) -> QoSProfile:
    """Return the quality of a subscription from which no stranger pushes out a message.

    The depth of a subscription counts the messages of all publishers, until they are read.
    """
    return _profile(max(_QUEUE, profile.depth), profile.durability)
