# SPDX-License-Identifier: Apache-2.0
"""The exposures and the calibration of a camera in the graph."""

import threading
import time
from collections.abc import Callable
from typing import Any

import numpy as np
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup, ReentrantCallbackGroup
from rclpy.node import Node
from sensor_msgs.msg import Image, PointCloud2
from std_srvs.srv import Trigger

from fiber_core.array_types import Points
from fiber_core.errors import FiberError
from fiber_metrology.centroids import CentroidConfig, find_spots
from fiber_metrology.errors import ImageError, MetrologyError
from fiber_metrology.node.settings import MetrologyConfig
from fiber_metrology.polynomials import PolynomialMap, fit_map
from fiber_metrology.spots import Spots, checked_spots
from fiber_msgs_py import PlanStamp, images, spots, topics
from fiber_node import Declared

__all__ = ["CameraIntake"]

_CALIBRATION_S = 5.0


class CameraIntake:
    """Takes the exposures of an image, and keeps the calibration of the camera.

    Args:
        node: the node, which subscribes.
        config: how images are taken.
        centroids: how spots are found in pixels.
        refusing: makes of a name and a callback one that reports why a message was refused.
    """

    def __init__(
        self,
        node: Node,
        config: Declared[MetrologyConfig],
        centroids: Declared[CentroidConfig],
        refusing: Callable[[str, Callable[[Any], None]], Callable[[Any], None]],
    ):
        self._node, self._config, self._centroids = node, config, centroids
        self._map: PolynomialMap | None = None
        self._fiducials: Points = np.zeros((0, 2))
        self._exposures: list[Spots | Exception] = []
        self._since_ns, self._early_ns = 0, list[int]()  # exposures of before are not counted
        self._came = threading.Condition()
        topics.CALIBRATION.subscription(node, refusing("calibration", self._on_calibration))
        group = MutuallyExclusiveCallbackGroup()
        topic = topics.IMAGE if config.value.pixels else topics.SPOTS
        topic.subscription(node, self._on_exposure, callback_group=group)
        self._expose = topics.EXPOSE.client(node, callback_group=ReentrantCallbackGroup())

    def _on_calibration(self, message: PointCloud2) -> None:
        plane_mm, place_px, fiducial = spots.decode_calibration(message)
        lights = np.isfinite(place_px).all(axis=1)
        degree = self._config.value.degree
        terms = (degree + 1) * (degree + 2) // 2
        if lights.sum() < terms:
            raise MetrologyError(
                f"{lights.sum()} calibration lights, and a map of degree {degree} has {terms} terms"
            )
        fitted = fit_map(place_px[lights], plane_mm[lights], degree)
        with self._came:
            self._map, self._fiducials = fitted, plane_mm[fiducial]
            self._came.notify_all()
        text = f"calibration: {lights.sum()} lights, {fiducial.sum()} fiducials"
        self._node.get_logger().info(text)

    def calibration(self) -> tuple[PolynomialMap, Points]:
        """Return the map from pixels to the plane, and the places of the fiducials [mm], (k, 2).

        Raises:
            MetrologyError: the camera has sent none, also after a wait for one that has just begun.
        """
        with self._came:
            self._came.wait_for(lambda: self._map is not None, _CALIBRATION_S)
            if self._map is None:
                raise MetrologyError("the camera has sent no calibration")
            return self._map, self._fiducials

    def _on_exposure(self, message: PointCloud2 | Image) -> None:
        found: Spots | Exception
        stamp_ns = 0
        try:
            stamp_ns = PlanStamp.of(message).ns
            if isinstance(message, Image):
                found = find_spots(images.decode(message), self._centroids.value)
            else:
                found = checked_spots(*spots.decode(message))
        except FiberError as error:
            found = error
        with self._came:
            if stamp_ns < self._since_ns:
                self._early_ns.append(stamp_ns)
                return
            self._exposures.append(found)
            del self._exposures[: -self._config.value.exposures]
            self._came.notify_all()

    def take(self, since_ns: int) -> list[Spots]:
        """Return the spots of the exposures of one image.

        Args:
            since_ns: the robots rest since this time [ns]; exposures of before do not count, even
                if they come late.

        Raises:
            ImageError: there is no camera, it does not answer, or it gives too few exposures.
            FiberError: an exposure is malformed.
        """
        config = self._config.value
        until_s = time.monotonic() + config.timeout_s
        with self._came:
            self._exposures.clear()
            self._since_ns, self._early_ns = since_ns, []
        if config.expose:
            self._tell_camera(until_s)
        with self._came:
            self._came.wait_for(
                lambda: len(self._exposures) >= config.exposures, until_s - time.monotonic()
            )
            taken, early_ns = list(self._exposures), self._early_ns
        if len(taken) < config.exposures:
            text = f"the camera gave {len(taken)} of {config.exposures} exposures in "
            text += f"{config.timeout_s:g} s"
            if early_ns:
                late_s = (since_ns - max(early_ns)) * 1e-9
                text += f", and {len(early_ns)} of {late_s:.3f} s or more before the robots rested"
            raise ImageError(text)
        for each in taken:
            if isinstance(each, Exception):
                raise each
        return [each for each in taken if isinstance(each, Spots)]

    def _tell_camera(self, until_s: float) -> None:
        if not self._expose.wait_for_service(max(until_s - time.monotonic(), 0.0)):
            raise ImageError("there is no camera in the graph: nothing serves camera/expose")
        answered = threading.Event()
        future = self._expose.call_async(Trigger.Request())
        future.add_done_callback(lambda _: answered.set())
        if not answered.wait(max(until_s - time.monotonic(), 0.0)):
            raise ImageError("the camera does not answer")
        answer = future.result()
        if answer is None or not answer.success:
            raise ImageError(f"the camera did not expose: {answer.message if answer else ''}")
