# SPDX-License-Identifier: Apache-2.0
"""What a camera has told of a plan: where each fibre was in each image, or why nothing is told."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from fiber_core.array_types import Codes, Floats
from fiber_core.validation import frozen_array
from fiber_recording.errors import RecordingError

__all__ = ["Images"]

_OK = {0: "ok"}


@dataclass(frozen=True, eq=False)
class Images:
    """Measured places of fibres in k images: the first after the move, one after each correction.

    Args:
        place_mm: measured place of each fibre [mm], nan where none is told, shape (k, n, 2).
        verdict: what is told of each robot, a code of `names`; 0 is a fibre without a remark,
            shape (k, n).
        true_mm: true places of simulated fibres [mm], shape (k, n, 2); None if they are not known.
        names: name of each code of `verdict`.

    Raises:
        RecordingError: a shape does not fit, or a verdict has no name; names the array.
    """

    place_mm: Floats
    verdict: Codes
    true_mm: Floats | None = None
    names: Mapping[int, str] = field(default_factory=_OK.copy)

    def __post_init__(self):
        place = frozen_array(
            self.place_mm, np.float64, (None, None, 2), "image places", RecordingError
        )
        object.__setattr__(self, "place_mm", place)
        shape = place.shape[:2]
        verdict = frozen_array(self.verdict, np.int64, shape, "image verdict", RecordingError)
        object.__setattr__(self, "verdict", verdict)
        if self.true_mm is not None:
            true = frozen_array(
                self.true_mm, np.float64, place.shape, "image true_mm", RecordingError
            )
            object.__setattr__(self, "true_mm", true)
        unnamed = sorted(set(np.unique(self.verdict).tolist()) - set(self.names))
        if unnamed:
            raise RecordingError(f"verdict {unnamed[0]} of an image has no name")

    @property
    def robots(self) -> int:
        """Number of robots."""
        return self.place_mm.shape[1]
