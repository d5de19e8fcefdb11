# SPDX-License-Identifier: Apache-2.0
"""Recovery of robots at unknown places, by images before and after a small turn of all robots.

Robots that lost their places stand as they stood: the last certificate left `margin_mm` between
their outlines. A turn that moves no point of any arm by more than half of that touches nothing,
wherever the arms are. The light of a robot turns about the axis of its robot, by an angle that lost
motion makes smaller, and so tells which robot it is of. All assignments of lights to robots are
summed as in `identify`. Robots with both elbows in range are refused: so small a turn does not tell
the elbow. A folded arm of which no memory tells the elbow is not told either.
"""

from dataclasses import dataclass
from typing import ClassVar, NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial import cKDTree

from fiber_core import bounds
from fiber_core.arm_bounds import turn_within
from fiber_core.array_types import Angles, Floats, Ints, Mask, Points
from fiber_core.focal_plane import FocalPlane
from fiber_core.turns_of_theta import BEYOND_RAD, turns_in_range
from fiber_core.validation import frozen_array
from fiber_metrology.angles import angles_of_places
from fiber_metrology.errors import MetrologyError
from fiber_metrology.exposures import Lights
from fiber_metrology.identify import IdentifyConfig, most_likely

__all__ = ["Recovered", "RecoveryConfig", "recover", "turn_within_margin"]

_TRACK_MM = 0.08  # a light is the one nearest to where it was, within
_SIGMAS = 9.0  # beyond which a movement is no evidence
_TURN_RAD = 2.0 * np.pi
_BEYOND_RAD = 1e-6  # of a range of phi that ends where the arm is stretched or folded
_ELBOW_RAD = 0.005  # an arm may stand this far beyond the stops of its counter
_LEAST = 1e-12  # evidence over that of a stray light, below which there is none


@dataclass(frozen=True)
class RecoveryConfig:
    """What is known of camera and drives.

    Args:
        margin_mm: gap that the outlines of robots at rest keep [mm].
        error_um: rms error of one coordinate of a place in one image [um], where all exposures
            saw its light; about 2.5 um with nine exposures.
        least: least share of a turn that the arm makes, the rest being lost motion.
        sigmas: errors at which an interval ends.
        identify: chances, as for an image.

    Raises:
        MetrologyError: a value is out of range; names it.
    """

    RANGES: ClassVar = {
        "margin_mm": bounds.Range(1e-3, 1.0),
        "error_um": bounds.Range(1e-3, 1e3),
        "least": bounds.Range(0.0, 1.0),
        "sigmas": bounds.Range(1.0, 10.0),
    }

    margin_mm: float = 0.05
    error_um: float = 2.5
    least: float = 0.4
    sigmas: float = 4.0
    identify: IdentifyConfig = IdentifyConfig()

    def __post_init__(self) -> None:
        bounds.check_ranges(self, self.RANGES, MetrologyError)


@dataclass(frozen=True, eq=False)
class Recovered:
    """Where the robots are.

    Args:
        light: the light of each robot in the second image, -1 where no light is certain, (n,).
        places: its place [mm], shape (n, 2), nan without one.
        angles: joint angles [rad], shape (n, 2), nan without a place.
        interval_rad: half the width of their intervals [rad], shape (n, 2), nan without a place.
        error_mm: bound of the error of each place [mm], shape (n,), nan without a place.
        doubt: probability of anything else, shape (n,).
        turn_known: whether one turn of theta alone is in its range, a little widened, or was
            recalled, shape (n,).
    """

    light: Ints
    places: Points
    angles: Angles
    interval_rad: Angles
    error_mm: Floats
    doubt: Floats
    turn_known: Mask

    @property
    def certain(self) -> Mask:
        """Robots whose place is told as a fact, shape (n,)."""
        return self.light >= 0


def turn_within_margin(plane: FocalPlane, config: RecoveryConfig | None = None) -> Floats:
    """Return how far theta may turn, all robots at once, wherever the arms are.

    No point of an arm moves by more than half the gap that it keeps to its neighbours.

    Args:
        plane: the focal plane.
        config: the gap.

    Returns:
        The turn of theta of each robot [rad], shape (n,).

    Raises:
        MetrologyError: a robot has both elbows in its range; names it.
    """
    config = config or RecoveryConfig()
    _refuse_both_elbows(plane, np.ones(plane.n, dtype=bool))
    return turn_within(plane, config.margin_mm)


def _refuse_both_elbows(plane: FocalPlane, among: Mask) -> None:
    low, high = plane.limits[:, 1].T
    both = np.flatnonzero(among & ((low < -_BEYOND_RAD) | (high > np.pi + _BEYOND_RAD)))
    if len(both):
        raise MetrologyError(
            f"robot {plane.ids[both[0]]} has both elbows in its range of phi: a turn of theta does "
            "not tell them apart"
        )


def recover(
    plane: FocalPlane,
    before: Lights,
    after: Lights,
    turned: ArrayLike,
    config: RecoveryConfig | None = None,
    among: ArrayLike | None = None,
    recalled: ArrayLike | None = None,
) -> Recovered:
    """Find robots from an image before and one after their theta turned.

    Args:
        plane: the focal plane.
        before, after: the lights of both images.
        turned: turns of theta that were ordered [rad], shape (n,).
        config: what is known of camera and drives.
        among: robots that are looked for, shape (n,), by default all. The lights of the others are
            none of `before` and `after`, as far as they are known.
        recalled: angles at which robots rested before they lost their places [rad], shape (n, 2),
            nan for none: of two turns of theta the one within a quarter of a turn is told.

    Raises:
        MetrologyError: a shape does not fit, or a robot has both elbows in its range.
    """
    config = config or RecoveryConfig()
    n = plane.n
    turned = frozen_array(turned, np.float64, (n,), "turned", MetrologyError)
    wanted = np.ones(n) if among is None else among
    wanted = frozen_array(wanted, np.bool_, (n,), "among", MetrologyError)
    rested = np.full((n, 2), np.nan) if recalled is None else recalled
    rested = frozen_array(rested, np.float64, (n, 2), "recalled", MetrologyError)
    _refuse_both_elbows(plane, wanted)
    tracks = _tracks(before, after, config)
    row, light, weight = _pairs(plane, tracks, turned, config, wanted)
    # dark, or lacking in an image
    none = max(config.identify.none - config.identify.missed, 0.0) + 2 * config.identify.missed**2
    found, doubt = most_likely(row, light, weight, plane.n, len(tracks.light), none)
    certain = (found >= 0) & (doubt <= config.identify.certain)
    places = np.full((plane.n, 2), np.nan)
    places[certain] = tracks.last[found[certain]]
    error_mm = np.full(plane.n, np.nan)
    error_mm[certain] = config.sigmas * tracks.error_mm[found[certain]]
    near = np.where(np.isnan(rested), plane.limits.mean(axis=2), rested)
    unremembered: Mask = np.asarray(np.isnan(rested).any(axis=1))
    beyond = np.where(unremembered, 0.0, BEYOND_RAD)
    angles, interval, _ = angles_of_places(plane, places, near, error_mm, beyond)
    # an arm that may stand a little beyond its stop has either elbow
    bent = angles[:, 1] >= 2.0 * np.pi - plane.limits[:, 1, 1] - _ELBOW_RAD
    folded = unremembered & bent
    certain &= ~folded
    for column in (places, angles, interval, error_mm):
        column[folded] = np.nan
    _widen_by_other_elbow(plane, angles, interval, unremembered)
    # a place just outside the range of the other turn may be of an arm beyond its stop
    lowest, highest = turns_in_range(plane.limits[:, 0], angles[:, 0], BEYOND_RAD + interval[:, 0])
    other = highest > lowest
    other &= ~(np.abs(angles[:, 0] - rested[:, 0]) < _TURN_RAD / 4.0)
    told = np.full(plane.n, -1)
    told[certain] = tracks.light[found[certain]]
    return Recovered(told, places, angles, interval, error_mm, doubt, certain & ~other)


def _widen_by_other_elbow(
    plane: FocalPlane, angles: Angles, interval: Angles, chosen: Mask
) -> None:
    """Let intervals of stretched arms hold the other elbow, a little beyond the stop of phi."""
    phi = angles[:, 1]
    straight = chosen & (phi <= _ELBOW_RAD - plane.limits[:, 1, 0])
    lead = plane.arms[:, 1] / plane.arms.sum(axis=1) * phi  # of theta before the tip
    interval[:, 0] += np.where(straight, 2.0 * np.abs(lead), 0.0)
    interval[:, 1] += np.where(straight, 2.0 * np.abs(phi), 0.0)


class _Tracks(NamedTuple):
    # lights that both images show: their rows in the second, both places, and the error of a
    # coordinate of the second place and of the movement [mm]
    light: Ints
    first: Points
    last: Points
    error_mm: Floats
    moved_mm: Floats


def _tracks(before: Lights, after: Lights, config: RecoveryConfig) -> _Tracks:
    here, there = np.flatnonzero(~before.merged), np.flatnonzero(~after.merged)
    if len(here) and len(there):
        ends = after.places[there]
        apart, at = cKDTree(ends).query(before.places[here])
        back = cKDTree(before.places[here]).query(ends)[1]
        kept = (apart <= _TRACK_MM) & (back[at] == np.arange(len(at)))
        here, there = here[kept], there[at[kept]]
    else:
        here, there = here[:0], there[:0]
    seen = before.seen[here], after.seen[there]
    # fewer exposures, a larger error
    error = [1e-3 * config.error_um * np.sqrt(of.exposures / k)
             for of, k in zip((before, after), seen)]  # fmt: skip
    # a stray light that lasts is seen as often as a fibre: the number tells nothing of which it is
    return _Tracks(there, before.places[here], after.places[there], error[1], np.hypot(*error))


def _pairs(
    plane: FocalPlane, tracks: _Tracks, turned: Floats, config: RecoveryConfig, among: Mask
) -> tuple[Ints, Ints, Floats]:
    """Robots and lights in their reach, and the evidence over that of a stray light, (p,) each."""
    first, last = tracks.first, tracks.last
    furthest_mm = config.sigmas * float(tracks.error_mm.max(initial=0.0))
    reach = plane.arms.sum(axis=1) + furthest_mm
    near = cKDTree(first).query_ball_point(plane.centers, reach) if len(first) else []
    row = np.repeat(np.arange(len(near)), [len(each) for each in near])
    light = np.array([k for each in near for k in each], dtype=np.int64)
    row, light = row[among[row]], light[among[row]]
    sigma_mm = tracks.moved_mm[light]
    moved = last[light] - first[light]
    off_mm = _off_turn(first[light] - plane.centers[row], moved, turned[row], config.least)
    stays = _density(np.hypot(*moved.T), sigma_mm)
    unmoved = config.identify.unmoved
    usual = (1.0 - unmoved) * _density(off_mm, sigma_mm) + unmoved * stays
    area = np.pi * plane.arms[row].sum(axis=1) ** 2
    # the light of no fibre stays, or is another one that lies near by chance
    stray = config.identify.lasting_per_mm2 * (stays + 1.0 / (np.pi * _TRACK_MM**2))
    weight = usual / area / stray
    kept = weight > _LEAST
    return row[kept], light[kept], weight[kept]


def _off_turn(arm: Points, moved: Points, turn: Floats, least: float) -> Floats:
    """How far movements are from those of a turn about an axis, of which a part was lost [mm]."""
    way = np.stack([-arm[:, 1], arm[:, 0]], axis=1) * turn[:, None]
    length = np.maximum((way**2).sum(axis=1), 1e-18)
    share = np.clip((moved * way).sum(axis=1) / length, least, 1.0)
    return np.hypot(*(moved - share[:, None] * way).T)


def _density(off_mm: Floats, sigma_mm: Floats) -> Floats:
    far = np.minimum(off_mm / sigma_mm, _SIGMAS) ** 2 / 2.0
    return np.where(off_mm < _SIGMAS * sigma_mm, np.exp(-far), 0.0) / (2 * np.pi * sigma_mm**2)
