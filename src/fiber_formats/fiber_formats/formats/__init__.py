# SPDX-License-Identifier: Apache-2.0
"""The formats of instruments; each module holds one, as its FORMAT."""

from fiber_formats.formats import (
    desi_calibration,
    desi_state,
    desi_tile,
    just_sites,
    moons_assignment,
    own,
    pfs_cobras,
    pfs_config,
    problem_file,
    sdss_configuration,
    sdss_positioners,
)
from fiber_formats.interface import Format

__all__ = ["FORMATS", "OWN"]

OWN: Format = own.FORMAT  # what a file is where no other format matches

FORMATS: tuple[Format, ...] = (
    desi_state.FORMAT,
    desi_calibration.FORMAT,
    desi_tile.FORMAT,
    sdss_positioners.FORMAT,
    sdss_configuration.FORMAT,
    pfs_config.FORMAT,
    pfs_cobras.FORMAT,
    moons_assignment.FORMAT,
    just_sites.FORMAT,
    problem_file.FORMAT,
)
