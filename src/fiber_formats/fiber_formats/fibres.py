# SPDX-License-Identifier: Apache-2.0
"""Several fibres a robot in tables: a text in each row of a layout, a name in each target."""

import numpy as np
from numpy.typing import NDArray

from fiber_core.array_types import Floats
from fiber_core.focal_plane import FocalPlane
from fiber_formats.columns import Columns
from fiber_formats.errors import FormatError
from fiber_formats.records import TargetColumns
from fiber_formats.text_tables import MISSING

__all__ = ["chosen_fibres", "fibre_texts", "fibres_of"]


def fibres_of(columns: Columns, name: str) -> tuple[Floats, tuple[str, ...]]:
    """Return fibres from texts "NAME x y NAME x y ...": [mm], shape (rows, fibres, 2), and names.

    All rows name the same fibres in the same order. What is wrong is noted in the columns.
    """
    texts = [text.split() for text in columns.words(name).tolist()]
    names = tuple(texts[0][::3]) if texts else ()
    places = np.ones((len(texts), len(names), 2))
    bad = np.zeros(len(texts), dtype=bool)
    for row, words in enumerate(texts):
        try:
            xy = [words[1::3], words[2::3]]
            if (
                tuple(words[::3]) != names
                or len(words) != 3 * len(names)
                or "_" in "".join(xy[0] + xy[1])
            ):
                raise ValueError
            places[row] = np.array(xy, dtype=float).T
        except ValueError:
            bad[row] = True
    columns.refuse_rows(bad, name, "does not name the fibres of the first row: NAME x y ...")
    if unfit := [fibre for fibre in names if fibre.lower() in MISSING]:
        columns.note(f"{name}: {', '.join(unfit)} is no name, it stands for a missing value")
    return places, names


def fibre_texts(places: NDArray, names: tuple[str, ...]) -> NDArray:
    """Return fibres of shape (n, fibres, 2) as the texts that `fibres_of` reads."""
    rows = [
        " ".join(f"{name} {float(x)!r} {float(y)!r}" for name, (x, y) in zip(names, row))
        for row in places
    ]
    return np.array(rows, dtype=str)


def chosen_fibres(
    name: str, found: TargetColumns, plane: FocalPlane | None
) -> tuple[NDArray, NDArray, tuple[str, ...]]:
    """Return the places and the fibres of targets on a plane, and notices.

    Args:
        name: path of the file, for messages.
        found: the targets.
        plane: the focal plane, or None.

    Returns:
        Targets [mm], shape (k, 2), and the name of each fibre, empty for any, shape (k,).

    Raises:
        FormatError: a target is for a fibre that the plane has not.
    """
    any_fibre = np.full(len(found.ids), "")
    if found.fibre is None:
        return found.xy_mm, any_fibre, ()
    has = () if plane is None else plane.fibre_names
    lacking = sorted(set(found.fibre.tolist()) - {"", *has})
    if plane is None:
        return found.xy_mm, found.fibre, ()
    if found.tip_mm is not None and lacking:
        what = f": the plane has no fibre {', '.join(lacking)}"
        return found.tip_mm, any_fibre, (f"targets are places of the tips{what}",)
    if lacking:
        have = f"it has {', '.join(has)}" if has else "it has one fibre at each tip"
        raise FormatError(f"{name}: the plane has no fibre {', '.join(lacking)}; {have}")
    return found.xy_mm, found.fibre, ()
