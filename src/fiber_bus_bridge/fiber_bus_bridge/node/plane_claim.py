# SPDX-License-Identifier: Apache-2.0
"""The claim of a bridge to its plane, of which there is one bridge."""

import time

from fiber_bus_bridge.errors import BridgeError
from fiber_node import BRIDGE, Claim, PlaneNode

__all__ = ["OtherBridges", "claim_plane"]

_LEASE_S = 4.0  # a bridge that was killed has left the graph by then
_STAYS_S = 2 * _LEASE_S  # a bridge that refuses to run has left the graph by then
_POLL_S = 0.02


def claim_plane(node: PlaneNode, discovery_s: float) -> Claim:
    """Claim the plane of a node, before any robot is asked.

    Args:
        node: the node of the bridge.
        discovery_s: time in which another bridge would be seen [s].

    Raises:
        BridgeError: an earlier bridge of the same plane is in the graph, and does not leave.
    """
    claim, begin_s = Claim(node, BRIDGE), time.monotonic()
    while (now_s := time.monotonic()) < begin_s + discovery_s or claim.earlier():
        if now_s > begin_s + discovery_s + _LEASE_S:
            earlier = claim.earlier()[0]
            claim.release()
            raise BridgeError(
                f"a bridge of this plane is in the graph already, of {earlier}: end it first, "
                "or use another ROS_DOMAIN_ID or namespace"
            )
        node.pause(_POLL_S)
    return claim


class OtherBridges:
    """Bridges that stay in the graph beside this one.

    A later bridge refuses to run while this one is in the graph. One that stays has not seen this
    one, which was paused perhaps, and may have moved robots.

    Args:
        claim: the claim of this bridge.
    """

    def __init__(self, claim: Claim):
        self._claim = claim
        self._since_s: dict[str, float] = {}

    def stay(self) -> bool:
        """Return whether another bridge has been there for longer than one that refuses to run."""
        now_s, others = time.monotonic(), self._claim.others()
        self._since_s = {each: self._since_s.get(each, now_s) for each in others}
        return any(since_s < now_s - _STAYS_S for since_s in self._since_s.values())
