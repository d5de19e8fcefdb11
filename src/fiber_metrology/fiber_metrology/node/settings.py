# SPDX-License-Identifier: Apache-2.0
"""Settings of the metrology that belong to no core: how images are taken."""

from dataclasses import dataclass
from typing import ClassVar

from fiber_core.bounds import Range, check_ranges
from fiber_metrology.errors import MetrologyError

__all__ = ["MetrologyConfig"]


@dataclass(frozen=True)
class MetrologyConfig:
    """How images are taken.

    Args:
        exposures: exposures of one image.
        pixels: whether spots are found in the pixels of the topic camera/image; else lists of
            spots are heard on camera/spots. A change is in effect when the node is configured next.
        expose: whether the camera is told to expose by the service camera/expose; else the next
            exposures that come are taken.
        timeout_s: longest wait for all exposures of an image, and for the bridge to take over what
            was measured [s].
        degree: degree of the map from pixels to the plane that the calibration lights give.

    Raises:
        MetrologyError: a value is out of range; names it.
    """

    RANGES: ClassVar = {
        "exposures": Range(1, 100, whole=True),
        "timeout_s": Range(0.1, 3600.0),
        "degree": Range(1, 9, whole=True),
    }

    exposures: int = 3
    pixels: bool = False
    expose: bool = True
    timeout_s: float = 20.0
    degree: int = 9

    def __post_init__(self) -> None:
        check_ranges(self, self.RANGES, MetrologyError)
