# SPDX-License-Identifier: Apache-2.0
"""Layout: a plane comes back unchanged; it travels in metres."""

from dataclasses import fields, replace

import numpy as np
import pytest

from fiber_core.drive import Drive, ListedSpeeds
from fiber_core.drive.named import DRIVES, with_drive
from fiber_core.errors import FiberError
from fiber_core.presets import preset
from fiber_core.wire_units import WireUnits
from fiber_msgs_py import MessageError, layout
from fiber_msgs_py.table import encode_table

LISTS = (
    *("phi_outline", "theta_outline", "wall", "fibres", "fibre_names", "drive"),
    *("coupling", "motor_speed", "motor_range", "border_skews"),
)
UNITS = WireUnits(tick_us=60_000, quantum_prad=4_000_000_000, velocity_bits=16, duration_bits=12)


def raw_rows(message):
    """Return the table of a message, writable, to make the messages of a faulty sender."""
    types = {2: "<u1", 4: "<u2", 6: "<u4", 8: "<f8"}
    return np.frombuffer(
        message.data,
        dtype=np.dtype(
            {
                "names": [f.name for f in message.fields],
                "formats": [
                    (types[f.datatype], (f.count,) if f.name in LISTS else ())
                    for f in message.fields
                ],
                "offsets": [f.offset for f in message.fields],
                "itemsize": message.point_step,
            }
        ),
    )


@pytest.mark.parametrize("outlined", [True, False])
@pytest.mark.parametrize("discs", [0, 2])
def test_round_trip(plane, stamp, outlined, discs):
    if not outlined:
        plane = replace(plane, theta_vertices=np.zeros((plane.n, 0, 2)))
    plane = replace(plane, obstacles=plane.obstacles[:discs])
    decoded, units = layout.decode(layout.encode(plane, UNITS, stamp))
    assert units == UNITS
    for field in fields(plane):
        if field.name in ("name", "drive"):  # the name stays, the drive has its own test
            continue
        ours, theirs = getattr(plane, field.name), getattr(decoded, field.name)
        assert np.shape(ours) == np.shape(theirs), field.name
        np.testing.assert_allclose(theirs, ours, rtol=1e-12, atol=0, err_msg=field.name)


def test_sectors_travel_where_there_are_any(plane, stamp):
    assert "sector" not in [f.name for f in layout.encode(plane, UNITS, stamp).fields]
    sector = np.arange(plane.n) % 3
    message = layout.encode(replace(plane, sector=sector), UNITS, stamp)
    np.testing.assert_array_equal(layout.decode(message)[0].sector, sector)
    with pytest.raises(MessageError, match="sector"):
        layout.encode(replace(plane, sector=sector + 2**16), UNITS, stamp)
    field = next(f for f in message.fields if f.name == "sector")
    field.count, field.offset = 2, 0
    with pytest.raises(MessageError, match="sector has 2"):
        layout.decode(message)


def test_lengths_travel_in_metres_and_angles_in_radians(plane, stamp):
    message = layout.encode(plane, UNITS, stamp)
    rows = raw_rows(message)
    assert message.width == plane.n + 2
    assert rows["kind"].tolist() == [0, 0, 0, 1, 1]
    np.testing.assert_allclose(rows["x"][:3], plane.centers[:, 0] / 1000)
    np.testing.assert_allclose(rows["arm_phi"][:3], plane.arms[:, 1] / 1000)
    np.testing.assert_allclose(rows["arm_radius"][3:], plane.obstacles[:, 2] / 1000)
    np.testing.assert_allclose(rows["phi_max"][:3], plane.limits[:, 1, 1])
    np.testing.assert_allclose(rows["theta_speed"][:3], plane.speeds[:, 0])
    np.testing.assert_allclose(rows["spacing"], plane.spacing_mm / 1000)
    np.testing.assert_allclose(rows["envelope"], plane.envelope_mm / 1000)


@pytest.mark.parametrize(
    ("column", "row", "value", "words"),
    [
        ("x", 1, np.nan, ["robot 42", "nan"]),
        ("arm_phi", 2, -0.003, ["robot 70000", "-3.0"]),
        ("theta_speed", 0, 0.0, ["robot 3", "0.0"]),
        ("phi_min", 1, 9.0, ["robot 42", "9.0"]),
        ("enabled", 1, 7, ["robot 42", "enabled", "7"]),
        ("kind", 1, 5, ["robot 42", "kind", "5"]),
        ("kind", 0, 1, ["robot 3", "kind", "1"]),
        ("id", 1, 3, ["robot 3", "twice"]),
        ("id", 0, 50, ["42", "50"]),
        ("tick_us", 2, 5, ["robot 70000", "tick_us", "5", "60000"]),
        ("spacing", 1, 0.5, ["robot 42", "spacing", "0.5", "0.004"]),
        ("envelope", 1, 0.5, ["robot 42", "envelope", "0.5", "0.005"]),
    ],
)
def test_impossible_values_are_refused(plane, stamp, column, row, value, words):
    message = layout.encode(plane, UNITS, stamp)
    raw_rows(message)[column][row] = value
    with pytest.raises(FiberError) as caught:
        layout.decode(message)
    for word in words:
        assert word in str(caught.value)


@pytest.mark.parametrize(
    ("column", "value"),
    [("tick_us", 0), ("quantum_prad", 0), ("velocity_bits", 1), ("duration_bits", 33)],
)
def test_impossible_units_are_refused(plane, stamp, column, value):
    message = layout.encode(plane, UNITS, stamp)
    raw_rows(message)[column] = value
    with pytest.raises(MessageError, match=f"{column} {value} "):
        layout.decode(message)


@pytest.mark.parametrize("field", ["bus", "address"])
@pytest.mark.parametrize("value", [-1, 65_536])
def test_what_does_not_fit_its_column_is_not_sent(plane, stamp, field, value):
    values = getattr(plane, field).copy()
    values[1] = value
    with pytest.raises(FiberError, match=rf"robot 42: {field}.* {value}"):
        layout.encode(replace(plane, **{field: values}), UNITS, stamp)


def test_units_that_do_not_fit_their_column_are_not_sent(plane, stamp):
    with pytest.raises(MessageError, match="quantum_prad 4294967296"):
        layout.encode(plane, replace(UNITS, quantum_prad=2**32), stamp)


def test_a_plane_without_robots_is_not_sent(plane, stamp):
    message = layout.encode(plane, UNITS, stamp)
    with pytest.raises(MessageError, match="has 0 robots"):
        layout.encode(plane.permuted([]), UNITS, stamp)
    raw_rows(message)["kind"] = 1
    with pytest.raises(MessageError, match="has 0 robots"):
        layout.decode(message)


def test_walls_are_rows_after_the_discs(plane, stamp):
    walls = np.array([[[0.0, 0.0], [1.5, 0.0], [1.5, 2.0]], [[9.0, 9.0], [9.0, 12.0], [9.0, 12.0]]])
    message = layout.encode(replace(plane, walls=walls), UNITS, stamp)
    found, _ = layout.decode(message)
    np.testing.assert_allclose(found.walls, walls, rtol=1e-15)
    np.testing.assert_allclose(found.obstacles, plane.obstacles, rtol=1e-15)
    rows = np.array(raw_rows(message))
    assert rows["kind"].tolist() == [0, 0, 0, 1, 1, 2, 2]
    assert "wall" not in raw_rows(layout.encode(plane, UNITS, stamp)).dtype.names
    for column, value, words in (
        ("wall", [0.0, 0.0, 0.004, 0.0, np.nan, 0.001], "wall 1: corners must be"),
        ("kind", 1, "precedes a disc"),
        ("kind", 3, "neither 0 .robot., 1 .disc. nor 2 .wall."),
    ):
        faulty = rows.copy()
        faulty[column][6] = value
        message.data = faulty.tobytes()
        with pytest.raises(MessageError, match=words):
            layout.decode(message)


def test_fibres_are_pairs_of_a_column_that_plain_planes_lack(plane, stamp):
    fibres = np.array([[[14.9, -0.36], [14.2, 0.0]]] * 3) + np.arange(3)[:, None, None]
    names = ("BOSS", "Apogée")
    message = layout.encode(replace(plane, fibres=fibres, fibre_names=names), UNITS, stamp)
    found, _ = layout.decode(message)
    np.testing.assert_allclose(found.fibres, fibres, rtol=1e-15)
    assert found.fibre_names == names
    assert not {"fibres", "fibre_names"} & set(
        raw_rows(layout.encode(plane, UNITS, stamp)).dtype.names
    )
    for row, value, words in ((1, 67, "is not that of the other rows"), (slice(None), 255, "UTF")):
        faulty = np.array(raw_rows(message))
        faulty["fibre_names"][row, 0] = value
        with pytest.raises(MessageError, match=words):
            layout.decode(encode_table(faulty, stamp))
    rows = np.array(raw_rows(message))
    rows["fibres"][1] = 0.0
    message.data = rows.tobytes()
    with pytest.raises(MessageError, match="robot 42: fibre 0 must be"):
        layout.decode(message)


def test_the_drive_travels_with_the_robots(plane, stamp):
    rng = np.random.default_rng(5)
    limit = np.where(rng.random((plane.n, 2)) < 0.3, np.inf, rng.uniform(1.0, 50.0, (plane.n, 2)))
    drive = Drive(plane.n, 0.09, limit, rng.uniform(0.0, 0.1, (plane.n, 2)))
    message = layout.encode(replace(plane, drive=drive), WireUnits(), stamp)
    got = layout.decode(message)[0].drive
    assert got.ramp_s == drive.ramp_s
    assert (got.acceleration_rad_s2 == limit).all()
    assert (got.uncertainty_rad == drive.uncertainty_rad).all()
    assert layout.decode(layout.encode(plane, WireUnits(), stamp))[0].drive.is_ideal


def test_listed_speeds_gears_and_supplies_travel_with_the_robots(plane, stamp):
    listed = ListedSpeeds(
        [3.0, 0.05], [0.02, 0.0], [0.1, 0.0], 1e-4, (0.1, 0.2), (1.0, -1.0), 1, True
    )
    rng = np.random.default_rng(6)
    drive = Drive(
        plane.n,
        name="own",
        listed=listed,
        scale=rng.uniform(0.4, 1.0, (plane.n, 2, 2)),
        lost_motion_rad=rng.uniform(0.0, 0.1, (plane.n, 2)),
        supply=np.arange(plane.n) % 2,
        motors_on=0.55,
    )
    message = layout.encode(replace(plane, drive=drive), UNITS, stamp)
    assert layout.decode(message)[0].drive == drive
    known = Drive(plane.n, name="ideal", scale=drive.scale)  # of motors of any speed
    message = layout.encode(replace(plane, drive=known), UNITS, stamp)
    assert layout.decode(message)[0].drive == known
    raw_rows(message)["drive"][1, 12] = 0.9
    with pytest.raises(MessageError, match="is not the 1.0 of the other robots"):
        layout.decode(message)


@pytest.mark.parametrize("name", DRIVES)
def test_a_named_drive_keeps_its_name(stamp, name):
    driven = with_drive(preset("desi_petals", 61), name, motors_on=0.55)
    message = layout.encode(driven, WireUnits.for_plane(driven), stamp)
    assert layout.decode(message)[0].drive == driven.drive


def test_a_drive_that_no_robot_can_have_is_refused(plane, stamp):
    drive = Drive(plane.n, 0.09, 20.0)
    for value, words in ((0.08, "is not the 0.09 of the other robots"), (-1.0, "ramp")):
        message = layout.encode(replace(plane, drive=drive), WireUnits(), stamp)
        raw_rows(message)["drive"][1 if value > 0 else slice(None), 0] = value
        with pytest.raises(MessageError, match=words):
            layout.decode(message)


def test_gears_are_numbers_of_columns_that_plain_planes_lack(plane, stamp):
    gears = np.array([[1.0, 0.0], [-1.5, 1.5]]) + 0.1 * np.arange(3)[:, None, None]
    coupled = replace(
        plane, coupling=gears, motor_speeds=[[3.0, 2.0]] * 3, motor_limits=[[[-4, 4], [0, 9]]] * 3
    )
    message = layout.encode(coupled, UNITS, stamp)
    found, _ = layout.decode(message)
    for name in ("coupling", "motor_speeds", "motor_limits"):
        np.testing.assert_array_equal(getattr(found, name), getattr(coupled, name))
    names = raw_rows(layout.encode(plane, UNITS, stamp)).dtype.names
    assert not {"coupling", "motor_speed", "motor_range"} & set(names)
    rows = np.array(raw_rows(message))
    rows["motor_speed"][1] = np.nan
    message.data = rows.tobytes()
    with pytest.raises(MessageError, match="robot 42: motor_speeds must be"):
        layout.decode(message)
    rows = raw_rows(layout.encode(coupled, UNITS, stamp))
    short = encode_table(without_last_number(rows, "coupling"), stamp)
    with pytest.raises(MessageError, match="coupling has .*3 numbers, expected 4"):
        layout.decode(short)


def without_last_number(rows, name):
    types = [
        (n, rows.dtype[n].base, (rows.dtype[n].shape[0] - (n == name),))
        if rows.dtype[n].shape
        else (n, rows.dtype[n])
        for n in rows.dtype.names
    ]
    changed = np.zeros(len(rows), dtype=types)
    for n in rows.dtype.names:
        changed[n] = rows[n][:, :-1] if n == name else rows[n]
    return changed


def test_robots_at_unknown_places_travel_with_the_layout(plane, stamp):
    told = np.zeros(plane.n, dtype=int)
    assert not layout.decode_unplaced(layout.encode(plane, UNITS, stamp)).any()
    told[:3] = 1, layout.RECALLED, layout.SEEN
    message = layout.encode(plane, UNITS, stamp, unplaced=told)
    np.testing.assert_array_equal(layout.decode_unplaced(message), told)
    np.testing.assert_array_equal(layout.decode(message)[0].ids, plane.ids)
    told[1] = 4
    wrong = layout.encode(plane, UNITS, stamp, unplaced=told)
    with pytest.raises(MessageError, match=f"robot {plane.ids[1]}.*unplaced"):
        layout.decode_unplaced(wrong)


def test_the_skews_that_sectors_need_travel_with_the_layout(plane, stamp):
    assert layout.decode_border_skews(layout.encode(plane, UNITS, stamp)) == (0.0, 0.0)
    message = layout.encode(plane, UNITS, stamp, border_skews_s=(2.2e-3, 27e-3))
    assert layout.decode_border_skews(message) == (2.2e-3, 27e-3)
    np.testing.assert_array_equal(layout.decode(message)[0].ids, plane.ids)


@pytest.mark.parametrize("wrong", [-1e-3, np.nan, np.inf, 20e-3])
def test_skews_of_sectors_that_are_no_times_or_differ_are_refused_by_robot(plane, stamp, wrong):
    rows = raw_rows(layout.encode(plane, UNITS, stamp, border_skews_s=(2.2e-3, 27e-3))).copy()
    rows["border_skews"][1, 1] = wrong
    with pytest.raises(MessageError, match=f"robot {plane.ids[1]}.*border_skews"):
        layout.decode_border_skews(encode_table(rows, stamp))
