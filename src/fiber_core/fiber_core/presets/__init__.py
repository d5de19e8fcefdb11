# SPDX-License-Identifier: Apache-2.0
"""Presets: focal planes of known instruments, built from a few of their figures."""

from collections.abc import Mapping
from types import MappingProxyType

from fiber_core.errors import LayoutError
from fiber_core.focal_plane import FocalPlane
from fiber_core.presets.desi import DESI, DESI_OUTLINES
from fiber_core.presets.desi_petals import DESI_PETALS
from fiber_core.presets.figures import PlaneColumns, Polygon, Preset, on_a_grid, plane_from
from fiber_core.presets.others import LAMOST, MOONS, PAPER
from fiber_core.presets.pfs import PFS, PFS_WINDOWS
from fiber_core.presets.rafts import MUST, WST_MIXED
from fiber_core.presets.sdss_v import SDSS_V
from fiber_core.presets.sdss_v_apo import SDSS_V_APO
from fiber_core.presets.spec_s5 import SPEC_S5

__all__ = ["PRESETS", "PlaneColumns", "Polygon", "Preset", "figures_of", "plane_from", "preset"]

PRESETS: Mapping[str, Preset] = MappingProxyType(
    {
        "paper": PAPER,
        "desi": DESI,
        "desi_outlines": DESI_OUTLINES,
        "desi_petals": DESI_PETALS,
        "pfs": PFS,
        "pfs_windows": PFS_WINDOWS,
        "sdss_v": SDSS_V,
        "sdss_v_apo": SDSS_V_APO,
        "moons": MOONS,
        "lamost": LAMOST,
        "spec_s5": SPEC_S5,
        "must": MUST,
        "wst_mixed": WST_MIXED,
    }
)


def preset(name: str, robots: int | None = None) -> FocalPlane:
    """Return the focal plane of an instrument.

    Args:
        name: one of PRESETS; the note of each says which figures are assumed.
        robots: number of robots; by default that of the instrument. Robot k stands on the
            same site for every number. A hexagonal grid has any number of sites.

    Raises:
        LayoutError: no preset has this name, or the number is not a positive integer or is more
            than the instrument has sites.
    """
    figures = figures_of(name)
    return (figures.build or on_a_grid)(figures, robots, name)


def figures_of(name: str) -> Preset:
    """Return the figures of an instrument.

    Raises:
        LayoutError: no preset has this name.
    """
    if name not in PRESETS:
        raise LayoutError(f"no preset is named {name!r}; there are {', '.join(PRESETS)}")
    return PRESETS[name]
