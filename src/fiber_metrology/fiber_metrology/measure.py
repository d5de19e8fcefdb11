# SPDX-License-Identifier: Apache-2.0
"""From exposures to measured places, joint angles and a verdict on every robot."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fiber_core import bounds, kinematics
from fiber_core.arm_bounds import interval_of_tips
from fiber_core.array_types import Angles, Codes, Floats, Ints, Mask, Points
from fiber_core.clearance import levers_of
from fiber_core.focal_plane import FIXED_JOINT_RAD, FocalPlane
from fiber_core.outcomes import STILL, Verdict
from fiber_core.validation import frozen_array
from fiber_metrology.angles import angles_of_places, likeliest_angles
from fiber_metrology.errors import ImageError, MetrologyError
from fiber_metrology.exposures import Lights, beside_free_lights, combine
from fiber_metrology.identify import IdentifyConfig, identify
from fiber_metrology.plate import PlateConfig
from fiber_metrology.reasons import reason_text
from fiber_metrology.spots import Spots

__all__ = ["Expected", "MeasureConfig", "Measurement", "Verdict", "measure"]


_DOUBTFUL = 2.0  # intervals of an image over those of the drive, from which on the drive is better
_THERE = np.array([Verdict.MEASURED, *STILL])  # of a robot at each of its places


@dataclass(frozen=True)
class MeasureConfig:
    """Errors of camera and air, and what counts as no motion.

    Args:
        error_um: rms error of one coordinate of a place in one exposure [um].
        sigmas: errors at which an interval ends.
        moved_um: a joint that should have moved its fibre less than this is not judged [um].
        moved_sigmas: a joint that should have moved its fibre less than so many errors of the drive
            is not judged.
        blame: a joint did not turn if it is less likely than this that both did.
        found: least share of the lights that must be of robots, in an image with a light for every
            second robot or more; else it is not of this plane.
        off_model: distance from the expected place, in errors of that place, above which a robot is
            off its model.
        drive_sigmas: errors of the drive at which the interval of a joint ends that the image alone
            does not tell: theta of a folded arm, and which elbow.
        plate: what an image must have.
        identify: what is known before an image.

    Raises:
        MetrologyError: a value is out of range; names it.
    """

    RANGES: ClassVar = {
        "error_um": bounds.Range(1e-3, 1e3),
        "sigmas": bounds.Range(1.0, 10.0),
        "moved_um": bounds.Range(0.0, 1e5),
        "moved_sigmas": bounds.Range(0.0, 1e3),
        "blame": bounds.Range(0.0, 0.5),
        "off_model": bounds.Range(1.0, 100.0),
        "found": bounds.Range(0.0, 1.0),
        "drive_sigmas": bounds.Range(0.0, 10.0),
    }

    error_um: float = 4.5
    sigmas: float = 4.0
    moved_um: float = 300.0
    moved_sigmas: float = 12.0
    blame: float = 0.01
    off_model: float = 6.0
    found: float = 0.5
    drive_sigmas: float = 2.0
    plate: PlateConfig = field(default_factory=PlateConfig)
    identify: IdentifyConfig = field(default_factory=IdentifyConfig)

    def __post_init__(self) -> None:
        bounds.check_ranges(self, self.RANGES, MetrologyError)

    def judged_mm(self, error_um: ArrayLike) -> Floats:
        """Return how far a joint must have been told to move a fibre so that it is judged [mm].

        Args:
            error_um: error of a coordinate of the fibre after the motion, 1 sigma [um].
        """
        return 1e-3 * np.maximum(self.moved_um, self.moved_sigmas * np.asarray(error_um))


@dataclass(frozen=True, eq=False)
class Expected:
    """What is known of the robots before an image.

    Args:
        plane: the focal plane.
        counters: joint angles as the counters read them now [rad], shape (n, 2).
        before: joint angles before the motion, as they were known then [rad], shape (n, 2).
        before_rad: half the width of their intervals [rad], shape (n, 2).
        error_um: error of one coordinate of a place after the motion, 1 sigma [um], one number or
            shape (n,).
        dark: fibres without light in earlier images, shape (n,); by default none.
        unplaced: robots at unknown places, of which no light is told, shape (n,); by default none.
        joints_rad: error of each joint angle after the motion, 1 sigma [rad], shape (n, 2): where a
            fibre is of which one joint stuck. By default that place has the error error_um.

    Raises:
        MetrologyError: a shape does not fit, or a value is out of range; names it.
    """

    plane: FocalPlane
    counters: Angles
    before: Angles
    before_rad: Angles
    error_um: ArrayLike
    dark: ArrayLike | None = None
    unplaced: ArrayLike | None = None
    joints_rad: ArrayLike | None = None

    def __post_init__(self) -> None:
        n = self.plane.n
        for name in ("counters", "before", "before_rad"):
            value = frozen_array(getattr(self, name), np.float64, (n, 2), name, MetrologyError)
            if not np.isfinite(value).all():
                row = int(np.argwhere(~np.isfinite(value))[0][0])
                raise MetrologyError(f"robot {self.plane.ids[row]}: {name} is not finite")
            object.__setattr__(self, name, value)
        error = np.broadcast_to(np.asarray(self.error_um, dtype=float), (n,))
        if not ((error > 0.0) & np.isfinite(error)).all():
            raise MetrologyError(f"error_um must be positive, got {error.min()}")
        object.__setattr__(self, "error_um", error)
        if self.joints_rad is not None:
            joints = frozen_array(self.joints_rad, np.float64, (n, 2), "joints_rad", MetrologyError)
            if not ((joints >= 0.0) & np.isfinite(joints)).all():
                raise MetrologyError(f"joints_rad must not be negative, got {joints.min()}")
            object.__setattr__(self, "joints_rad", joints)
        for name in ("dark", "unplaced"):
            given = getattr(self, name)
            value = np.zeros(n) if given is None else given
            value = frozen_array(value, np.bool_, (n,), name, MetrologyError)
            object.__setattr__(self, name, value)


@dataclass(frozen=True, eq=False)
class Measurement:
    """Where the robots are, by an image.

    Args:
        plane: the focal plane.
        verdict: Verdict on each robot, shape (n,).
        places: measured places [mm], shape (n, 2), nan where no light is told to be of the robot.
        angles: joint angles [rad], shape (n, 2): measured, or else as expected.
        interval_rad: half the width of the interval of each joint [rad], shape (n, 2).
        error_mm: bound of the error of each place [mm], shape (n,), nan without a place.
        off_mm: distance of each place from where the counters say [mm], shape (n,), nan without a
            place.
        doubt: probability that the light is of another robot or a stray one, shape (n,).
        group: robots with the same number share lights, -1 for none, shape (n,).
        light: row of the light of each robot in `lights`, -1 for none, shape (n,).
        lights: the lights of the exposures.
    """

    plane: FocalPlane
    verdict: Codes
    places: Points
    angles: Angles
    interval_rad: Angles
    error_mm: Floats
    off_mm: Floats
    doubt: Floats
    group: Ints
    light: Ints
    lights: Lights

    @property
    def certain(self) -> Mask:
        """Robots whose place is told as a fact, shape (n,)."""
        return np.all(np.isfinite(self.places), axis=1)

    @property
    def not_moved(self) -> Mask:
        """Robots of which a joint did not turn, shape (n,)."""
        return np.isin(self.verdict, STILL)

    def reasons(self) -> list[str]:
        """Return a line for each robot that is not simply measured, with what is known."""
        lines = []
        for row in np.flatnonzero(self.verdict != Verdict.MEASURED):
            robot, group = self.plane.ids[row], self.group[row]
            others = self.plane.ids[(self.group == group) & (group >= 0)]
            text = reason_text(
                self.verdict[row], self.off_mm[row], self.doubt[row], others[others != robot]
            )
            lines.append(f"robot {robot}: {text}")
        return lines


def measure(
    expected: Expected,
    exposures: Sequence[Spots],
    fiducials: ArrayLike,
    calibrated: Callable[[ArrayLike], Floats],
    config: MeasureConfig | None = None,
) -> Measurement:
    """Find every fibre in some exposures, and the joint angles of its robot.

    Args:
        expected: what is known of the robots before the image.
        exposures: spots of one or more exposures between which nothing moved.
        fiducials: places of the fiducials [mm], shape (k, 2).
        calibrated: map from pixels to mm, of an earlier image or the laboratory.
        config: errors of camera and air.

    Raises:
        ImageError: an exposure cannot be used; nothing is learned from it.
    """
    config = config or MeasureConfig()
    plane = expected.plane
    lights = combine(exposures, fiducials, calibrated, config.plate)
    places, sigma, chance = _hypotheses(expected, config)
    found = identify(
        places, sigma, chance, lights.places, lights.seen, lights.exposures, config.identify
    )
    has = found.light >= 0
    certain = has & (found.doubt <= config.identify.certain)
    unplaced = np.asarray(expected.unplaced)
    seen_lights = len(lights.places)
    least = min(seen_lights, plane.n) - np.count_nonzero(unplaced)
    if seen_lights >= plane.n / 2 and certain.sum() < config.found * least:
        raise ImageError(
            f"{certain.sum()} robots are at {seen_lights} lights: the image is of another plane, "
            "turned, or the robots are not near where their counters say"
        )
    merged = np.zeros(plane.n, dtype=bool)
    merged[has] = lights.merged[found.light[has]]
    sure = certain & ~merged
    measured = np.full((plane.n, 2), np.nan)
    measured[sure] = lights.places[found.light[sure]]
    where = np.where(found.first_place <= config.blame, np.maximum(found.where, 0), 0)
    where = np.where(_judged(expected, places, config)[np.arange(plane.n), where], where, 0)
    # the likeliest place tells elbow and turn, also where it gives no verdict
    near = _angles_there(expected, np.where(found.first_place < 0.5, np.maximum(found.where, 0), 0))
    seen = np.ones(plane.n)
    seen[has] = lights.seen[found.light[has]]
    error_mm = np.where(sure, config.error_um * 1e-3 / np.sqrt(seen), np.nan)
    bound_mm = config.sigmas * error_mm
    angles, interval, _ = angles_of_places(plane, measured, near, bound_mm)
    verdict = np.where(sure, _THERE[where], Verdict.MISSING)
    off = np.hypot(*(measured - places[:, 0]).T)
    far = off > config.off_model * sigma[:, 0]
    verdict = np.where(sure & far & (where == 0), Verdict.OFF_MODEL, verdict)
    keeps = np.where(sure & (verdict != Verdict.OFF_MODEL), where, -1)
    angles, interval, bound_mm = _by_drive(
        expected, measured, angles, interval, bound_mm, keeps, config
    )
    verdict = np.where(has & ~certain, Verdict.AMBIGUOUS, verdict)
    # a joint is named with the doubt of blame, its place is told as a fact with less alone
    stuck = has & ~certain & (found.doubt <= config.blame) & (where > 0) & ~merged
    verdict = np.where(stuck, _THERE[where], verdict)
    verdict = np.where(certain & merged, Verdict.MERGED, verdict)
    verdict = np.where(~has & (found.doubt > config.identify.certain) & (found.group >= 0),
                       Verdict.AMBIGUOUS, verdict)  # fmt: skip
    # a light that is not where any robot should be: a joint may have slipped, so none is dark there
    free = beside_free_lights(plane, lights, found.light[has])
    verdict = np.where((verdict == Verdict.MISSING) & free, Verdict.UNEXPLAINED, verdict)
    verdict = np.where((verdict == Verdict.MISSING) & expected.dark, Verdict.DARK, verdict)
    verdict = np.where(unplaced, Verdict.UNPLACED, verdict)
    unknown = ~sure
    # by the counters where no light tells more
    angles[unknown] = _angles_there(expected, where)[unknown]
    interval[unknown] = _unseen(expected, config)[unknown]
    return Measurement(
        plane, verdict, measured, angles, interval, bound_mm, off,
        found.doubt, found.group, found.light, lights,
    )  # fmt: skip


def _by_drive(
    expected: Expected,
    measured: Points,
    angles: Angles,
    interval: Angles,
    bound_mm: Floats,
    where: Ints,
    config: MeasureConfig,
) -> tuple[Angles, Angles, Floats]:
    """Angles, intervals and bounds, by the drive where that tells more than the place.

    The place says nothing of theta where an arm is folded, and little of either joint where it is
    folded or stretched. Then a joint is about its counter, or about where it was before, as the
    hypothesis `where` says and every other one with which the fibre would be there too; -1 for a
    robot that keeps to none. The angles are those that place and drive together make likeliest.
    """
    plane, n = expected.plane, expected.plane.n
    drive_mm = config.drive_sigmas * np.asarray(expected.error_um) * 1e-3
    drive_rad = interval_of_tips(plane, drive_mm)
    if expected.joints_rad is not None:
        drive_rad = config.drive_sigmas * np.asarray(expected.joints_rad)
    known_mm = (expected.before_rad * levers_of(plane)).sum(axis=1)
    within_mm = bound_mm + math.sqrt(2.0) * drive_mm + known_mm
    low, high = np.full((n, 2), np.inf), np.full((n, 2), -np.inf)
    for number in range(len(_THERE)):
        there = _angles_there(expected, np.full(n, number))
        half = np.where(_still(np.full(n, number)), expected.before_rad, drive_rad)
        off_mm = np.hypot(*(measured - kinematics.forward(plane, there)[1]).T)
        may_be = ((off_mm <= within_mm) | (where == number))[:, None]
        low = np.where(may_be, np.minimum(low, there - half), low)
        high = np.where(may_be, np.maximum(high, there + half), high)
    # a robot off its model may be at none of its places
    low, high = (np.where(np.isfinite(end), end, angles) for end in (low, high))
    half, middle = (high - low) / 2.0, (high + low) / 2.0
    better = (where >= 0)[:, None] & (interval > _DOUBTFUL * half)
    rows, inside = np.flatnonzero(better.any(axis=1)), np.array(angles)
    inside[rows] = likeliest_angles(
        plane, rows, measured[rows], bound_mm[rows] / config.sigmas, middle[rows],
        half[rows] / config.drive_sigmas,
    )  # fmt: skip
    # a place that pulls a joint away from its counter says that the drive erred that way
    pulled = np.where(interval < math.pi, 2.0, 1.0)
    by_drive = half + pulled * np.abs(inside - middle)
    interval = np.where(better, by_drive, interval + np.abs(inside - angles))
    moved_mm = np.hypot(*(kinematics.forward(plane, inside)[1] - measured).T)
    return inside, interval, np.where(better.any(axis=1), bound_mm + moved_mm, bound_mm)


def _still(where: Ints) -> NDArray[np.bool_]:
    """Which joints did not turn by the hypothesis of each robot, shape (n, 2)."""
    return np.stack([np.isin(where, (1, 2)), np.isin(where, (1, 3))], axis=1)


def _angles_there(expected: Expected, where: Ints) -> Angles:
    """The joint angles of the hypothesis of each robot, shape (n, 2)."""
    return np.where(_still(where), expected.before, expected.counters)


def _hypotheses(expected: Expected, config: MeasureConfig) -> tuple[Floats, Floats, Floats]:
    """Where each fibre may be: as counted, not moved, theta not moved, phi not moved.

    Returns:
        Places [mm], shape (n, 4, 2), their errors [mm] and chances, shape (n, 4).
    """
    plane, n = expected.plane, expected.plane.n
    error_mm = config.error_um * 1e-3
    moved_mm = np.broadcast_to(np.asarray(expected.error_um), (n,)) * 1e-3
    places, sigma = np.full((n, 4, 2), np.nan), np.ones((n, 4))
    for k in range(4):
        places[:, k] = kinematics.forward(plane, _angles_there(expected, np.full(n, k)))[1]
        sigma[:, k] = np.hypot(moved_mm, error_mm)
    # where it was is known as well as it was measured then
    known_mm = expected.before_rad * levers_of(plane) / config.sigmas
    known_mm = np.minimum(known_mm, moved_mm[:, None])
    whole_mm = np.minimum(known_mm.sum(axis=1), moved_mm)
    sigma[:, 1] = np.hypot(whole_mm, error_mm)
    if expected.joints_rad is not None:  # a joint that stuck has the error of its place before
        joints = np.asarray(expected.joints_rad)
        by_phi = joints[:, 1] * plane.arms[:, 1]
        by_theta = joints[:, 0] * np.hypot(*(places[:, 3] - plane.centers).T)
        sigma[:, 2] = np.sqrt(by_phi**2 + known_mm[:, 0] ** 2 + error_mm**2)
        sigma[:, 3] = np.sqrt(by_theta**2 + known_mm[:, 1] ** 2 + error_mm**2)
    chance = np.empty((n, 4))
    chance[:, 1:] = config.identify.unmoved * np.array([0.5, 0.25, 0.25])
    asked = _turned(expected)
    asked &= ~np.asarray(expected.unplaced)[:, None]
    places[~asked] = np.nan
    chance[~asked] = 0.0
    chance[:, 0] = 1.0 - config.identify.none - chance[:, 1:].sum(axis=1)
    return places, sigma, chance


def _turned(expected: Expected) -> Mask:
    """Which of the places of each robot are places of its own, shape (n, 4)."""
    turned = np.abs(expected.counters - expected.before) > FIXED_JOINT_RAD
    # if one joint alone was to turn, nothing moved is one of the other two
    return np.stack([np.ones(len(turned), dtype=bool), turned.all(axis=1), *turned.T], axis=1)


def _judged(expected: Expected, places: Floats, config: MeasureConfig) -> Mask:
    """At which of its places each robot is told to have a joint that did not turn, shape (n, 4)."""
    away = np.hypot(*np.moveaxis(places - places[:, :1], -1, 0))
    return away > config.judged_mm(expected.error_um)[:, None]


def _unseen(expected: Expected, config: MeasureConfig) -> Angles:
    """Intervals of robots that no light shows: the error of the drive at the end of each arm."""
    error_mm = config.sigmas * np.asarray(expected.error_um) * 1e-3 * math.sqrt(2.0)
    return error_mm[:, None] / expected.plane.arms
