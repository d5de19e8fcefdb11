# SPDX-License-Identifier: Apache-2.0
"""Images that a metrology took after a plan and after its corrections, for its recording."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from fiber_core.outcomes import Verdict
from fiber_msgs_py import PlanStamp
from fiber_msgs_py.measured import Measured
from fiber_msgs_py.true_places import TruePlaces
from fiber_recording.images import Images
from fiber_recording.recording import Recording

__all__ = ["ImagesOfPlans", "SeenImage", "with_images"]

_KEPT = 16  # corrections, and plans whose images wait for their recording


class SeenImage(NamedTuple):
    """One image.

    Args:
        measured: what was measured in it.
        true: where fibres were as it was taken; None without a simulated camera.
    """

    measured: Measured
    true: TruePlaces | None = None


class ImagesOfPlans:
    """Keeps images until the recording of the plan that they are of is written.

    An image after a correction is of the plan that was corrected.
    """

    def __init__(self) -> None:
        self._corrected: PlanStamp | None = None  # the last plan that is no correction
        self._plan_of: dict[PlanStamp, PlanStamp] = {}
        self._true: TruePlaces | None = None  # of the exposures since the last image
        self._waiting: dict[PlanStamp, list[SeenImage]] = {}

    def begin(self, plan: PlanStamp, straight: bool) -> None:
        """Note a plan; `straight` for a correction of the plan before it."""
        if not straight:
            self._corrected = plan
        elif self._corrected is not None:
            self._plan_of[plan] = self._corrected
            for old in sorted(self._plan_of)[:-_KEPT]:
                del self._plan_of[old]

    def expose(self, true: TruePlaces) -> None:
        """Note where fibres truly are as the next image is taken."""
        self._true = true

    def add(self, plan: PlanStamp, table: Measured) -> None:
        """Add an image that was taken after a plan or a correction."""
        tables = self._waiting.setdefault(self._plan_of.get(plan, plan), [])
        tables.append(SeenImage(table, self._true))
        self._true = None
        del tables[:-_KEPT]
        for old in sorted(self._waiting)[:-_KEPT]:
            del self._waiting[old]

    def waiting(self) -> Iterator[tuple[PlanStamp, list[SeenImage]]]:
        """Iterate over plans with images that are in no recording; they may be taken meanwhile."""
        yield from list(self._waiting.items())

    def take(self, plan: PlanStamp) -> None:
        """Forget the images of a plan, which go into its recording."""
        del self._waiting[plan]


def with_images(recording: Recording, images: Sequence[SeenImage]) -> Recording:
    """Return a recording with further images, in the order in which they were taken.

    Args:
        recording: the recording, with or without images.
        images: the further images.
    """
    plane = recording.problem.plane
    places, true = np.full((2, len(images), plane.n, 2), np.nan)
    verdict = np.full((len(images), plane.n), int(Verdict.MISSING))
    for k, image in enumerate(images):
        table = image.measured
        rows = plane.index_of(table.ids)
        known = rows >= 0
        places[k, rows[known]] = table.places[known]
        verdict[k, rows[known]] = table.verdict[known]
        if image.true is not None:
            rows = plane.index_of(image.true.ids)
            true[k, rows[rows >= 0]] = image.true.places[rows >= 0]
    before = recording.images
    if before is not None:
        unknown = np.full(before.place_mm.shape, np.nan)
        true = np.concatenate([unknown if before.true_mm is None else before.true_mm, true])
        places = np.concatenate([before.place_mm, places])
        verdict = np.concatenate([before.verdict, verdict])
    names = {int(code): code.name.lower() for code in Verdict}
    known_true = None if np.isnan(true).all() else true
    return replace(recording, images=Images(places, verdict, known_true, names))
