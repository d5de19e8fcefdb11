# SPDX-License-Identifier: Apache-2.0
"""Images that a metrology took after a plan and after its corrections, for its recording."""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from fiber_core.outcomes import Verdict
from fiber_msgs_py import PlanStamp
from fiber_msgs_py.measured import Measured
from fiber_recording.images import Images
from fiber_recording.recording import Recording

__all__ = ["ImagesOfPlans", "with_images"]

_KEPT = 16  # corrections, and plans whose images wait for their recording


class ImagesOfPlans:
    """Keeps images until the recording of the plan that they are of is written.

    An image after a correction is of the plan that was corrected.
    """

    def __init__(self) -> None:
        self._corrected: PlanStamp | None = None  # the last plan that is no correction
        self._plan_of: dict[PlanStamp, PlanStamp] = {}
        self._waiting: dict[PlanStamp, list[Measured]] = {}

    def begin(self, plan: PlanStamp, straight: bool) -> None:
        """Note a plan; `straight` for a correction of the plan before it."""
        if not straight:
            self._corrected = plan
        elif self._corrected is not None:
            self._plan_of[plan] = self._corrected
            for old in sorted(self._plan_of)[:-_KEPT]:
                del self._plan_of[old]

    def add(self, plan: PlanStamp, table: Measured) -> None:
        """Add an image that was taken after a plan or a correction."""
        tables = self._waiting.setdefault(self._plan_of.get(plan, plan), [])
        tables.append(table)
        del tables[:-_KEPT]
        for old in sorted(self._waiting)[:-_KEPT]:
            del self._waiting[old]

    def waiting(self) -> Iterator[tuple[PlanStamp, list[Measured]]]:
        """Iterate over plans with images that are in no recording; they may be taken meanwhile."""
        yield from list(self._waiting.items())

    def take(self, plan: PlanStamp) -> None:
        """Forget the images of a plan, which go into its recording."""
        del self._waiting[plan]


def with_images(recording: Recording, tables: Sequence[Measured]) -> Recording:
    """Return a recording with further images, in the order in which they were taken.

    Args:
        recording: the recording, with or without images.
        tables: what was measured in each further image.
    """
    plane = recording.problem.plane
    places = np.full((len(tables), plane.n, 2), np.nan)
    verdict = np.full((len(tables), plane.n), int(Verdict.MISSING))
    for k, table in enumerate(tables):
        rows = plane.index_of(table.ids)
        known = rows >= 0
        places[k, rows[known]] = table.places[known]
        verdict[k, rows[known]] = table.verdict[known]
    before = recording.images
    if before is not None:
        places = np.concatenate([before.place_mm, places])
        verdict = np.concatenate([before.verdict, verdict])
    names = {int(code): code.name.lower() for code in Verdict}
    return replace(recording, images=Images(places, verdict, None, names))
