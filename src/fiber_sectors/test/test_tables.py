# SPDX-License-Identifier: Apache-2.0
"""Calls and their columns: what is malformed is refused, and ends nothing."""

import io
import json
import zipfile

import numpy as np
import pytest
from plane_of_sectors import PlaneOfSectors, turning

from fiber_core.errors import MotionError
from fiber_core.outcomes import Outcome
from fiber_sectors import Beat, Order, Report, SectorError, Stage, decode_beat, decode_report
from fiber_sectors.calls import Kind, decode_call, encode_call, number_of
from fiber_sectors.messages import encode_beat, encode_report
from fiber_sectors.tables import (
    loaded_of,
    motion_columns,
    motion_of,
    place_columns,
    table_of,
    take_places,
    take_table,
)
from fiber_sectors.traffic import traffic_columns, traffic_of

pytestmark = pytest.mark.timeout(600)


@pytest.fixture(scope="module")
def plane():
    made = PlaneOfSectors()
    made.session.configure(0.0)
    yield made
    made.close()


def wrong_columns(columns, rng):
    """Columns with one that is missing, or of other values, types or shapes."""
    name = list(columns)[rng.integers(len(columns))]
    values = np.asarray(columns[name])
    wrong = [
        values.astype(complex),
        values.astype(str),
        values.astype(np.float32) * np.nan,
        np.full_like(values, 2**62, dtype=np.int64),
        np.full_like(values, -(2**62), dtype=np.int64),
        np.full_like(values, np.inf, dtype=float),
        values[..., None],
        np.zeros((3, 0, 2)),
        np.zeros(0, dtype=values.dtype),
        np.array(7, dtype=values.dtype if values.dtype.kind in "iuf" else np.int64),
        values.ravel()[:-1],
        np.frombuffer(b'{"0": []}', dtype=np.uint8),
        np.frombuffer(b"[" * 100_000, dtype=np.uint8),
        np.zeros(values.shape, dtype=[("a", "i8"), ("b", "f8")]),
    ]
    changed = dict(columns)
    choice = rng.integers(len(wrong) + 1)
    if choice == len(wrong):
        del changed[name]
    else:
        changed[name] = wrong[choice]
    return changed


def test_malformed_columns_raise_our_error_and_change_nothing(plane):
    rng, c = np.random.default_rng(0), plane.session.protocol
    sector = plane.sectors[1]
    sector._session.configure(0.0)
    traffic = sector._session.transactions.take_traffic()
    rows, buses = plane.session.sectors.rows[1], plane.session.sectors._buses[1]
    told = table_of(sector._session)
    motion = motion_columns(turning(sector._session))
    loaded, places = sector._loaded(), place_columns(c, rows)
    take_table(c, rows, buses, told, ("cause", "verified", "reason", "arrived"))
    before, refused = c.robots.copy(), 0
    readers = [
        (told, lambda each: take_table(c, rows, buses, each, ("cause", "reason"))),
        (motion, lambda each: motion_of(plane.units, each)),
        (loaded, loaded_of),
        (places, lambda each: take_places(sector._session, each, np.arange(len(rows)))),
        ({"run": np.array(5)}, lambda each: number_of(each, "run", "i8", 1)),
        (traffic_columns(traffic), lambda each: traffic_of(each, np.arange(6))),
    ]
    with np.errstate(invalid="ignore"):
        for _ in range(600):
            columns, read = readers[rng.integers(len(readers))]
            try:
                read(wrong_columns(columns, rng))
            except (SectorError, MotionError):
                refused += 1
    assert refused > 350
    np.testing.assert_array_equal(c.robots["counts"], before["counts"])
    np.testing.assert_array_equal(c.robots["known"], before["known"])


@pytest.mark.parametrize("name", ["robot_counts", "robot_velocity", "counters"])
def test_a_column_with_a_wrong_value_is_named(plane, name):
    rows, buses = plane.session.sectors.rows[0], plane.session.sectors._buses[0]
    told = table_of(plane.sectors[0]._session)
    told[name] = {
        "robot_counts": np.full((len(rows), 2), 2**40),
        "robot_velocity": np.full((len(rows), 2), np.nan),
        "counters": np.frombuffer(json.dumps({"0": {"frames": float("nan")}}).encode(), np.uint8),
    }[name]
    with pytest.raises(SectorError, match=name):
        take_table(plane.session.protocol, rows, buses, told)


def mutated(data, other, rng):
    changed = bytearray(data)
    for _ in range(rng.integers(1, 4)):
        kind = rng.integers(4)
        if kind == 0:
            changed[rng.integers(len(changed))] ^= 1 << rng.integers(8)
        elif kind == 1:
            del changed[rng.integers(len(changed)) :]
        elif kind == 2:
            changed += rng.bytes(int(rng.integers(1, 9)))
        else:
            changed[rng.integers(len(changed)) :] = other[rng.integers(len(other)) :]
        changed = changed or bytearray(b"F")
    return bytes(changed)


def test_mutated_bytes_raise_our_error_or_are_messages():
    rng, refused = np.random.default_rng(1), 0
    valid = [
        (encode_call(1, Kind.TABLE, 7, {"a": np.arange(30), "b": np.array(True)}), decode_call),
        (encode_beat(Beat(5, 3, Order.MOVE, 1.5, (7, 0), (0.2, 1.0), (2.0, 3.0))), decode_beat),
        (encode_report(Report(1, 4, 5, Stage.READY, 0.2, 1.5, 0.1, 2.0)), decode_report),
    ]
    for _ in range(3000):
        (data, decode), (other, _) = (valid[k] for k in rng.integers(len(valid), size=2))
        try:
            decode(mutated(data, other, rng))
        except SectorError:
            refused += 1
    assert refused > 2000


@pytest.mark.parametrize("wrong", [np.inf, -np.inf, np.nan, 1e300])
def test_times_that_are_not_finite_are_refused(wrong):
    with pytest.raises(SectorError, match="time"):
        decode_beat(encode_beat(Beat(5, 3, Order.GO, wrong, (7,), (0.2,), (2.0,))))
    with pytest.raises(SectorError, match="time"):
        decode_report(encode_report(Report(1, 4, 5, Stage.READY, wrong, 1.5, 0.1, 2.0)))
    if not np.isnan(wrong):
        with pytest.raises(SectorError, match="time"):
            decode_beat(encode_beat(Beat(5, 3, Order.GO, 1.0, (7,), (0.2,), (wrong,))))
    with pytest.raises(SectorError):
        decode_report(encode_report(Report(1, 4, 5, Stage.READY, 0.2, 1.5, wrong, 2.0)))


def test_few_bytes_do_not_become_many():
    body = io.BytesIO()
    with zipfile.ZipFile(body, "w", zipfile.ZIP_DEFLATED) as file:
        file.writestr("a.npy", b"\x00" * 10_000_000)
    data = encode_call(1, Kind.TABLE, 7, {})
    with pytest.raises(SectorError, match="compressed"):
        decode_call(data[: data.index(b"PK")] + body.getvalue())


def test_a_sector_refuses_malformed_calls_and_goes_on(plane):
    rng, session = np.random.default_rng(2), plane.session
    motion = motion_columns(turning(plane.sectors[0]._session))
    run = {"run": np.array(session.sectors.next_number())}
    places = place_columns(session.protocol, session.sectors.rows[0])
    vouch = places | {"ids": plane.plane.ids[:2]}
    with np.errstate(invalid="ignore"):
        calls = [(Kind.PREPARE, motion), (Kind.PREPARE, motion | {"run": np.array("a")})]
        calls += [(Kind.PREPARE, run | wrong_columns(motion, rng)) for _ in range(20)]
        calls += [(Kind.CONFIGURE, wrong_columns(places, rng)) for _ in range(20)]
        calls += [(Kind.VOUCH, wrong_columns(vouch, rng)) for _ in range(20)]
    for kind, columns in calls:
        plane.sectors[0].inbox.put(encode_call(0, kind, session.sectors.next_number(), columns))
        plane.sectors[0].inbox.put(encode_call(0, kind, 1, columns))  # an old number
    session.configure(0.0)
    assert session.known.all()
    session.submit(turning(session, ticks=20))
    session.start(session.transactions.now_s)
    plane.until_rest()
    assert (session.result.outcome == Outcome.REACHED).all()


def test_a_coordinator_takes_a_malformed_answer_for_none(plane, monkeypatch):
    session = plane.session
    session.configure(session.transactions.now_s)
    told = plane.sectors[1]._loaded
    monkeypatch.setattr(plane.sectors[1], "_loaded", lambda: told() | {"robot_state": np.zeros(3)})
    session.submit(turning(session, ticks=20, velocity=-300))
    session.start(session.transactions.now_s)
    plane.until_rest()
    of_one = plane.plane.sector == 1
    assert len(session.result.outcome) == plane.plane.n
    assert (session.result.outcome[of_one] != Outcome.REACHED).all()
    assert (session.result.outcome[~of_one] == Outcome.REACHED).any()
    monkeypatch.undo()
    session.clear(session.transactions.now_s)
    assert session.known.all()
