# SPDX-License-Identifier: Apache-2.0
"""Spots: what is left of an image when every point of light in it is found."""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from fiber_core.array_types import Floats
from fiber_core.validation import frozen_array
from fiber_metrology.errors import MetrologyError

__all__ = ["Spots", "checked_spots"]


class Spots(NamedTuple):
    """The spots of one image.

    Args:
        place_px: centroids [px], shape (s, 2).
        flux: light of each [counts], shape (s,).
        width_px: rms radius along one axis [px], shape (s,).
    """

    place_px: Floats
    flux: Floats
    width_px: Floats


def checked_spots(place_px: ArrayLike, flux: ArrayLike, width_px: ArrayLike) -> Spots:
    """Return spots whose shapes fit; those that are not finite are left out.

    The arguments are those of Spots.

    Raises:
        MetrologyError: a shape does not fit.
    """
    place = frozen_array(place_px, np.float64, (None, 2), "place_px", MetrologyError)
    light = frozen_array(flux, np.float64, (len(place),), "flux", MetrologyError)
    width = frozen_array(width_px, np.float64, (len(place),), "width_px", MetrologyError)
    good = np.isfinite(place).all(axis=1) & np.isfinite(light) & np.isfinite(width)
    return Spots(place[good], light[good], width[good])
