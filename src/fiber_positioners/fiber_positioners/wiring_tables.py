# SPDX-License-Identifier: Apache-2.0
"""Tables of the wiring: the turns of each robot, and the lights of each image."""

import os

import numpy as np

from fiber_core.focal_plane import FocalPlane
from fiber_formats import read_columns, write_table
from fiber_metrology import CodeWords, Lights

__all__ = ["read_lights", "write_turns"]


def write_turns(path: str | os.PathLike[str], plane: FocalPlane, words: CodeWords) -> None:
    """Write image, id, and phi_turn_deg from where the robot rested before the first image.

    Args:
        path: the table.
        plane: the focal plane.
        words: the code words of its robots.
    """
    columns = {
        "image": np.repeat(np.arange(words.images), plane.n),
        "id": np.tile(plane.ids, words.images),
        "phi_turn_deg": np.rad2deg(words.turned_rad).T.ravel(),
    }
    write_table(path, columns)


def read_lights(path: str | os.PathLike[str], images: int) -> list[Lights]:
    """Read the lights of some images: image, from 0, x_mm and y_mm in the focal plane.

    Args:
        path: the table.
        images: number of images; one without rows shows no light.

    Raises:
        FormatError: a column is missing, or a value is refused.
    """
    columns = read_columns(path, "image", "x_mm", "y_mm")
    what = f"is no image from 0 to {images - 1}"
    image = columns.whole("image", 0, images - 1, what)
    xy_mm = np.stack([columns.numbers(f"{axis}_mm", "mm") for axis in "xy"], axis=1)
    columns.check()
    found = []
    for k in range(images):
        here = xy_mm[image == k]
        n = len(here)
        none = np.zeros((n, 2), dtype=np.int64)
        found.append(Lights(here, np.ones(n, int), np.zeros(n, bool), 1, [], none))
    return found
