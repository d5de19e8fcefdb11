# SPDX-License-Identifier: Apache-2.0
"""Layout: the robots and obstacles of the focal plane, and the units of its orders."""

from enum import IntEnum

import numpy as np
from sensor_msgs.msg import PointCloud2

from fiber_core.array_types import Floats, Ints
from fiber_core.drive import Drive, ListedSpeeds
from fiber_core.drive.named import with_name
from fiber_core.errors import LayoutError
from fiber_core.focal_plane import FocalPlane
from fiber_core.wire_units import WireUnits
from fiber_msgs_py.errors import MessageError
from fiber_msgs_py.ids import checked_ids, refuse
from fiber_msgs_py.stamps import PlanStamp
from fiber_msgs_py.table import column_names, decode_table, encode_table

__all__ = [
    "RECALLED",
    "SEEN",
    "RowKind",
    "decode",
    "decode_border_skews",
    "decode_unplaced",
    "encode",
]

# of a robot whose counters do not tell its place: they read where it rested before; a camera has
# told all but the turn of theta
RECALLED, SEEN = 2, 3


class RowKind(IntEnum):
    """What a row of the layout describes: robots come first, then fixed discs, then walls."""

    ROBOT = 0
    DISC = 1
    WALL = 2


_ROBOT, _DISC, _WALL = RowKind
# lengths [m]
_METRES = ("x", "y", "arm_theta", "arm_phi", "arm_radius", "theta_radius", "spacing", "envelope")
# angles [rad] and speeds [rad/s]
_RADIANS = ("theta_min", "theta_max", "phi_min", "phi_max", "theta_speed", "phi_speed")
# with the same value in every row
_UNITS = {"tick_us": "<u4", "quantum_prad": "<u4", "velocity_bits": "<u1", "duration_bits": "<u1"}
_COLUMNS = (
    {"id": "<u4", "kind": "<u1", "enabled": "<u1", "bus": "<u2", "address": "<u2"}
    | dict.fromkeys(_METRES + _RADIANS, "<f8")
    | _UNITS
)
# vertices or places x0, y0, x1, y1, ... [m]; a theta link without an outline, a plane without walls
# and robots whose only fibre is at the tip have no such column
_OUTLINES = {"phi_outline": "<f8", "theta_outline": "<f8", "wall": "<f8", "fibres": "<f8"}
# the ramp [s], then of theta and phi the accelerations [rad/s2], 0 where unlimited, and the
# uncertainties [rad]; a plane with an ideal drive has no such column
# then of theta and phi the lost motion [rad], the scales (falling, rising), the supply, -1 for that
# of the bus, the share of motors that may be on, and the numbers of the list of speeds, if any
_DRIVE = {"drive": "<f8"}
_DRIVE_NUMBERS = 13
# a plane of one sector has no such column
_SECTOR = {"sector": "<u2"}
# the skews of start and stop that robots of two sectors need [s], the same in every row; a plane
# of one sector has no such column
_BORDER = {"border_skews": "<f8"}
# 1 of a robot at an unknown place, RECALLED or SEEN, else 0; a plane of robots at known places has
# no such column
_UNPLACED = {"unplaced": "<u1"}
# the names of the fibres in UTF-8, a line each, the same in every row
_NAMES = {"fibre_names": "<u1"}
# of robots with coupled joints: the rows of the matrix, the speeds [rad/s], and low, high [rad]
_MOTORS = {"coupling": "<f8", "motor_speed": "<f8", "motor_range": "<f8"}

_LISTS = _OUTLINES | _DRIVE | _MOTORS | _NAMES | _SECTOR | _BORDER | _UNPLACED


def encode(
    plane: FocalPlane,
    units: WireUnits,
    stamp: PlanStamp,
    session: str | None = None,
    unplaced: Ints | None = None,
    border_skews_s: tuple[float, float] | None = None,
) -> PointCloud2:
    """Return a focal plane and its wire units as a message, without the name of the plane.

    Args:
        plane: the focal plane.
        units: size of tick and quantum, widths of the fields.
        stamp: time of the layout.
        session: id of the session that the bridge has opened.
        unplaced: 0 for robots at known places, else 1, RECALLED or SEEN, shape (n,); None for no
            robot at an unknown place.
        border_skews_s: skews of start and stop that robots of two sectors need [s]; None for a
            plane of one sector.

    Raises:
        MessageError: no robot, or an id, bus, address or unit does not fit its column.
    """
    if plane.n == 0:
        raise MessageError("layout", "robots, expected at least 1", field="has", value=0)
    ids = checked_ids(plane.ids, "layout")
    n, discs, vertices = plane.n, plane.obstacles, _vertices_of(plane)
    outlines = [(name, "<f8", (2 * v.shape[1],)) for name, v in vertices.items() if v.shape[1]]
    corners = [("wall", "<f8", (2 * plane.walls.shape[1],))] if len(plane.walls) else []
    drive = None if plane.drive.is_plain else _drive_numbers(plane.drive)
    drives = [] if drive is None else [("drive", "<f8", (drive.shape[1],))]
    motors = {
        "coupling": plane.coupling,
        "motor_speed": plane.motor_speeds,
        "motor_range": plane.motor_limits,
    }
    gears = [(name, "<f8", (v[0].size,)) for name, v in motors.items() if v.shape[1]]
    names = np.frombuffer("\n".join(plane.fibre_names).encode(), np.uint8)
    named = [("fibre_names", "<u1", (len(names),))] if len(names) else []
    if border_skews_s is not None:
        named.append(("border_skews", "<f8", (2,)))
    numbers = {"id": ids, "bus": plane.bus, "address": plane.address}
    if plane.sector.any():
        numbers["sector"], named = plane.sector, [*named, *_SECTOR.items()]
    if unplaced is not None and unplaced.any():
        numbers["unplaced"], named = unplaced, [*named, *_UNPLACED.items()]
    dtype = [*_COLUMNS.items(), *outlines, *corners, *drives, *gears, *named]
    rows = np.zeros(n + plane.fixtures, dtype=dtype)
    robots, fixed, walls = np.split(rows, [n, n + len(discs)])
    robots["kind"], robots["enabled"] = _ROBOT, plane.enabled
    for name, values in numbers.items():
        robots[name] = values
        refuse(robots[name] != values, "layout", name, ids, values, "does not fit 16 bits")
    for name, values in {
        "x": plane.centers[:, 0],
        "y": plane.centers[:, 1],
        "arm_theta": plane.arms[:, 0],
        "arm_phi": plane.arms[:, 1],
        "arm_radius": plane.phi_radius,
        "theta_radius": plane.theta_radius,
    }.items():
        robots[name] = values / 1e3
    for name, _, (width,) in outlines:
        robots[name] = vertices[name].reshape(n, width) / 1e3
    if len(names):
        rows["fibre_names"] = names
    if border_skews_s is not None:
        rows["border_skews"] = border_skews_s
    for name, _, (width,) in gears:
        robots[name] = motors[name].reshape(n, width)
    robots["theta_min"], robots["theta_max"] = plane.limits[:, 0].T
    robots["phi_min"], robots["phi_max"] = plane.limits[:, 1].T
    robots["theta_speed"], robots["phi_speed"] = plane.speeds.T
    if drive is not None:
        robots["drive"] = drive
    fixed["kind"], fixed["id"] = _DISC, np.arange(len(discs))
    fixed["x"], fixed["y"], fixed["arm_radius"] = discs.T / 1e3
    walls["kind"], walls["id"] = _WALL, np.arange(len(walls))
    if len(walls):
        walls["wall"] = plane.walls.reshape(len(walls), -1) / 1e3
    rows["spacing"], rows["envelope"] = plane.spacing_mm / 1e3, plane.envelope_mm / 1e3
    _fill_units(rows, units)
    return encode_table(rows, stamp, session)


def _fill_units(rows: np.ndarray, units: WireUnits) -> None:
    for name in _UNITS:
        value = getattr(units, name)
        if not 0 < value <= np.iinfo(rows[name].dtype).max:
            raise MessageError("layout", "does not fit its column", field=name, value=value)
        rows[name] = value


def decode_unplaced(message: PointCloud2) -> Ints:
    """Return which robots of a layout are at unknown places.

    Returns:
        0 for a robot at a known place, else 1, RECALLED or SEEN, shape (n,).

    Raises:
        MessageError: the table is malformed, or a number is another one.
    """
    rows = decode_table(message, "layout", {"id": "<u4", "kind": "<u1"}, lists=_UNPLACED)
    robots = rows[rows["kind"] == _ROBOT]
    if "unplaced" not in column_names(rows):
        return np.zeros(len(robots), dtype=np.int64)
    values = robots["unplaced"]
    if values.shape[1] != 1:
        raise MessageError(
            "layout", "numbers, expected 1", field="unplaced has", value=values.shape[1]
        )
    bad = values[:, 0] > SEEN
    refuse(bad, "layout", "unplaced", robots["id"], values[:, 0], "is none of 0 to 3")
    return values[:, 0].astype(np.int64)


def decode_border_skews(message: PointCloud2) -> tuple[float, float]:
    """Return the skews of start and stop that robots of two sectors need [s], 0 without sectors.

    Raises:
        MessageError: the table is malformed, or a skew is negative, not finite or not the same in
            all rows.
    """
    rows = decode_table(message, "layout", {"id": "<u4", "kind": "<u1"}, lists=_BORDER)
    if "border_skews" not in column_names(rows) or len(rows) == 0:
        return 0.0, 0.0
    skews_s = rows["border_skews"]
    if skews_s.shape[1] != 2:
        raise MessageError(
            "layout", "numbers, expected 2", field="border_skews has", value=skews_s.shape[1]
        )
    for k in range(2):
        values = skews_s[:, k]
        bad = ~(np.isfinite(values) & (values >= 0.0) & (values == values[0]))
        why = f"is no time, or not the {values[0]:g} s of the other rows"
        refuse(bad, "layout", "border_skews", rows["id"], values, why)
    return float(skews_s[0, 0]), float(skews_s[0, 1])


def _vertices_of(plane: FocalPlane) -> dict[str, Floats]:
    return {
        "phi_outline": plane.phi_vertices,
        "theta_outline": plane.theta_vertices,
        "fibres": plane.fibres,
    }


def decode(message: PointCloud2) -> tuple[FocalPlane, WireUnits]:
    """Return the focal plane and the wire units of a message.

    Raises:
        MessageError: malformed table, rows of an unknown kind or out of order, a robot twice,
            a value that differs between rows and must not, or a value that is not possible for a
            robot; names robot and value.
    """
    rows = decode_table(message, "layout", _COLUMNS, lists=_LISTS)
    kind, ids = rows["kind"], rows["id"]
    why = "is neither 0 (robot), 1 (disc) nor 2 (wall)"
    refuse(kind > _WALL, "layout", "kind", ids, kind, why)
    n = int(np.count_nonzero(kind == _ROBOT))
    if n == 0:
        raise MessageError("layout", "robots, expected at least 1", field="has", value=0)
    refuse(kind[:n] != _ROBOT, "layout", "kind", ids, kind, "comes before the last robot")
    discs = int(np.count_nonzero(kind == _DISC))
    refuse(kind[n : n + discs] != _DISC, "layout", "kind", ids[n:], kind[n:], "precedes a disc")
    for name in (*_UNITS, "spacing", "envelope"):
        changed = rows[name] != rows[name][0]
        refuse(
            changed,
            "layout",
            name,
            ids,
            rows[name],
            f"is not the {rows[name][0]} of the other rows",
        )
    robots, fixed, walls = np.split(rows, [n, n + discs])
    checked_ids(robots["id"], "layout")
    refuse(robots["enabled"] > 1, "layout", "enabled", ids, robots["enabled"], "is neither 0 nor 1")
    try:
        with np.errstate(over="ignore", invalid="ignore"):  # what is infinite in mm is refused
            return with_name(_plane(robots, fixed, walls)), _units(rows[0])
    except LayoutError as error:
        raise MessageError("layout", f"is not a focal plane: {error}") from None


def _plane(robots: np.ndarray, fixed: np.ndarray, walls: np.ndarray) -> FocalPlane:
    n = len(robots)
    return FocalPlane(
        ids=robots["id"],
        centers=_stacked(robots, "x", "y") * 1e3,
        arms=_stacked(robots, "arm_theta", "arm_phi") * 1e3,
        limits=_stacked(robots, "theta_min", "theta_max", "phi_min", "phi_max").reshape(n, 2, 2),
        speeds=_stacked(robots, "theta_speed", "phi_speed"),
        phi_vertices=_vertices(robots, "phi_outline"),
        phi_radius=robots["arm_radius"] * 1e3,
        theta_vertices=_vertices(robots, "theta_outline"),
        theta_radius=robots["theta_radius"] * 1e3,
        enabled=robots["enabled"],
        obstacles=_stacked(fixed, "x", "y", "arm_radius") * 1e3,
        walls=_vertices(walls, "wall") if len(walls) else None,
        bus=robots["bus"],
        address=robots["address"],
        spacing_mm=float(robots["spacing"][0]) * 1e3,
        envelope_mm=float(robots["envelope"][0]) * 1e3,
        fibres=_vertices(robots, "fibres"),
        fibre_names=_names(robots),
        drive=_drive(robots),
        coupling=_of_motors(robots, "coupling", 2),
        motor_speeds=_of_motors(robots, "motor_speed", 1),
        motor_limits=_of_motors(robots, "motor_range", 2),
        sector=_sector(robots),
    )


def _sector(robots: np.ndarray) -> np.ndarray | None:
    if "sector" not in column_names(robots):
        return None
    values = robots["sector"]
    if values.shape[1] != 1:
        raise MessageError(
            "layout", "numbers, expected 1", field="sector has", value=values.shape[1]
        )
    return values[:, 0]


def _drive_numbers(drive: Drive) -> Floats:
    limit, n = drive.acceleration_rad_s2, drive.n
    columns = [
        np.full((n, 1), drive.ramp_s),
        np.where(np.isinf(limit), 0.0, limit),
        drive.uncertainty_rad,
        drive.lost_motion_rad,
        drive.scale.reshape(n, 4),
        np.full((n, 1), -1.0) if drive.supply is None else drive.supply[:, None],
        np.full((n, 1), drive.motors_on),
    ]
    if drive.listed is not None:
        numbers = drive.listed.numbers
        columns.append(np.broadcast_to(numbers, (n, len(numbers))))
    return np.hstack(columns)


def _drive(robots: np.ndarray) -> Drive | None:
    # the drive of the robots, None where the layout has none
    if "drive" not in column_names(robots):
        return None
    numbers = robots["drive"]
    if numbers.shape[1] < _DRIVE_NUMBERS:
        why = f"numbers, expected {_DRIVE_NUMBERS} or more"
        raise MessageError("layout", why, field="drive has", value=numbers.shape[1])
    ramp, acceleration, uncertainty, lost, scale, supply, on, listed = np.split(
        numbers, np.cumsum([1, 2, 2, 2, 4, 1, 1]), axis=1
    )
    for value in (ramp, on, *listed.T[:, :, None]):
        why = f"is not the {value[0, 0]} of the other robots"
        refuse(value[:, 0] != value[0, 0], "layout", "drive", robots["id"], value[:, 0], why)
    of_bus = supply[:, 0] == -1.0
    return Drive(
        len(robots),
        float(ramp[0, 0]),
        np.where(acceleration == 0.0, np.inf, acceleration),
        uncertainty,
        "own",
        ListedSpeeds.of_numbers(listed[0]) if listed.shape[1] else None,
        scale.reshape(-1, 2, 2),
        lost,
        None if of_bus.all() else supply[:, 0],
        float(on[0, 0]),
        robots["id"],
    )


def _stacked(rows: np.ndarray, *names: str) -> Floats:
    return np.stack([rows[name] for name in names], axis=1)


def _vertices(rows: np.ndarray, name: str) -> Floats:
    if name not in column_names(rows):
        return np.zeros((len(rows), 0, 2))
    values = rows[name]
    if values.shape[1] % 2:
        raise MessageError(
            "layout", "numbers, expected pairs", field=f"{name} has", value=values.shape[1]
        )
    return values.reshape(len(rows), -1, 2) * 1e3


def _names(rows: np.ndarray) -> tuple[str, ...] | None:
    if "fibre_names" not in column_names(rows):
        return None
    text = rows["fibre_names"]
    why = "is not that of the other rows"
    refuse(text != text[0], "layout", "fibre_names", rows["id"], text, why)
    try:
        return tuple(text[0].tobytes().decode().split("\n"))
    except UnicodeDecodeError:
        value = text[0].tolist()
        raise MessageError("layout", "is no UTF-8", field="fibre_names", value=value) from None


def _of_motors(rows: np.ndarray, name: str, each: int) -> Floats | None:
    # numbers of both coupled motors, `each` of either; None without the column
    if name not in column_names(rows):
        return None
    values = rows[name]
    if values.shape[1] != 2 * each:
        raise MessageError(
            "layout", f"numbers, expected {2 * each}", field=f"{name} has", value=values.shape[1]
        )
    return values.reshape(len(rows), 2, 2) if each == 2 else values


def _units(row: np.void) -> WireUnits:
    values = {name: int(row[name]) for name in _UNITS}
    for name, value in values.items():
        low, high = (2, 32) if name.endswith("_bits") else (1, 2**32 - 1)
        if not low <= value <= high:
            raise MessageError("layout", f"is outside {low}..{high}", field=name, value=value)
    return WireUnits(**values)
