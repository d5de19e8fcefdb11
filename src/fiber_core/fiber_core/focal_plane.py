# SPDX-License-Identifier: Apache-2.0
"""The focal plane: its robots, where they stand, how they are built, and the fixed obstacles."""

from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fiber_core import bounds
from fiber_core.array_types import Angles, Floats, Ids, Ints, Mask, Points, Rows, Velocities
from fiber_core.coupling import checked_coupling, checked_motor_limits, checked_motor_speeds
from fiber_core.drive.drive import Drive
from fiber_core.errors import LayoutError
from fiber_core.fibres import checked_choice, checked_fibres, checked_names
from fiber_core.validation import frozen_array
from fiber_core.walls import checked_walls

__all__ = ["FIXED_JOINT_RAD", "FocalPlane", "addresses_on"]

FIXED_JOINT_RAD = 1e-5  # a joint with a narrower range is fixed: it never moves
_ROBOTS_PER_BUS = 500  # ten controllers for 5000 robots: Kaci et al. (SPIE 9912, 2016)
# fields that are not rows of robots, and the ids, which are numbered again in a part of a plane
_OF_THE_PLANE = (
    "ids", "obstacles", "walls", "spacing_mm", "envelope_mm", "name", "fibre_names", "drive"
)  # fmt: skip


@dataclass(frozen=True, eq=False, init=False)
class FocalPlane:
    """All positioners of a focal plane as arrays, one row per robot, and the fixed obstacles.

    Each robot has two links. The first turns with theta about the centre, the
    second with theta + phi about the elbow. The *outline* of a link is the convex
    hull of its vertices grown by a rounding radius, in the frame of the link: x
    along the arm, origin at the centre (theta link) or at the elbow (phi link).
    A capsule is two vertices and a radius. A theta link with no vertices has no
    outline: it passes below all phi links. A joint with a range of 1e-5 rad or less is *fixed*:
    it never moves, and the robot moves with its other joint.

    The bounds of all values are in ``fiber_core.bounds``.

    Args:
        ids: robot ids, strictly increasing, shape (n,).
        centers: theta axes in the focal plane [mm], shape (n, 2).
        arms: lengths of both arms l1, l2 [mm], positive, shape (n, 2).
        limits: joint ranges [rad], shape (n, 2, 2): robot, joint (theta, phi), (low, high).
            Theta is measured in the frame of the focal plane: the zero of each robot is
            already in its limits.
        speeds: highest joint speeds [rad/s], shape (n, 2).
        phi_vertices: phi outline vertices [mm], counter-clockwise, shape (n, k, 2), k >= 1.
        phi_radius: rounding radius of the phi outline [mm], shape (n,).
        theta_vertices: theta outline vertices [mm], counter-clockwise, shape (n, m, 2), m >= 0.
        theta_radius: rounding radius of the theta outline [mm], shape (n,).
        enabled: whether a robot may be moved, shape (n,).
        obstacles: fixed discs x, y, radius [mm], shape (k, 3); by default none.
        bus: number of the bus of each robot, shape (n,); by default 500 robots a bus, in order.
        address: address on that bus, unique there, shape (n,); by default 1, 2, ...
        spacing_mm: least distance between two targets that are accepted [mm]; 0 for any.
        envelope_mm: D of the papers, the distance of tips from which the navigation function
            keeps them apart, and which random targets keep [mm]; by default the spacing.
        name: preset or file from which this plane was made.
        walls: fixed convex polygons, as petal edges and cameras: corners in order [mm], shape
            (w, c, 2), a shorter polygon repeats its last corner; two corners are a line.
        fibres: places of the fibres in the frame of the phi link [mm], shape (n, f, 2); by default
            f = 0: one fibre at the tip, on the axis of the arm.
        fibre_names: a name for each of the f fibres; by default their numbers.
        fibre: number of the fibre that the target of each robot is for, -1 where any of them may
            be on the target, shape (n,); by default -1.
        drive: how the motors carry out orders, of n robots; by default ideally.
        coupling: angles of the two motors by angles of the two joints, as gears couple them,
            shape (n, k, 2); by default k = 0: each joint has a motor of its own.
        motor_speeds: highest speeds of coupled motors [rad/s], shape (n, k); by default what the
            joint speeds allow. The joint speeds hold as well.
        motor_limits: ranges of coupled motors [rad], shape (n, k, 2); by default what the joint
            ranges allow. The joint ranges hold as well.
        sector: number of the part of the plane, with a host of its own, to which each robot
            belongs, shape (n,); by default one sector, 0.

    Raises:
        LayoutError: a shape does not fit or a value is out of range; names the robot.
    """

    ids: Ids
    centers: Points
    arms: Floats
    limits: Floats
    speeds: Velocities
    phi_vertices: Floats
    phi_radius: Floats
    theta_vertices: Floats
    theta_radius: Floats
    enabled: Mask
    obstacles: Floats
    bus: Ints
    address: Ints
    spacing_mm: float
    envelope_mm: float
    name: str
    walls: Floats
    fibres: Floats
    fibre_names: tuple[str, ...]
    fibre: Ints
    drive: Drive
    coupling: Floats
    motor_speeds: Floats
    motor_limits: Floats
    sector: Ints

    def __init__(
        self,
        ids: ArrayLike,
        centers: ArrayLike,
        arms: ArrayLike,
        limits: ArrayLike,
        speeds: ArrayLike,
        phi_vertices: ArrayLike,
        phi_radius: ArrayLike,
        theta_vertices: ArrayLike,
        theta_radius: ArrayLike,
        enabled: ArrayLike,
        obstacles: ArrayLike | None = None,
        bus: ArrayLike | None = None,
        address: ArrayLike | None = None,
        spacing_mm: float = 0.0,
        envelope_mm: float | None = None,
        name: str = "",
        walls: ArrayLike | None = None,
        fibres: ArrayLike | None = None,
        fibre_names: tuple[str, ...] | None = None,
        fibre: ArrayLike | None = None,
        drive: Drive | None = None,
        coupling: ArrayLike | None = None,
        motor_speeds: ArrayLike | None = None,
        motor_limits: ArrayLike | None = None,
        sector: ArrayLike | None = None,
    ):
        n = np.size(ids)
        bounds.check_number(n, "number of robots", 0, bounds.MAX_ROBOTS, LayoutError)
        bus = np.arange(n) // _ROBOTS_PER_BUS if bus is None else bus
        address = addresses_on(bus) if address is None else address
        obstacles = np.zeros((0, 3)) if obstacles is None else obstacles
        sector = np.zeros(n, dtype=np.int64) if sector is None else sector
        for field, value in (("ids", ids), ("bus", bus), ("address", address), ("sector", sector)):
            self._set(field, frozen_array(value, np.int64, (n,), field, LayoutError))
        for field, value, shape in (
            ("centers", centers, (n, 2)),
            ("arms", arms, (n, 2)),
            ("limits", limits, (n, 2, 2)),
            ("speeds", speeds, (n, 2)),
            ("phi_vertices", phi_vertices, (n, None, 2)),
            ("phi_radius", phi_radius, (n,)),
            ("theta_vertices", theta_vertices, (n, None, 2)),
            ("theta_radius", theta_radius, (n,)),
            ("obstacles", obstacles, (None, 3)),
        ):
            self._set(field, frozen_array(value, np.float64, shape, field, LayoutError))
        self._set("walls", checked_walls(np.zeros((0, 1, 2)) if walls is None else walls))
        self._set(
            "fibres", checked_fibres(np.zeros((n, 0, 2)) if fibres is None else fibres, self.ids)
        )
        self._set("fibre_names", checked_names(fibre_names, self.fibres.shape[1]))
        self._set("fibre", checked_choice(fibre, max(1, self.fibres.shape[1]), self.ids))
        self._set("enabled", frozen_array(enabled, np.bool_, (n,), "enabled", LayoutError))
        self._set("spacing_mm", spacing_mm)
        self._set("envelope_mm", spacing_mm if envelope_mm is None else envelope_mm)
        self._set("name", name)
        self._set("drive", Drive(n) if drive is None else drive)
        if self.drive.n != n:
            raise LayoutError(f"the drive is of {self.drive.n} robots, the plane has {n}")
        self._check_ids()
        self._check_values()
        self._check_addresses()
        gears = checked_coupling(coupling, self.ids)
        turns = checked_motor_limits(motor_limits, gears, self.limits, self.ids)
        self._set("coupling", gears)
        self._set("motor_speeds", checked_motor_speeds(motor_speeds, gears, self.speeds, self.ids))
        self._set("motor_limits", turns)

    def _set(self, field: str, value: NDArray[Any] | float | str | tuple[str, ...] | Drive) -> None:
        object.__setattr__(self, field, value)  # the class is frozen

    def _check_ids(self) -> None:
        rises = np.diff(self.ids) > 0
        if not rises.all():
            at = int(np.argmin(rises))
            raise LayoutError(f"robot ids must increase: {self.ids[at + 1]} follows {self.ids[at]}")
        numbers = {"id": self.ids, "bus": self.bus, "address": self.address, "sector": self.sector}
        for name, value in numbers.items():
            bad = (value < 0) | (value > bounds.MAX_NUMBER)
            self._refuse(bad, name, value, f"must be 0 to {bounds.MAX_NUMBER}")

    def _check_values(self) -> None:
        if self.phi_vertices.shape[1] == 0:
            raise LayoutError("the phi outline needs at least one vertex")
        lengths = (0.0, bounds.MAX_LENGTH_MM)
        for name, value, low, high, unit in (
            ("centers", self.centers, -bounds.MAX_COORDINATE_MM, bounds.MAX_COORDINATE_MM, "mm"),
            ("arms", self.arms, bounds.MIN_LENGTH_MM, bounds.MAX_LENGTH_MM, "mm"),
            ("limits", self.limits, -bounds.MAX_LIMIT_RAD, bounds.MAX_LIMIT_RAD, "rad"),
            ("speeds", self.speeds, bounds.MIN_SPEED_RAD_S, bounds.MAX_SPEED_RAD_S, "rad/s"),
            ("phi_radius", self.phi_radius, *lengths, "mm"),
            ("theta_radius", self.theta_radius, *lengths, "mm"),
            ("phi_vertices", self.phi_vertices, -lengths[1], lengths[1], "mm"),
            ("theta_vertices", self.theta_vertices, -lengths[1], lengths[1], "mm"),
        ):
            outside = ~((value >= low) & (value <= high))  # nan is outside
            self._refuse(outside, name, value, f"must be {low:.6g} to {high:.6g} {unit}")
        low, high = np.moveaxis(self.limits, -1, 0)
        self._refuse(low > high, "limits", self.limits, "must not be empty")
        most = [bounds.MAX_COORDINATE_MM, bounds.MAX_COORDINATE_MM, bounds.MAX_LENGTH_MM]
        bad = ~(np.abs(self.obstacles) <= most).all(axis=1) | (self.obstacles[:, 2] < 0)
        if bad.any():
            at = int(np.argmax(bad))
            raise LayoutError(
                f"obstacle {at}: x, y must be {-most[0]:.6g} to {most[0]:.6g} mm and the radius "
                f"0 to {most[2]:.6g} mm, got {self.obstacles[at].tolist()}"
            )
        bounds.check_number(self.spacing_mm, "the spacing of targets [mm]", *lengths, LayoutError)
        bounds.check_number(self.envelope_mm, "the envelope, D [mm]", *lengths, LayoutError)

    def _refuse(self, bad: NDArray[np.bool_], name: str, value: NDArray[Any], rule: str) -> None:
        # bad: elements that break the rule, the first axis being that of the robots
        rows = np.flatnonzero(bad.reshape(self.n, bad.size // max(self.n, 1)).any(axis=1))
        if len(rows):
            at = rows[0]
            raise LayoutError(f"robot {self.ids[at]}: {name} {rule}, got {value[at].tolist()}")

    def _check_addresses(self) -> None:
        order = np.lexsort([self.address, self.bus])
        same = (np.diff(self.bus[order]) == 0) & (np.diff(self.address[order]) == 0)
        if same.any():
            first, second = order[int(np.argmax(same)) :][:2]
            raise LayoutError(
                f"robots {self.ids[first]} and {self.ids[second]} share address "
                f"{self.address[first]} of bus {self.bus[first]}"
            )

    @property
    def n(self) -> int:
        """Number of robots."""
        return len(self.ids)

    @property
    def fixtures(self) -> int:
        """Number of fixed bodies: first the obstacles, then the walls."""
        return len(self.obstacles) + len(self.walls)

    def name_of(self, body: int) -> str:
        """Return what a row of bodies is: robot and id, or obstacle or wall and its number."""
        if body < self.n:
            return f"robot {self.ids[body]}"
        number = body - self.n
        discs = len(self.obstacles)
        return f"obstacle {number}" if number < discs else f"wall {number - discs}"

    @cached_property
    def reach_mm(self) -> Floats:
        """Radius of the disc about the centre that no part of a robot ever leaves [mm], (n,)."""
        phi = np.hypot(*np.moveaxis(self.phi_vertices, -1, 0)).max(axis=1) + self.phi_radius
        reach = self.arms[:, 0] + phi
        if self.theta_vertices.shape[1]:
            theta = np.hypot(*np.moveaxis(self.theta_vertices, -1, 0)).max(axis=1)
            reach = np.maximum(reach, theta + self.theta_radius)
        reach = reach + self.growth_mm.max(axis=1)
        reach.setflags(write=False)
        return reach

    @cached_property
    def fibre_offsets(self) -> Floats:
        """Places of all fibres in the frame of the phi link [mm], shape (n, f, 2), f >= 1."""
        if self.fibres.shape[1]:
            return self.fibres
        tips = np.stack([self.arms[:, 1], np.zeros(self.n)], axis=1)[:, None]
        tips.setflags(write=False)
        return tips

    @property
    def supply(self) -> Ints:
        """Number of the power supply of each robot, that of its bus if none is known, (n,)."""
        return self.bus if self.drive.supply is None else self.drive.supply

    @cached_property
    def growth_mm(self) -> Floats:
        """How far uncertain joints can displace the outlines of theta and phi link [mm], (n, 2).

        A link that turns by an angle displaces none of its vertices by more than the angle times
        its reach, and the rounding as much as the vertices.
        """
        theta, phi = self.drive.interval_rad.T
        phi_reach = np.hypot(*np.moveaxis(self.phi_vertices, -1, 0)).max(axis=1)
        growth = np.zeros((self.n, 2))
        growth[:, 1] = theta * (self.arms[:, 0] + phi_reach) + phi * phi_reach
        if self.theta_vertices.shape[1]:
            reach = np.hypot(*np.moveaxis(self.theta_vertices, -1, 0)).max(axis=1)
            growth[:, 0] = theta * reach
        growth.setflags(write=False)
        return growth

    def index_of(self, ids: ArrayLike) -> Rows:
        """Return the row of each id, -1 where the plane has no such robot; shape as ids."""
        ids = np.asarray(ids, dtype=np.int64)
        if self.n == 0:
            return np.full(ids.shape, -1)
        rows = np.clip(np.searchsorted(self.ids, ids), 0, self.n - 1)
        return np.where(self.ids[rows] == ids, rows, -1)

    def with_enabled(self, enabled: ArrayLike) -> "FocalPlane":
        """Return the same plane with another set of enabled robots, shape (n,)."""
        return replace(self, enabled=enabled)

    def with_fibre(self, fibre: ArrayLike | None) -> "FocalPlane":
        """Return the same plane with another choice of fibres; itself if that changes nothing.

        Args:
            fibre: number of the fibre that each target is for, -1 for any, shape (n,); None for
                any.

        Raises:
            LayoutError: a robot has no such fibre; names it.
        """
        chosen = checked_choice(fibre, max(1, self.fibres.shape[1]), self.ids)
        return self if np.array_equal(chosen, self.fibre) else replace(self, fibre=chosen)

    def with_fixed_joints_at(self, start: Angles) -> "FocalPlane":
        """Return the same plane with the limits of each fixed joint at its present angle.

        An encoder reads a fixed joint up to half a quantum from its limits; planned between
        such limits, it does not move. A fixed joint that stands elsewhere keeps its limits.

        Args:
            start: present joint angles [rad], shape (n, 2).
        """
        low, high = np.moveaxis(self.limits, -1, 0)
        near = (start >= low - FIXED_JOINT_RAD) & (start <= high + FIXED_JOINT_RAD)
        fixed = near & (high - low <= FIXED_JOINT_RAD)
        if not fixed.any():
            return self
        here = np.repeat(np.asarray(start)[:, :, None], 2, axis=2)
        return replace(self, limits=np.where(fixed[:, :, None], here, self.limits))

    def permuted(self, order: ArrayLike) -> "FocalPlane":
        """Return some robots as a plane, with ids 0, 1, ...

        Args:
            order: rows of the robots, in the order of the new plane, shape (m,).
        """
        order = np.asarray(order, dtype=np.int64)
        rows = {
            field.name: getattr(self, field.name)[order]
            for field in fields(self)
            if field.name not in _OF_THE_PLANE
        }
        return replace(self, ids=np.arange(len(order)), drive=self.drive.of_robots(order), **rows)


def addresses_on(bus: ArrayLike) -> Ints:
    """Return addresses that number the robots of every bus from 1, in the order of their rows.

    Args:
        bus: number of the bus of each robot, shape (n,).

    Returns:
        Address of each robot, shape (n,).
    """
    bus = np.asarray(bus)
    order = np.argsort(bus, kind="stable")
    first = np.searchsorted(bus[order], bus[order], side="left")
    address = np.empty(len(bus), dtype=np.int64)
    address[order] = 1 + np.arange(len(bus)) - first
    return address
