"""What a focal plane is: the robots, where they stand, how they are built."""

from dataclasses import dataclass, field, fields, replace
from functools import cached_property

import numpy as np

from fiber_core.errors import LayoutError
from fiber_core.validation import frozen_array

__all__ = ["FocalPlane", "addresses_on"]

_ROBOTS_PER_BUS = 500  # ten controllers for 5000 robots: Kaci et al. (SPIE 9912, 2016)


@dataclass(frozen=True, eq=False)
class FocalPlane:
    """All positioners of a focal plane as arrays, one row per robot, and the fixed obstacles.

    Each robot has two links. The first turns with theta about the centre, the
    second with theta + phi about the elbow. The *outline* of a link is the convex
    hull of its vertices grown by a rounding radius, in the frame of the link: x
    along the arm, origin at the centre (theta link) or at the elbow (phi link).
    A capsule is two vertices and a radius. A theta link with no vertices has no
    outline: it passes below everything.

    Args:
        ids: robot ids, strictly increasing, shape (n,).
        centers: theta axes in the focal plane [mm], shape (n, 2).
        arms: lengths of both arms l1, l2 [mm], positive, shape (n, 2).
        limits: joint ranges [rad], shape (n, 2, 2): robot, joint (theta, phi), (low, high).
            Theta is measured in the focal plane frame: a robot's own zero is
            already in its limits.
        speeds: highest joint speeds [rad/s], shape (n, 2).
        phi_vertices: phi outline vertices [mm], counter-clockwise, shape (n, k, 2), k >= 1.
        phi_radius: rounding radius of the phi outline [mm], shape (n,).
        theta_vertices: theta outline vertices [mm], counter-clockwise, shape (n, m, 2), m >= 0.
        theta_radius: rounding radius of the theta outline [mm], shape (n,).
        enabled: whether a robot may be moved, shape (n,).
        obstacles: fixed discs x, y, radius [mm], shape (k, 3).
        bus: bus each robot hangs on, shape (n,); by default 500 robots a bus, in order.
        address: its address there, unique on the bus, shape (n,); by default 1, 2, ...
        spacing_mm: least distance between two targets, D of the papers [mm].
        name: preset or file this plane came from.

    Raises:
        LayoutError: a shape does not fit or a value is out of range; names the robot.
    """

    ids: np.ndarray
    centers: np.ndarray
    arms: np.ndarray
    limits: np.ndarray
    speeds: np.ndarray
    phi_vertices: np.ndarray
    phi_radius: np.ndarray
    theta_vertices: np.ndarray
    theta_radius: np.ndarray
    enabled: np.ndarray
    obstacles: np.ndarray = field(default_factory=lambda: np.zeros((0, 3)))
    bus: np.ndarray | None = None
    address: np.ndarray | None = None
    spacing_mm: float = 0.0
    name: str = ""

    def __post_init__(self):
        n = np.size(self.ids)
        columns = {
            "ids": ((n,), np.int64),
            "centers": ((n, 2), float),
            "arms": ((n, 2), float),
            "limits": ((n, 2, 2), float),
            "speeds": ((n, 2), float),
            "phi_vertices": ((n, None, 2), float),
            "phi_radius": ((n,), float),
            "theta_vertices": ((n, None, 2), float),
            "theta_radius": ((n,), float),
            "enabled": ((n,), bool),
            "obstacles": ((None, 3), float),
            "bus": ((n,), np.int64),
            "address": ((n,), np.int64),
        }
        if self.bus is None:
            object.__setattr__(self, "bus", np.arange(n) // _ROBOTS_PER_BUS)
        if self.address is None:
            object.__setattr__(self, "address", addresses_on(self.bus))
        for name, (shape, dtype) in columns.items():
            value = frozen_array(getattr(self, name), dtype, shape, name, LayoutError)
            object.__setattr__(self, name, value)
        self._check()

    def _check(self):
        if self.n and not np.all(np.diff(self.ids) > 0):
            at = int(np.argmin(np.diff(self.ids) > 0))
            raise LayoutError(f"robot ids must increase: {self.ids[at + 1]} follows {self.ids[at]}")
        if self.phi_vertices.shape[1] == 0:
            raise LayoutError("the phi outline needs at least one vertex")
        for name, bad in {
            "centers": ~np.isfinite(self.centers),
            "arms": ~(np.isfinite(self.arms) & (self.arms > 0)),
            "limits": ~np.isfinite(self.limits),
            "speeds": ~(np.isfinite(self.speeds) & (self.speeds > 0)),
            "phi_radius": ~(np.isfinite(self.phi_radius) & (self.phi_radius >= 0)),
            "theta_radius": ~(np.isfinite(self.theta_radius) & (self.theta_radius >= 0)),
            "phi_vertices": ~np.isfinite(self.phi_vertices),
            "theta_vertices": ~np.isfinite(self.theta_vertices),
        }.items():
            rows = bad.any(axis=tuple(range(1, bad.ndim)))
            if rows.any():
                at = int(np.argmax(rows))
                value = getattr(self, name)[at].tolist()
                raise LayoutError(f"robot {self.ids[at]}: {name} is {value}")
        upside_down = (self.limits[:, :, 0] > self.limits[:, :, 1]).any(axis=1)
        if upside_down.any():
            at = int(np.argmax(upside_down))
            raise LayoutError(f"robot {self.ids[at]}: limits {self.limits[at].tolist()} are empty")
        if not np.all(np.isfinite(self.obstacles)) or np.any(self.obstacles[:, 2] < 0):
            raise LayoutError("an obstacle's x, y or radius is not a length")
        if not (np.isfinite(self.spacing_mm) and self.spacing_mm >= 0):
            raise LayoutError(f"the spacing of targets is {self.spacing_mm} mm")
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

    @cached_property
    def reach_mm(self) -> np.ndarray:
        """Radius of the disc about the centre that no part of a robot ever leaves [mm], (n,)."""
        phi = np.hypot(*np.moveaxis(self.phi_vertices, -1, 0)).max(axis=1) + self.phi_radius
        reach = self.arms[:, 0] + phi
        if self.theta_vertices.shape[1]:
            theta = np.hypot(*np.moveaxis(self.theta_vertices, -1, 0)).max(axis=1)
            reach = np.maximum(reach, theta + self.theta_radius)
        reach.setflags(write=False)
        return reach

    def index_of(self, ids) -> np.ndarray:
        """Return the row of each id, -1 where the plane has no such robot; shape as ids."""
        ids = np.asarray(ids, dtype=np.int64)
        if self.n == 0:
            return np.full(ids.shape, -1)
        rows = np.clip(np.searchsorted(self.ids, ids), 0, self.n - 1)
        return np.where(self.ids[rows] == ids, rows, -1)

    def with_enabled(self, enabled) -> "FocalPlane":
        """Return the same plane with another set of enabled robots, shape (n,)."""
        return replace(self, enabled=enabled)

    def permuted(self, order) -> "FocalPlane":
        """Return the robots `order` (row indices, shape (m,)) as a plane, renumbered 0..m-1."""
        rows = {
            f.name: getattr(self, f.name)[order]
            for f in fields(self)
            if f.name not in ("ids", "obstacles", "spacing_mm", "name")
        }
        return replace(self, ids=np.arange(len(order)), **rows)


def addresses_on(bus) -> np.ndarray:
    """Number the robots of every bus from 1 in order, given the bus of each; both shape (n,)."""
    bus = np.asarray(bus)
    order = np.argsort(bus, kind="stable")
    first = np.searchsorted(bus[order], bus[order], side="left")
    address = np.empty(len(bus), dtype=np.int64)
    address[order] = 1 + np.arange(len(bus)) - first
    return address
