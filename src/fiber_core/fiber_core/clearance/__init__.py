# SPDX-License-Identifier: Apache-2.0
"""Clearance: outlines, the gaps between them, and the certificate that they stay apart."""

from fiber_core.clearance.certificate import (
    Certificate,
    certified_pairs,
    certify,
    certify_arms,
    smallest_gaps,
    unproven,
)
from fiber_core.clearance.collision_bodies import Bodies, bodies_of
from fiber_core.clearance.distance import (
    gaps,
    pair_gap,
    pair_gap_below,
    posed_gap,
    sampled_gaps,
    swept_gap,
)
from fiber_core.clearance.hold_unsafe import hold_until_safe
from fiber_core.clearance.neighbours import (
    Neighbours,
    most_neighbours,
    neighbour_pairs,
    neighbours_of,
)
from fiber_core.clearance.safety import Safety, levers_of, point_speeds

__all__ = [
    "Bodies",
    "Certificate",
    "Neighbours",
    "Safety",
    "bodies_of",
    "certified_pairs",
    "certify",
    "certify_arms",
    "gaps",
    "hold_until_safe",
    "levers_of",
    "most_neighbours",
    "neighbour_pairs",
    "neighbours_of",
    "pair_gap",
    "pair_gap_below",
    "point_speeds",
    "posed_gap",
    "sampled_gaps",
    "smallest_gaps",
    "swept_gap",
    "unproven",
]
