# SPDX-License-Identifier: Apache-2.0
"""What is known of the robots between two images, from which the next one is expected."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike

from fiber_core import bounds, kinematics
from fiber_core.arm_bounds import arms_within, interval_of_tips
from fiber_core.array_types import Angles, Floats, Mask
from fiber_core.focal_plane import FocalPlane
from fiber_core.outcomes import Verdict
from fiber_metrology.correction import follows
from fiber_metrology.errors import MetrologyError
from fiber_metrology.measure import Expected, Measurement

__all__ = ["DriveErrors", "Knowledge"]

_MOVED_RAD = 1e-5  # between two readings of a counter; some quanta


@dataclass(frozen=True)
class DriveErrors:
    """How far fibres end from where their counters say.

    Args:
        blind_um: error of one coordinate of a fibre after a blind move, 1 sigma, of all moves
            together [um].
        corrected_um: error of one coordinate of a fibre after a correction of a measured robot,
            1 sigma [um].
        sigmas: errors at which the interval of a robot ends that was moved and not seen since.
        base_um: the part of the error of a coordinate that the length of a move does not change,
            1 sigma [um].
        scale: error of the angle of a joint over the angle that it was to turn, 1 sigma.

    Raises:
        MetrologyError: a value is out of range; names it.
    """

    RANGES: ClassVar = {
        "blind_um": bounds.Range(1e-3, 1e5),
        "corrected_um": bounds.Range(1e-3, 1e5),
        "sigmas": bounds.Range(0.0, 10.0),
        "base_um": bounds.Range(1e-3, 1e5),
        "scale": bounds.Range(0.0, 1.0),
    }

    blind_um: float = 40.0
    corrected_um: float = 10.0
    sigmas: float = 2.0
    base_um: float = 20.0
    scale: float = 0.004

    def __post_init__(self) -> None:
        bounds.check_ranges(self, self.RANGES, MetrologyError)

    def interval_rad(self, plane: FocalPlane) -> Angles:
        """Return half the width of the interval of each joint after a blind move [rad], (n, 2)."""
        return interval_of_tips(plane, self.sigmas * self.blind_um * 1e-3)

    def after_um(self, plane: FocalPlane, before: ArrayLike, after: ArrayLike) -> Floats:
        """Return the error of a coordinate of each fibre after a blind move, 1 sigma [um], (n,).

        Args:
            plane: the focal plane.
            before, after: joint angles by the counters [rad], shape (n, 2).
        """
        joints_mm = self.joints_rad(plane, before, after) * _levers_at(plane, after)
        return 1e3 * np.hypot(*joints_mm.T)

    def joints_rad(self, plane: FocalPlane, before: ArrayLike, after: ArrayLike) -> Angles:
        """Return the error of each joint angle after a blind move, 1 sigma [rad], shape (n, 2).

        Args:
            plane, before, after: as for after_um.
        """
        turned = np.abs(np.asarray(after, dtype=float) - np.asarray(before, dtype=float))
        return np.hypot(_even_rad(plane, after, self.base_um), self.scale * turned)


def _levers_at(plane: FocalPlane, angles: ArrayLike) -> Floats:
    """How far each fibre is from its axes of theta and phi [mm], shape (n, 2)."""
    offsets = kinematics.forward(plane, np.asarray(angles, dtype=float))[1] - plane.centers
    return np.stack([np.hypot(*offsets.T), plane.arms[:, 1]], axis=1)


def _even_rad(plane: FocalPlane, angles: ArrayLike, error_um: ArrayLike) -> Angles:
    """The error of both joint angles that together makes one of the fibre [rad], shape (n, 2)."""
    even = 1e-3 * np.asarray(error_um) / np.hypot(*_levers_at(plane, angles).T)
    return np.stack([even, even], axis=1)


class Knowledge:
    """Keeps what images have told, over motions with and without an image after them.

    `begin` before each motion, `expected` and `learn` at each image.

    Args:
        plane: the focal plane.
        drive: errors of the drive.
        half_rad: half the width of the intervals of the joints before the first motion [rad],
            shape (n, 2); by default what a blind move leaves.
    """

    def __init__(
        self, plane: FocalPlane, drive: DriveErrors | None = None, half_rad: ArrayLike | None = None
    ):
        self.plane, self._drive = plane, drive or DriveErrors()
        blind_rad = 4.0 * self._drive.blind_um * 1e-3 * np.sqrt(2.0) / plane.arms
        self._blind_rad: Angles = blind_rad
        self._known: Angles = blind_rad if half_rad is None else np.array(half_rad, dtype=float)
        self._begin: Angles | None = None  # counters before the last motion
        self._straight = False
        self._before: Angles | None = None  # of each robot, before it moved last
        self._before_rad: Angles = self._known.copy()
        self._error_um: Floats = np.full(plane.n, self._drive.blind_um)
        self._joints_rad: Angles = self._error_um[:, None] * 1e-3 / plane.arms
        self._follows: Mask = np.zeros(plane.n, dtype=bool)
        # robots of which some image showed no light at all, and no image anything else
        self._missed: Mask = np.zeros(plane.n, dtype=bool)
        self._lit: Mask = np.zeros(plane.n, dtype=bool)

    def begin(self, angles: ArrayLike, straight: bool) -> None:
        """Note that a motion begins.

        Args:
            angles: joint angles by the counters before it [rad], shape (n, 2).
            straight: whether it is a correction.
        """
        angles = np.array(angles, dtype=float)
        if self._begin is not None:
            self._take_motion(angles)  # no image since the motion before
        self._begin, self._straight = angles, straight

    def _take_motion(self, counters: Angles) -> None:
        begin = counters if self._begin is None else self._begin
        moved = np.any(np.abs(counters - begin) > _MOVED_RAD, axis=1)
        before = begin if self._before is None else self._before
        self._before = np.where(moved[:, None], begin, before)
        self._before_rad = np.where(moved[:, None], self._known, self._before_rad)
        error = self._drive.after_um(self.plane, begin, counters)
        joints = self._drive.joints_rad(self.plane, begin, counters)
        if self._straight:
            error = np.where(self._follows, self._drive.corrected_um, error)
            even = _even_rad(self.plane, counters, error)
            joints = np.where(self._follows[:, None], even, joints)
        self._error_um = np.where(moved, error, self._error_um)
        self._joints_rad = np.where(moved[:, None], joints, self._joints_rad)
        # until the next image nothing better than the drive is known of what moved
        self._known = np.where(moved[:, None], self._blind_rad, self._known)
        self._follows &= ~moved
        self._begin = None

    def expected(self, counters: ArrayLike) -> Expected:
        """Return what an image is expected to show.

        Args:
            counters: joint angles by the counters now [rad], shape (n, 2).
        """
        counters = np.array(counters, dtype=float)
        if self._begin is not None or self._before is None:
            self._take_motion(counters)
        assert self._before is not None
        dark = self._missed & ~self._lit
        return Expected(
            self.plane, counters, self._before, self._before_rad, self._error_um, dark,
            joints_rad=self._joints_rad,
        )  # fmt: skip

    def outlines_off_mm(self, image: Measurement) -> Floats:
        """Return how far points of the outlines may be from where the angles put them.

        Of a robot that the image shows, as it was measured; of any other, as the drive leaves it,
        or as it was known if it has not moved since.

        Returns:
            Bounds for the theta and the phi outline [mm], shape (n, 2).
        """
        moved = interval_of_tips(self.plane, self._drive.sigmas * self._error_um * 1e-3)
        unseen = np.minimum(moved, self._known)
        half_rad = np.where(image.certain[:, None], image.interval_rad, unseen)
        return np.stack(arms_within(self.plane, half_rad, image.error_mm), axis=1)

    def learn(self, image: Measurement) -> None:
        """Take over what an image tells."""
        seen = image.certain[:, None]
        nothing = np.isin(image.verdict, (Verdict.MISSING, Verdict.DARK))
        self._missed |= nothing
        # a light that may be of the robot is light; an unknown place says nothing of the fibre
        self._lit |= ~nothing & ((image.verdict != Verdict.UNPLACED) | (image.light >= 0))
        self._follows = follows(image)
        self._known = np.where(seen, image.interval_rad, self._known)
        # where a robot is now is where it was before the next motion
        before = image.angles if self._before is None else self._before
        self._before = np.where(seen, image.angles, before)
        self._before_rad = np.where(seen, image.interval_rad, self._before_rad)
        self._error_um = np.where(image.certain, self._drive.corrected_um, self._error_um)
        even = _even_rad(self.plane, image.angles, self._error_um)
        self._joints_rad = np.where(seen, even, self._joints_rad)
