# SPDX-License-Identifier: Apache-2.0
"""DESI: table of the calibration with its history (`calib-*.csv`); the newest row a robot counts.

Places are offset_x_cs5, offset_y_cs5 in the focal plane; offset_t is in the frame of the petal,
whose place is the thousands of `location`. Outlines, petal edges and cameras are not in the file:
the published ones are used, outlines expanded as the columns tell.
"""

import numpy as np

from fiber_core.array_types import Bools, Floats
from fiber_core.presets.desi_petals import petal_walls
from fiber_formats.columns import MOST_ID, Columns
from fiber_formats.formats.desi_frame import linear_motors, motor_notices, petal_angle_deg
from fiber_formats.formats.desi_keepouts import expanded_outlines
from fiber_formats.interface import Format
from fiber_formats.records import LayoutColumns
from fiber_formats.source import Source
from fiber_formats.table import Table

__all__ = ["FORMAT"]

_SIGN = ("location", "offset_x_cs5", "offset_y_cs5", "length_r1", "offset_t", "time_recorded")


def matches(source: Source) -> bool:
    """Return whether the one file is a table with the columns of a calibration."""
    return len(source.files) == 1 and source.files[0].has_columns(*_SIGN)


def layout(source: Source) -> LayoutColumns:
    """Read the newest row of every robot."""
    table = source.only.table_with(*_SIGN)
    newest = _newest_rows(table)
    columns = Columns(table, keep=newest)
    ids = columns.ids("location")
    columns.words("time_recorded")
    petal = ids // 1000
    columns.refuse_rows((petal < 0) | (petal > 9), "location", "is in no petal from 0 to 9")
    found = {
        "id": ids,
        "x_mm": columns.numbers("offset_x_cs5", "mm"),
        "y_mm": columns.numbers("offset_y_cs5", "mm"),
        "arm_theta_mm": columns.numbers("length_r1", "mm"),
        "arm_phi_mm": columns.numbers("length_r2", "mm"),
        "theta_zero_deg": columns.numbers("offset_t", "deg") + petal_angle_deg(petal),
        "phi_zero_deg": columns.numbers("offset_p", "deg"),
        "theta_range_deg": columns.numbers("physical_range_t", "deg"),
        "phi_range_deg": columns.numbers("physical_range_p", "deg"),
        "enabled": ~columns.flags("device_classified_nonfunctional"),
        "petal": petal,
        "bus": columns.words("bus_id"),
    }
    notices: tuple[str, ...] = ()
    older = np.count_nonzero(~newest)
    if older:
        notices += (f"{older} rows are older than another row of the same robot and not used",)
    arms = np.stack([found["arm_theta_mm"], found["arm_phi_mm"]], axis=1)
    outlines, more = expanded_outlines(columns, arms, _linear_phi(columns))
    found |= _scales(columns)
    notices += motor_notices(columns) + more
    columns.check()
    notices += ("petal edges and GFAs are those published: the file has none",)
    notices += columns.absent_notice() + columns.unused_notice()
    walls = petal_walls(np.unique(petal))
    found |= outlines
    return LayoutColumns(found, preset="desi_outlines", notices=notices, walls=walls)


def _linear_phi(columns: Columns) -> Bools:
    if not columns.optional("zeno_motor_p"):
        return np.zeros(len(columns), dtype=bool)
    return linear_motors(columns, "zeno_motor_p")


def _scales(columns: Columns) -> dict[str, Floats]:
    # turn of each joint by that of its motor where that is linear: falling clockwise
    found: dict[str, Floats] = {}
    for joint, letter in (("theta", "t"), ("phi", "p")):
        motor = f"zeno_motor_{letter}"
        if not columns.optional(motor):
            continue
        linear = linear_motors(columns, motor)
        for way, side in (("falling", "cw"), ("rising", "ccw")):
            name = f"sz_{side}_{letter}"
            if name in columns:
                scale = columns.numbers(name, missing=True)
                columns.refuse_rows(linear & ~(scale > 0.0), name, "is no scale of a linear motor")
                found[f"{joint}_scale_{way}"] = np.where(linear & (scale > 0.0), scale, 1.0)
    return found


def _newest_rows(table: Table) -> Bools:
    every = Columns(table)
    place = every.whole("location", least=0, most=MOST_ID)
    times = _moments(every)
    every.check()
    order = np.lexsort([times, place])
    last = np.append(np.diff(place[order]) != 0, True) if len(order) else np.zeros(0, bool)
    newest = np.zeros(len(order), dtype=bool)
    newest[order[last]] = True
    same = np.zeros(len(order), dtype=bool)
    ordered = (np.diff(place[order]) == 0) & (np.diff(times[order]) == np.timedelta64(0))
    same[order[1:][ordered]] = True
    every.refuse_rows(same, "time_recorded", "is the same in two rows of one robot")
    every.check()
    return newest


def _moments(columns: Columns) -> np.ndarray:
    # ISO 8601 with the offset of UTC, which numpy does not read
    words = columns.words("time_recorded")
    moments = np.zeros(len(words), dtype="datetime64[us]")
    bad = np.zeros(len(words), dtype=bool)
    for k, word in enumerate(words.tolist()):
        for ending in ("+00:00", "+0000", "Z"):
            word = word.removesuffix(ending)
        try:
            moments[k] = np.datetime64(word, "us")
        except ValueError:
            bad[k] = True
    columns.refuse_rows(bad, "time_recorded", "is not a time in UTC")
    return moments


FORMAT = Format("DESI calibration", matches, layout=layout, signs=(_SIGN,))
