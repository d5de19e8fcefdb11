# SPDX-License-Identifier: Apache-2.0
"""Makespans that are tried for a first plan, in units of the time of the slowest robot alone."""

import numpy as np

from fiber_core.focal_plane import FocalPlane
from fiber_core.motors import speeds_alone
from fiber_core.wire_units import WireUnits

__all__ = ["stretches_of"]

_LOOSE = (1.0, 1.02, 1.05, 1.1, 1.15, 1.19, 1.25, 1.4, 1.6, 1.8, 2.0)
_CROWDED = (1.2, 1.35, 1.5, 1.75, 2.0, 2.15)
_LONGER = 1.4  # growth beyond those


def stretches_of(plane: FocalPlane, crowded: bool, alone_s: float, stretch: float) -> list[float]:
    """Return the makespans to try, shortest first, in units of the time alone.

    The longest is at least long enough to fold, go, and unfold, however short the way is, and no
    longer than an order can last.

    Args:
        plane: the focal plane.
        crowded: whether straight motions conflict in so many pairs that arms fold from the start.
        alone_s: time that the slowest robot needs alone [s].
        stretch: the longest makespan unless the way is short.
    """
    bend = np.minimum(np.pi, np.diff(plane.limits[:, 1])[:, 0])
    fold_s = float((bend / speeds_alone(plane)[:, 1]).max(initial=0.0))
    most = max(stretch, 1.0 + 2.0 * fold_s / max(alone_s, 1e-9))
    longest_s = WireUnits.for_plane(plane).longest_order_s
    most = min(most, max(1.0, longest_s / max(alone_s, 1e-9)))
    usual = _CROWDED if crowded else _LOOSE
    tried = [tried for tried in usual if tried <= most] or [most]
    while tried[-1] * _LONGER <= most:
        tried.append(tried[-1] * _LONGER)
    return tried
