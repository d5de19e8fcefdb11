# SPDX-License-Identifier: Apache-2.0
"""A simulated camera as a node: it sees the true arms of the robots in a plant.

A real camera takes its place by the same topics: camera/spots or camera/image for each exposure,
and camera/calibration.
"""

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, TypeAlias

import numpy as np
from sensor_msgs.msg import PointCloud2
from std_srvs.srv import Trigger

from fiber_bus_bridge.plant import PlantTruth, plant_socket
from fiber_bus_bridge.simulation import (
    ArmState,
    MechanicalErrors,
    Mechanics,
    arms_at,
    arms_motion,
    draw_mechanics,
    true_angles,
)
from fiber_bus_bridge.wire import RobotState
from fiber_core import kinematics
from fiber_core.array_types import Mask, Points, Rows
from fiber_core.bounds import Range, check_ranges
from fiber_core.errors import FiberError
from fiber_core.focal_plane import FocalPlane
from fiber_metrology.camera.fiducial_places import fiducial_places
from fiber_metrology.camera.simulated_camera import CameraConfig, SimulatedCamera
from fiber_metrology.errors import MetrologyError
from fiber_msgs_py import PlanStamp, images, layout, spots, topics, true_places
from fiber_msgs_py.true_places import TruePlaces
from fiber_node import ManagedNode, SessionGate, run

__all__ = ["CameraNode", "main"]

_PAIR = re.compile(r"(\d+)\s*-\s*(\d+)")
_FIRST_S = 1e-3  # of the begin of a motion before its first movement
_Response: TypeAlias = Trigger.Response


@dataclass(frozen=True)
class SimulatedScene:
    """What the simulated camera looks at.

    Args:
        plant: socket of the plant with the robots; "auto" for that of this user, domain and
            namespace.
        seed: seed of the errors of the arms, the dark fibres, the optics, the air and the noise.
        exposures: exposures of one image.
        dark: share of the fibres that give no light.
        fiducials: number of fiducials.
        swapped: pairs of robots whose plugs are swapped, as "3-17, 8-9": each moves the arm of the
            other.

    Raises:
        MetrologyError: a value is out of range; names it.
    """

    RANGES: ClassVar = {
        "seed": Range(0, 2**63 - 1, whole=True),
        "exposures": Range(1, 100, whole=True),
        "dark": Range(0.0, 1.0),
        "fiducials": Range(0, 10_000, whole=True),
    }

    plant: str = "auto"
    seed: int = 0
    exposures: int = 3
    dark: float = 0.0
    fiducials: int = 120
    swapped: str = ""

    def __post_init__(self) -> None:
        check_ranges(self, self.RANGES, MetrologyError)
        self.pairs()

    def pairs(self) -> list[tuple[int, int]]:
        """Return the pairs of robots whose plugs are swapped, by id.

        Raises:
            MetrologyError: `swapped` is no list of pairs, or a robot is in two of them.
        """
        parts = [part.strip() for part in self.swapped.split(",") if part.strip()]
        pairs = [match.groups() for part in parts if (match := _PAIR.fullmatch(part))]
        ids = [int(robot) for pair in pairs for robot in pair]
        if len(pairs) < len(parts) or len(set(ids)) < len(ids):
            raise MetrologyError(
                f'swapped: "{self.swapped}" is no list of pairs of different robots, as "3-17, 8-9"'
            )
        return list(zip(ids[::2], ids[1::2]))


class CameraNode(ManagedNode):
    """Takes the exposures of an image whenever the service camera/expose is called.

    The arms stand where the counters read when the camera sees its plane first, and follow the
    counters as their mechanical errors let them. The robots know nothing of these errors.

    Args:
        options: keyword arguments of rclpy.node.Node.
    """

    def __init__(self, **options: Any):
        super().__init__("camera", "camera", **options)
        self._scene = self.parameters.declare(SimulatedScene, read_only=True).value
        self._errors = self.parameters.declare(MechanicalErrors, "arms", read_only=True).value
        self._optics = self.parameters.declare(CameraConfig, "optics")
        self.parameters.finish()
        self.begin()

    def configure(self) -> None:
        """Follow the plane."""
        self._plane: FocalPlane | None = None
        self._truth: PlantTruth | None = None
        self._arms: ArmState | None = None
        self._next = 0  # number of the first movement that the arms have not made
        gate = SessionGate(self, self.reporter.refuse_message)
        gate.subscription(topics.LAYOUT, self._on_layout)
        self._spots = topics.SPOTS.publisher(self)
        self._images = topics.IMAGE.publisher(self)
        self._calibration = topics.CALIBRATION.publisher(self)
        self._true = topics.TRUE_PLACES.publisher(self)
        topics.EXPOSE.server(self, self._on_expose)

    def activate(self) -> None:
        """Expose when told to."""
        self.get_logger().info("waits for the service camera/expose; its plane is simulated")

    def cleanup(self) -> None:
        """Leave the plant."""
        truth, self._truth = self._truth, None
        if truth is not None:
            truth.__exit__(None, None, None)

    def _on_layout(self, message: PointCloud2) -> None:
        try:
            plane = layout.decode(message)[0]
            if self._plane is None or not np.array_equal(plane.ids, self._plane.ids):
                self._look_at(plane)
            self._plane = plane
        except FiberError as error:
            self.reporter.refuse(f"layout refused: {error}", "layout")

    def _look_at(self, plane: FocalPlane) -> None:
        scene = self._scene
        self._arm_of = _arm_of(plane, scene.pairs())
        rng = np.random.default_rng(scene.seed)
        self._mechanics: Mechanics = draw_mechanics(plane.n, self._errors, rng, plane.limits)
        self._lit: Mask = rng.random(plane.n) >= scene.dark
        self._fiducials: Points = fiducial_places(plane, scene.fiducials)
        radius_mm = float(np.hypot(*plane.centers.T).max() + plane.arms.sum(axis=1).max())
        self._camera = SimulatedCamera(radius_mm, self._optics.value, rng)
        self._rng, self._arms, self._next = rng, None, 0
        lights_mm, seen_px = self._camera.calibration_lights()
        unseen = np.full((len(self._fiducials), 2), np.nan)
        self._calibration.publish(
            spots.encode_calibration(
                np.concatenate([lights_mm, self._fiducials]),
                np.concatenate([seen_px, unseen]),
                np.arange(len(lights_mm) + len(unseen)) >= len(lights_mm),
                self._now(),
            )
        )

    def _now(self) -> PlanStamp:
        return PlanStamp(self.get_clock().now().nanoseconds)

    def _on_expose(self, request: Any, response: _Response) -> _Response:
        try:
            response.message, response.success = self._expose(), True
        except FiberError as error:
            response.message, response.success = str(error), False
            self.reporter.refuse(f"no exposure: {error}")
        return response

    def _expose(self) -> str:
        if not self.active:
            raise MetrologyError("the camera is inactive: activate it first")
        plane = self._plane
        if plane is None:
            raise MetrologyError("no plane is known yet: there is no bridge in the graph")
        tips = self._true_fibres(plane)
        self._camera.config = self._optics.value
        self._true.publish(true_places.encode(TruePlaces(plane.ids, tips), self._now()))
        for _ in range(self._scene.exposures):
            if self._images.get_subscription_count():
                shot = self._camera.photograph(tips, self._fiducials, self._lit, self._rng)
                self._images.publish(images.encode(shot.pixels, self._now()))
            if self._spots.get_subscription_count():
                found = self._camera.expose(tips, self._fiducials, self._lit, self._rng).spots
                self._spots.publish(spots.encode(*found, self._now()))
        self.reporter.counters["images"] = int(str(self.reporter.counters.get("images", 0))) + 1
        return f"{self._scene.exposures} exposures"

    def _true_fibres(self, plane: FocalPlane) -> Points:
        """Where the fibres are, after all movements until now."""
        if self._truth is None:
            path = Path(self._scene.plant)
            if self._scene.plant == "auto":
                path = plant_socket(self.get_namespace())
            self._truth = PlantTruth(path, 1.0)
        truth = self._truth.since(self._next)
        if (truth.state == RobotState.MOVING).any():
            raise MetrologyError("robots are moving")
        if self._arms is None or truth.first < self._next:
            if truth.first > 0:
                raise MetrologyError(
                    f"{truth.first} movements were before this camera: start it with the plant"
                )
            self._arms = arms_at(self._mechanics, truth.start * truth.quantum_rad)
            truth = self._truth.since(0)
        elif truth.first > self._next:
            raise MetrologyError("movements between two images are lost: the plant keeps too few")
        begin_s = min(truth.moves.started_s.min(initial=truth.now_s), truth.now_s) - _FIRST_S
        moves = truth.moves._replace(row=self._arm_of[truth.moves.row])
        counters = moves.counters(truth.start, truth.quantum_rad, truth.now_s, begin_s)
        self._arms = arms_motion(self._mechanics, self._arms, *counters)[1]
        self._next = truth.next
        return kinematics.forward(plane, true_angles(self._mechanics, self._arms))[1]


def _arm_of(plane: FocalPlane, swapped: list[tuple[int, int]]) -> Rows:
    """Row of the arm that the orders for each robot move, shape (n,)."""
    arm_of = np.arange(plane.n)
    for pair in swapped:
        rows = plane.index_of(np.array(pair))
        if (rows < 0).any():
            raise MetrologyError(f"swapped: the plane has no robot {pair[int(np.argmin(rows))]}")
        arm_of[rows] = rows[::-1]
    return arm_of


def main(args: list[str] | None = None) -> int:
    """Run the camera until it is interrupted; return the exit code."""
    return run(CameraNode, args)
