# SPDX-License-Identifier: Apache-2.0
"""Corrections after a motion: image, correction, image, as often as asked for.

Outcome and error of each robot come from the last image. A robot that does not follow is flagged
and stays; robots whose light is not found stay where they are. An image that cannot be used is
taken once more; then the loop ends, and what is known is told.
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from fiber_client.client import PlaneClient
from fiber_client.errors import PlaneError, PlaneRefusal
from fiber_core.array_types import Floats, Ids, Mask, Points
from fiber_core.errors import FiberError
from fiber_core.outcomes import STILL, Outcome, PlanOutcome, Reason, Verdict
from fiber_msgs_py import PlanStamp, topics
from fiber_msgs_py.measured import Measured

__all__ = ["CameraLoop", "LoopEnd", "show_images"]

_SHOWN = 5  # flagged robots that are named


@dataclass(frozen=True, eq=False)
class LoopEnd:
    """How a closed loop ended.

    Args:
        outcome: outcome of every robot of the plane by the last image; nan errors for robots that
            it does not show.
        places: measured place of each fibre in each image [mm], shape (images, n, 2), nan where
            none is told.
        errors_mm: distance of each fibre from its target in each image [mm], shape (images, n),
            nan where there is no target or no place.
        corrected: number of robots with a target in each correction.
        flagged: robots that did not move when they were told to, with their Verdict, by id.
        planned: robots that the motion before the corrections was to bring to their targets,
            shape (n,).
        ended: why the loop ended early, empty if it did not.
    """

    outcome: PlanOutcome
    places: list[Points]
    errors_mm: list[Floats]
    corrected: list[int]
    flagged: dict[int, Verdict]
    planned: Mask
    ended: str = ""

    def images(self) -> list[dict[str, Any]]:
        """Return figures of each image, of the robots that follow and were to move.

        A robot that is held in a correction counts with what the motion before it left.
        Robots measured; rms, 99th percentile and largest of their errors [um].
        """
        figures, follow = [], self.planned & ~np.isin(self.outcome.ids, list(self.flagged))
        for errors in self.errors_mm:
            um = 1e3 * errors[np.isfinite(errors) & follow]
            row: dict[str, Any] = {"measured": len(um)}
            if len(um):
                row |= {
                    "rms_um": round(float(np.sqrt(np.mean(um**2))), 2),
                    "p99_um": round(float(np.percentile(um, 99)), 2),
                    "most_um": round(float(um.max()), 2),
                }
            figures.append(row)
        return figures


@dataclass(eq=False)
class CameraLoop:
    """Takes images and corrects, with a client of the graph.

    Args:
        client: the client, in a graph with a metrology and a camera.
        tolerance_um: a fibre that is so close to its target has reached it, and is left there [um].
        iterations: largest number of corrections.
        timeout_s: time-out of each wait [s].
    """

    client: PlaneClient
    tolerance_um: float
    iterations: int
    timeout_s: float
    _flagged: dict[int, Verdict] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if not (np.isfinite(self.tolerance_um) and self.tolerance_um > 0.0):
            raise PlaneError(f"the tolerance {self.tolerance_um} um is not a positive number")
        if self.iterations < 0:
            raise PlaneError(f"{self.iterations} iterations: 0 or more are possible")
        self._measure = topics.MEASURE.client(self.client.node)

    def take_image(self) -> Measured:
        """Let the metrology measure; its answer comes when the bridge knows what it found.

        Raises:
            PlaneRefusal: the image cannot be used, or the bridge refuses it; gives the reason.
            NodeLost, WaitError: as in the calls of the client.
        """
        client, known = self.client, dict(self.client.measured)
        self._call_measure()
        client.wait_for(
            lambda: self._newest(known) is not None, self.timeout_s, "what was measured"
        )
        newest = self._newest(known)
        assert newest is not None
        return newest

    def _call_measure(self) -> None:
        client, service = self.client, self._measure
        client.wait_for(service.service_is_ready, self.timeout_s, "service measure of a metrology")
        future = service.call_async(topics.MEASURE.type.Request())
        client.wait_for(future.done, self.timeout_s, "answer of measure")
        answer = future.result()
        if answer is None or not answer.success:
            raise PlaneRefusal("metrology", answer.message if answer else "no answer")

    def _newest(self, known: dict[PlanStamp, Measured]) -> Measured | None:
        new = [
            stamp for stamp, table in self.client.measured.items() if table is not known.get(stamp)
        ]
        return self.client.measured[max(new)] if new else None

    def run(self, ids: Ids, xy_mm: Points, blind: PlanOutcome) -> LoopEnd:
        """Correct robots after a motion.

        Args:
            ids: robots with a target, shape (k,).
            xy_mm: targets of their fibres [mm], shape (k, 2).
            blind: the outcome of the motion by the counters.
        """
        plane = self.client.plane
        rows = plane.index_of(ids)
        wanted = np.full((plane.n, 2), np.nan)
        wanted[rows[rows >= 0]] = np.asarray(xy_mm)[rows >= 0]
        base = blind.of(plane.ids)
        places: list[Points] = []
        errors_mm: list[Floats] = []
        corrected: list[int] = []
        ended = ""
        moved = base
        for number in range(self.iterations + 1):
            try:
                image = self._usable_image()
            except FiberError as error:
                ended = str(error)
                break
            places.append(self._places(image))
            errors_mm.append(np.hypot(*(places[-1] - wanted).T))
            todo = self._to_correct(errors_mm[-1], base)
            if number == self.iterations or not todo.any():
                break
            corrected.append(int(todo.sum()))
            try:
                after = self._correct(plane.ids[todo], wanted[todo]).of(plane.ids)
            except FiberError as error:
                ended = str(error)
                break
            moved = replace(
                moved,
                outcome=np.where(todo, after.outcome, moved.outcome),
                reason=np.where(todo, after.reason, moved.reason),
            )
        outcome = self._outcome(moved, wanted, errors_mm)
        flagged = dict(self._flagged)
        return LoopEnd(outcome, places, errors_mm, corrected, flagged, _on_the_way(base), ended)

    def _usable_image(self) -> Measured:
        try:
            image = self.take_image()
        except PlaneRefusal as refusal:
            self.client.node.get_logger().warning(f"{refusal}; another image is taken")
            image = self.take_image()
        for robot, code in zip(image.ids.tolist(), image.verdict.tolist()):
            if code in STILL:
                self._flagged.setdefault(robot, Verdict(code))
        return image

    def _places(self, image: Measured) -> Points:
        places = np.full((self.client.plane.n, 2), np.nan)
        rows = self.client.plane.index_of(image.ids)
        places[rows[rows >= 0]] = image.places[rows >= 0]
        return places

    def _to_correct(self, errors_mm: Floats, base: PlanOutcome) -> Mask:
        still = np.isin(self.client.plane.ids, list(self._flagged))
        with np.errstate(invalid="ignore"):
            off = errors_mm > 1e-3 * self.tolerance_um
        return off & ~still & _on_the_way(base) & self.client.plane.enabled

    def _correct(self, ids: Ids, xy_mm: Points) -> PlanOutcome:
        client = self.client
        stamp = client.send_targets(ids, xy_mm, straight=True)
        client.wait_until_ready(stamp, self.timeout_s)
        with client.stops_on_error(self.timeout_s):
            client.start(self.timeout_s)
            return client.wait_for_outcome(stamp, self.timeout_s)

    def _outcome(
        self,
        moved: PlanOutcome,
        wanted: Points,
        errors_mm: list[Floats],
    ) -> PlanOutcome:
        """The outcome of every robot, as the last image shows it."""
        n = len(moved.ids)
        asked = np.isfinite(wanted).all(axis=1)
        error = errors_mm[-1] if errors_mm else np.full(n, np.nan)
        seen = np.isfinite(error)
        still = np.isin(moved.ids, list(self._flagged))
        with np.errstate(invalid="ignore"):
            reached = asked & seen & ~still & (error <= 1e-3 * self.tolerance_um)
        outcome, why = np.array(moved.outcome), np.array(moved.reason)
        # what the counters call reached is that no more
        by_counter = asked & (outcome == Outcome.REACHED)
        outcome[by_counter & ~reached] = Outcome.HELD
        fine = np.isin(why, (Reason.OK, Reason.NO_TARGET))
        why[asked & seen & ~reached & fine] = Reason.OFF_TARGET
        why[by_counter & ~seen] = Reason.NOT_SEEN
        outcome[still & asked], why[still & asked] = Outcome.FAILED, Reason.NOT_MOVED
        outcome[reached], why[reached] = Outcome.REACHED, Reason.OK
        return PlanOutcome(moved.stamp_ns, moved.ids, outcome, why, error)


def _on_the_way(base: PlanOutcome) -> Mask:
    # a robot that the blind motion was not planned for stays as it is
    return np.isin(base.reason, (Reason.OK, Reason.OFF_TARGET))


def show_images(closed: LoopEnd, say: Callable[[str], None]) -> dict[str, object]:
    """Tell what the images of a loop showed, for people, and return it for a report.

    Args:
        closed: the end of the loop.
        say: called with each line.
    """
    for number, figures in enumerate(closed.images()):
        after = "the motion" if number == 0 else f"correction {number}"
        text = ", ".join(f"{name} {value}" for name, value in figures.items())
        say(f"image after {after}: {text}")
    for robot, verdict in list(closed.flagged.items())[:_SHOWN]:
        say(f"robot {robot}: {verdict.name.lower()} when it was told to move")
    if closed.ended:
        say(f"the loop ended early: {closed.ended}")
    flagged = {str(robot): verdict.name.lower() for robot, verdict in closed.flagged.items()}
    return {
        "images": closed.images(),
        "corrected": closed.corrected,
        "flagged": flagged,
        "ended": closed.ended,
    }
