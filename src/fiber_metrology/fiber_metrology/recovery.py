# SPDX-License-Identifier: Apache-2.0
"""Recovery of robots at unknown places, by images before and after a small turn of all robots.

Robots that lost their places stand as they stood: the last certificate left `margin_mm` between
their outlines. A turn that moves no point of any arm by more than half of that touches nothing,
wherever the arms are. The light of a robot turns about the axis of its robot, by an angle that lost
motion makes smaller, and so tells which robot it is of. All assignments of lights to robots are
summed as in `identify`. A turn of theta does not tell the elbow: robots with both elbows in range
turn phi instead (`elbows`), and one of which the movement does not tell the elbow is not told. A
folded arm of a robot with one elbow in range, of which no memory tells the elbow, is not told
either.
"""

from dataclasses import dataclass
from typing import ClassVar, NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial import cKDTree

from fiber_core import bounds
from fiber_core.arm_bounds import both_elbows, joints_of_test_turns, turn_within
from fiber_core.array_types import Angles, Floats, Ints, Mask, Points
from fiber_core.focal_plane import FocalPlane
from fiber_core.turns_of_theta import BEYOND_RAD, turns_in_range
from fiber_core.validation import frozen_array
from fiber_metrology.angles import angles_of_places
from fiber_metrology.elbows import BEYOND_STOP_RAD, elbows_of_places
from fiber_metrology.errors import MetrologyError
from fiber_metrology.exposures import Lights
from fiber_metrology.identify import IdentifyConfig, most_likely

__all__ = ["Recovered", "RecoveryConfig", "recover", "turn_within_margin"]

_TRACK_MM = 0.08  # a light is the one nearest to where it was, within
_SIGMAS = 9.0  # beyond which a movement is no evidence
_TURN_RAD = 2.0 * np.pi
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
        doubt: probability of anything else, another elbow too, shape (n,).
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


def turn_within_margin(plane: FocalPlane, config: RecoveryConfig | None = None) -> Angles:
    """Return how far robots may turn, all at once, wherever the arms are.

    No point of an arm moves by more than half the gap that it keeps to its neighbours. Robots with
    both elbows in range turn phi, the others theta. After a turn one way twice as much is free the
    other way, which tells elbows that the first turn does not.

    Args:
        plane: the focal plane.
        config: the gap.

    Returns:
        The turn of each joint [rad], shape (n, 2).
    """
    config = config or RecoveryConfig()
    joint = joints_of_test_turns(plane)
    turn = turn_within(plane, config.margin_mm, joint)
    return np.where(joint[:, None] == [0, 1], turn[:, None], 0.0)


def recover(
    plane: FocalPlane,
    before: Lights,
    after: Lights,
    turned: ArrayLike,
    config: RecoveryConfig | None = None,
    among: ArrayLike | None = None,
    recalled: ArrayLike | None = None,
) -> Recovered:
    """Find robots from an image before and one after a joint of each turned a little.

    Args:
        plane: the focal plane.
        before, after: the lights of both images.
        turned: turns that were ordered, of one joint of each robot [rad], shape (n, 2).
        config: what is known of camera and drives.
        among: robots that are looked for, shape (n,), by default all. The lights of the others are
            none of `before` and `after`, as far as they are known.
        recalled: angles at which robots rested before they lost their places [rad], shape (n, 2),
            nan for none: of two turns of theta the one within a quarter of a turn is told, and of
            two elbows the nearer one.

    Raises:
        MetrologyError: a shape does not fit, or both joints of a robot that is looked for turned.
    """
    config = config or RecoveryConfig()
    n = plane.n
    turned = frozen_array(turned, np.float64, (n, 2), "turned", MetrologyError)
    wanted = np.ones(n) if among is None else among
    wanted = frozen_array(wanted, np.bool_, (n,), "among", MetrologyError)
    rested = np.full((n, 2), np.nan) if recalled is None else recalled
    rested = frozen_array(rested, np.float64, (n, 2), "recalled", MetrologyError)
    twice = np.flatnonzero(wanted & (turned != 0.0).all(axis=1))
    if len(twice):
        raise MetrologyError(f"robot {plane.ids[twice[0]]} turned both joints: turned takes one")
    unremembered: Mask = np.asarray(np.isnan(rested).any(axis=1))
    near = np.where(unremembered[:, None], plane.limits.mean(axis=2), rested)
    tracks = _tracks(before, after, config)
    pairs = _pairs(plane, tracks, turned, config, wanted, near, ~unremembered)
    row, light, weight = pairs.row, pairs.light, pairs.weight
    # dark, or lacking in an image
    none = max(config.identify.none - config.identify.missed, 0.0) + 2 * config.identify.missed**2
    found, doubt = most_likely(row, light, weight, plane.n, len(tracks.light), none)
    bends = both_elbows(plane)
    elbow, doubt = _elbows(pairs, found, doubt, bends)
    certain = (found >= 0) & (doubt <= config.identify.certain)
    places = np.full((plane.n, 2), np.nan)
    places[certain] = tracks.last[found[certain]]
    error_mm = np.full(plane.n, np.nan)
    error_mm[certain] = config.sigmas * tracks.error_mm[found[certain]]
    told = np.flatnonzero(certain & bends)
    near[told] = elbows_of_places(plane, told, places[told], near[told]).angles[
        np.arange(len(told)), elbow[told]
    ]
    beyond = np.where(unremembered, np.where(bends, BEYOND_STOP_RAD, 0.0), BEYOND_RAD)
    angles, interval, _ = angles_of_places(plane, places, near, error_mm, beyond)
    # an arm that may stand a little beyond its stop has either elbow
    bent = angles[:, 1] >= 2.0 * np.pi - plane.limits[:, 1, 1] - BEYOND_STOP_RAD
    folded = unremembered & bent & ~bends
    certain &= ~folded
    for column in (places, angles, interval, error_mm):
        column[folded] = np.nan
    _widen_by_other_elbow(plane, angles, interval, unremembered & ~bends)
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
    straight = chosen & (phi <= BEYOND_STOP_RAD - plane.limits[:, 1, 0])
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


class _Pairs(NamedTuple):
    # robots and lights in their reach, the evidence over that of a stray light, and the evidence
    # of each elbow, shape (p, 2); of a robot with one elbow in range the first is told
    row: Ints
    light: Ints
    weight: Floats
    of_elbow: Floats


def _pairs(
    plane: FocalPlane, tracks: _Tracks, turned: Angles, config: RecoveryConfig, among: Mask,
    near: Angles, remembered: Mask,
) -> _Pairs:  # fmt: skip
    first, last = tracks.first, tracks.last
    furthest_mm = config.sigmas * float(tracks.error_mm.max(initial=0.0))
    reach = plane.arms.sum(axis=1) + furthest_mm
    within = cKDTree(first).query_ball_point(plane.centers, reach) if len(first) else []
    row = np.repeat(np.arange(len(within)), [len(each) for each in within])
    light = np.array([k for each in within for k in each], dtype=np.int64)
    row, light = row[among[row]], light[among[row]]
    sigma_mm = tracks.moved_mm[light]
    moved = last[light] - first[light]
    stays = _density(np.hypot(*moved.T), sigma_mm)
    unmoved = config.identify.unmoved
    by_theta, by_phi = turned[row].T
    elbows = elbows_of_places(plane, row, first[light], near[row])
    one = ~both_elbows(plane)[row]
    off = np.abs(elbows.angles[:, :, 1] - near[row, 1, None])
    kept = (off <= off.min(axis=1)[:, None]) | ~remembered[row, None]  # it stands as it stood
    possible = np.where(one[:, None], [True, False], elbows.possible & kept)
    of_elbow = np.zeros((len(row), 2))
    for k in range(2):
        # theta turns all of an arm, phi the part from the elbow on
        turns_phi = by_phi != 0.0
        arm = np.where(turns_phi[:, None], elbows.arm[:, k], first[light] - plane.centers[row])
        off_mm = _off_turn(arm, moved, np.where(turns_phi, by_phi, by_theta), config.least)
        usual = (1.0 - unmoved) * _density(off_mm, sigma_mm) + unmoved * stays
        of_elbow[:, k] = np.where(possible[:, k], usual, 0.0)
    of_elbow /= np.maximum(possible.sum(axis=1), 1)[:, None]
    area = np.pi * plane.arms[row].sum(axis=1) ** 2
    # the light of no fibre stays, or is another one that lies near by chance
    stray = config.identify.lasting_per_mm2 * (stays + 1.0 / (np.pi * _TRACK_MM**2))
    weight = of_elbow.sum(axis=1) / area / stray
    kept = weight > _LEAST
    return _Pairs(row[kept], light[kept], weight[kept], of_elbow[kept])


def _elbows(pairs: _Pairs, found: Ints, doubt: Floats, bends: Mask) -> tuple[Ints, Floats]:
    """The likelier elbow of each robot, and the doubt of its light and of its elbow, (n,) each."""
    elbow, doubt = np.zeros(len(found), dtype=np.int64), np.array(doubt)
    kept = (pairs.light == found[pairs.row]) & bends[pairs.row]
    row, evidence = pairs.row[kept], pairs.of_elbow[kept]
    elbow[row] = evidence.argmax(axis=1)
    other = evidence.min(axis=1) / evidence.sum(axis=1)
    doubt[row] = 1.0 - (1.0 - doubt[row]) * (1.0 - other)
    return elbow, doubt


def _off_turn(arm: Points, moved: Points, turn: Floats, least: float) -> Floats:
    """How far movements are from those of a turn about an axis, of which a part was lost [mm]."""
    way = np.stack([-arm[:, 1], arm[:, 0]], axis=1) * turn[:, None]
    length = np.maximum((way**2).sum(axis=1), 1e-18)
    share = np.clip((moved * way).sum(axis=1) / length, least, 1.0)
    return np.hypot(*(moved - share[:, None] * way).T)


def _density(off_mm: Floats, sigma_mm: Floats) -> Floats:
    far = np.minimum(off_mm / sigma_mm, _SIGMAS) ** 2 / 2.0
    return np.where(off_mm < _SIGMAS * sigma_mm, np.exp(-far), 0.0) / (2 * np.pi * sigma_mm**2)
