# SPDX-License-Identifier: Apache-2.0
"""PFS: geometry of cobras (XML of one or several modules), and the table of interference limits.

Lengths are in pixels of Pixel_scale um. Theta counts from the CCW stop, CCW_Global_base_ori_z,
to the CW stop, one turn and the overlap further. Phi is 180 degrees less than the angle in the
file: it runs from folded, about -180 degrees, to stretched. A cobra's id is 57 (module - 1) +
its position. The interference table limits phi within a window of theta; a plane limits joints
one by one, so phi is limited for every theta.
"""

import xml.etree.ElementTree as ElementTree

import numpy as np

from fiber_core.array_types import Floats, Ids
from fiber_core.presets import PRESETS
from fiber_formats.columns import Columns
from fiber_formats.errors import FormatError
from fiber_formats.interface import Format
from fiber_formats.records import LayoutColumns
from fiber_formats.source import DataFile, Source

__all__ = ["FORMAT"]

_IN_MODULE = 57
_NOTE_SCALE = 0.05  # relative difference from the known pitch from which a notice says so
_LIMITS = ("cobra_id", "theta_limit_1", "theta_limit_2", "max_phi_angle")
_CONTAINER = "ARM_DATA_CONTAINER"  # of one cobra
_HEADER = ("Module_Id", "Positioner_Id", "Status")
_KINEMATICS = (
    "Global_base_pos_x",
    "Global_base_pos_y",
    "CCW_Global_base_ori_z",
    "CW_Global_base_ori_z",
    "Joint2_CCW_limit_angle",
    "Joint2_CW_limit_angle",
    "Link1_Link_Length",
    "Link2_Link_Length",
    "Pixel_scale",
)
_PARTS = (("DATA_HEADER", _HEADER), ("KINEMATICS", _KINEMATICS))


def matches(source: Source) -> bool:
    """Return whether one of the files is XML of cobras."""
    return any(_is_xml(file) for file in source.files)


def layout(source: Source) -> LayoutColumns:
    """Read the cobras of all modules; disabled are those with a Status other than 1."""
    values = np.concatenate([_cobras(file) for file in source.files if _is_xml(file)])
    module, position, status, x, y, ccw, cw, phi_low, phi_high, arm1, arm2, scale = values.T
    ids = (_IN_MODULE * (module - 1) + position).astype(np.int64)
    mm = scale / 1000
    phi_max = phi_high - 180
    notices = _scale_notice(np.stack([x * mm, y * mm], axis=1), mm)
    tables = [file for file in source.files if not _is_xml(file)]
    if len(tables) > 1:
        raise FormatError(f"{source.name}: one table of interference limits is read")
    for file in tables:
        limit, of_others = _phi_limits(file, ids)
        phi_max = np.fmin(phi_max, phi_low - 180 + limit)
        notices += (
            f"{np.count_nonzero(np.isfinite(limit))} robots have an interference limit: "
            "phi is limited for every theta, the file limits it only between theta_limit_1 and 2",
        )
        if of_others:
            notices += (f"interference limits of cobras that are not there: {of_others}",)
    if len(np.unique(ids)) < len(ids):
        raise FormatError(f"{source.name}: a cobra stands twice, in one module or two files")
    found = {
        "id": ids,
        "x_mm": x * mm,
        "y_mm": y * mm,
        "arm_theta_mm": arm1 * mm,
        "arm_phi_mm": arm2 * mm,
        "theta_min_deg": ccw,
        "theta_max_deg": ccw + (cw - ccw) % 360 + 360,
        "phi_min_deg": phi_low - 180,
        "phi_max_deg": phi_max,
        "enabled": status == 1,
        "petal": module.astype(np.int64),
        "bus": np.zeros(len(ids), dtype=np.int64),
    }
    notices += ("each module is taken as one bus", "motor maps and frequencies are not used")
    return LayoutColumns(found, preset="pfs", notices=notices)


def _is_xml(file: DataFile) -> bool:
    text = (file.text or "")[:4000].lstrip()
    return text.startswith("<") and "<ARM_DATA" in text


def _cobras(file: DataFile) -> Floats:
    try:
        root = ElementTree.fromstring(file.text or "")
    except (ElementTree.ParseError, ValueError) as error:
        raise FormatError(f"{file.name} is not XML: {error}") from None
    rows = []
    for number, cobra in enumerate(root):
        if cobra.tag != _CONTAINER:
            raise FormatError(f"{file.name}: {cobra.tag} stands where {_CONTAINER} is expected")
        rows.append(
            [
                _number(file.name, number, name, cobra.findall(f"{part}/{name}"))
                for part, names in _PARTS
                for name in names
            ]
        )
    if not rows:
        raise FormatError(f"{file.name} has no {_CONTAINER}")
    values = np.array(rows)
    for k, name in enumerate(_HEADER):
        whole = (values[:, k] == np.rint(values[:, k])) & (values[:, k] >= (0 if k == 2 else 1))
        if not whole.all():
            at = int(np.argmin(whole))
            raise FormatError(f"{file.name}: container {at + 1}: {name} is {values[at, k]}")
    return values


def _number(name: str, number: int, key: str, found: list[ElementTree.Element]) -> float:
    if len(found) > 1:
        raise FormatError(f"{name}: container {number + 1}: {key} stands {len(found)} times")
    text = found[0].text if found else None
    try:
        value = float("" if text is None or "_" in text else text)
    except ValueError:
        value = np.nan
    if not np.isfinite(value):
        raise FormatError(f"{name}: container {number + 1}: {key} is not a number: {text}")
    return value


def _phi_limits(file: DataFile, ids: Ids) -> tuple[Floats, list[int]]:
    # the limit of each cobra, and the cobras with a limit that are not there
    columns = Columns(file.table_with(*_LIMITS))
    cobra = columns.ids("cobra_id")
    limit = columns.numbers("max_phi_angle", "deg", missing=True)
    for name in ("theta_limit_1", "theta_limit_2"):
        lacks = np.isnan(columns.numbers(name, "deg", missing=True)) != np.isnan(limit)
        columns.refuse_rows(lacks, name, "must be given or missing with max_phi_angle")
    columns.check()
    limits = dict(zip(cobra.tolist(), limit.tolist()))
    others = cobra[np.isfinite(limit) & ~np.isin(cobra, ids)]
    return np.array([limits.get(i, np.nan) for i in ids.tolist()]), others.tolist()


def _scale_notice(centers: Floats, mm: Floats) -> tuple[str, ...]:
    if len(centers) < 2:
        return ()
    gaps = np.hypot(*np.moveaxis(centers[:, None] - centers[None], -1, 0))
    np.fill_diagonal(gaps, np.inf)
    pitch, usual = float(np.median(gaps.min(axis=1))), PRESETS["pfs"].pitch_mm
    if abs(pitch / usual - 1) < _NOTE_SCALE:
        return ()
    scale = 1000 * float(np.median(mm))
    return (
        f"neighbours stand {pitch:.2f} mm apart, {usual} mm are known: Pixel_scale is {scale:g} "
        f"um, {scale * usual / pitch:.1f} um would fit; lengths are used as the file gives them",
    )


FORMAT = Format("PFS cobras", matches, layout=layout)
