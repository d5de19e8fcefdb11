# SPDX-License-Identifier: Apache-2.0
"""Images before and after test turns of robots at unknown places."""

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from fiber_core.array_types import Angles, Codes, Ints, Mask
from fiber_core.outcomes import Verdict
from fiber_metrology.exposures import Lights, beside_free_lights
from fiber_metrology.measure import MeasureConfig, Measurement
from fiber_metrology.recovery import Recovered, RecoveryConfig, recover
from fiber_msgs_py import layout

__all__ = ["TurnImages", "at_unknown_places"]

_MOST_RAD = 0.02  # of a turn between two images; a larger one is no test turn


def at_unknown_places(unplaced: Codes) -> Mask:
    """Return the robots of which no arm is known, shape (n,).

    Args:
        unplaced: codes of the layout, shape (n,).
    """
    return (unplaced > 0) & (unplaced != layout.SEEN)


class _Image(NamedTuple):
    measurement: Measurement
    counters: Angles
    session: str | None


class TurnImages:
    """Keeps the last image while robots are at unknown places, and finds them in the next one."""

    def __init__(self) -> None:
        self._before: _Image | None = None

    def find(
        self,
        image: Measurement,
        counters: Angles,
        unplaced: Codes,
        session: str | None,
        config: MeasureConfig,
    ) -> Measurement:
        """Return an image with the robots that it and the one before tell.

        A robot is told as measured, or, if its turn of theta is not known, at its place and as
        unplaced. One without a light in its reach that may be its own is missing: another turn
        does not help it.

        Args:
            image: what the image tells of the other robots.
            counters: joint angles by the counters [rad], shape (n, 2).
            unplaced: which robots are at unknown places, codes of the layout, shape (n,).
            session: id of the session of the bridge.
            config: errors of camera and air.
        """
        lost = at_unknown_places(unplaced)
        before = self._before
        self._before = _Image(image, counters, session) if lost.any() else None
        if before is None or self._before is None or before.session != session:
            return image
        turned = counters - before.counters
        one = (turned != 0.0).sum(axis=1) == 1
        among = lost & one & (np.abs(turned) < _MOST_RAD).all(axis=1)
        if not among.any():
            return image
        first, _ = _of_others(before.measurement)
        second, rows = _of_others(image)
        error_um = config.error_um / np.sqrt(min(first.exposures, second.exposures))
        about = RecoveryConfig(error_um=error_um, sigmas=config.sigmas, identify=config.identify)
        recalled = np.where((unplaced == layout.RECALLED)[:, None], counters, np.nan)
        found = recover(image.plane, first, second, turned, about, among, recalled)
        return _with_found(image, found, rows, lost)


def _of_others(image: Measurement) -> tuple[Lights, Ints]:
    """The lights of an image that are surely of no robot at a known place, and their rows."""
    lights, kept = image.lights, np.ones(len(image.lights.places), dtype=bool)
    kept[image.light[image.certain]] = False
    rows = np.flatnonzero(kept)
    less = lights._replace(
        places=lights.places[rows], seen=lights.seen[rows], merged=lights.merged[rows],
        first=lights.first[rows],
    )  # fmt: skip
    return less, rows


def _with_found(image: Measurement, found: Recovered, rows: Ints, lost: Mask) -> Measurement:
    here = found.certain
    light = np.array(image.light)
    light[here] = rows[found.light[here]]
    owned = light[here | image.certain]
    dark = lost & ~here & ~beside_free_lights(image.plane, image.lights, owned)
    verdict = np.where(here & found.turn_known, Verdict.MEASURED, image.verdict)
    pair = here[:, None]
    return replace(
        image,
        verdict=np.where(dark, Verdict.MISSING, verdict),
        places=np.where(pair, found.places, image.places),
        angles=np.where(pair, found.angles, image.angles),
        interval_rad=np.where(pair, found.interval_rad, image.interval_rad),
        error_mm=np.where(here, found.error_mm, image.error_mm),
        doubt=np.where(here, found.doubt, image.doubt),
        light=light,
    )
