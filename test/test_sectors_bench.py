# SPDX-License-Identifier: Apache-2.0
"""The commands that measure sectors fail when a promise is broken."""

import json
import math
from dataclasses import replace
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest

from fiber_bus_bridge.simulation import Event, Movements
from fiber_core.clearance import Safety
from fiber_core.presets import preset
from fiber_core.wire_units import WireUnits

GOOD = {
    "start_skew_ms_max": 0.03, "start_skew_bound_ms": 0.14, "contacts": 0, "unverified": 0,
    "without_outcome": 0, "stop_ms_max": 3.0, "stop_bound_ms": 27.0,
}  # fmt: skip
NEXT = {"next_asked": 30, "next_reached": 30}
TICK_S, LASTS = 4e-3, 100


@pytest.fixture(scope="module")
def bench():
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(Path(__file__).parents[1] / "bench")
        yield import_module


@pytest.mark.parametrize(
    ("name", "value", "found"),
    [
        ("contacts", 1, ["contacts"]),
        ("unverified", 1, ["unverified"]),
        ("without_outcome", 1, ["without_outcome"]),
        ("start_skew_ms_max", 0.2, ["start_skew"]),
        ("start_skew_ms_max", math.nan, ["start_skew"]),
        ("stop_ms_max", 27.1, ["stop"]),
        ("contacts", 0, []),
    ],
)
def test_each_broken_promise_ends_the_command_with_an_error(
    bench, monkeypatch, capsys, name, value, found
):
    sectors = bench("sectors")
    monkeypatch.setattr(sectors, "_measure", lambda args: GOOD | {name: value})
    assert sectors.main([]) == bool(found)
    assert json.loads(capsys.readouterr().out)["broken"] == found
    assert bench("sector_faults").broken_in(GOOD | NEXT | {name: value}) == found


@pytest.mark.parametrize("reached", [0, 26, 27])
def test_a_campaign_fails_when_the_next_reconfiguration_does_not_come_about(bench, reached):
    broken_in = bench("sector_faults").broken_in
    line = GOOD | {"next_asked": 30, "next_reached": reached}
    assert broken_in(line) == ([] if reached == 27 else ["next"])
    assert broken_in(GOOD | {"next_asked": 0, "next_reached": 0}) == ["next"]


def moves_of(*moves):
    """Movements of theta alone: row, start, end."""
    row, started_s, ended_s = (np.array(each) for each in zip(*moves))
    ticks = np.zeros((len(row), 2, 1), dtype=np.int64)
    ticks[:, 0] = LASTS
    counts = np.array([[1, 0]] * len(row))
    tick_s = np.full(len(row), TICK_S)
    return Movements(row, started_s, ended_s, tick_s, counts, ticks, *(0 * ticks,) * 2)


def test_what_lies_beyond_an_order_is_no_part_of_it(bench):
    ticks = np.array([[[100, 50], [80, 70]]] * 2)
    counts = np.array([[1, 1], [2, 1]])  # the first order has one segment a joint
    moves = Movements(
        np.arange(2),
        np.zeros(2),
        np.full(2, 0.4),
        np.full(2, 4e-3),
        counts,
        ticks,
        ticks,
        0 * ticks,
    )
    broken_off = bench("sector_judge").broken_off
    np.testing.assert_array_equal(broken_off(moves, 9.0), [False, True])


def judged(bench, first, second, told, verified=True, sector=(0, 1)):
    """The verdict of what two robots, each a sector, have done: their starts and ends."""
    judge = bench("sector_judge")
    plane = preset("desi", 2)
    plane = replace(plane, sector=np.array(sector))
    found = []
    for k, own in enumerate((first, second)):
        moves = moves_of(*((0, *each) for each in own))
        seen = np.full(len(own), verified)
        found.append(judge.Moved(np.array([k]), np.zeros((1, 2), np.int64), moves, seen, 9.0))
    starts = [judge.Start(at_s, (0, 1), (0, 1)) for at_s in told]
    return judge.judge(plane, WireUnits.for_plane(plane), found, starts)


@pytest.mark.parametrize("late_s", [0.0, 1e-3, 6e-3, 0.5])
def test_a_sector_that_starts_late_is_late_in_its_start_by_any_time(bench, late_s):
    # the second sector took no part in a start between
    second = [(1.0, 1.4), (3.0 + late_s, 3.4 + late_s)]
    verdict = judged(bench, [(1.0, 1.4), (2.0, 2.4), (3.0, 3.4)], second, [1.0, 2.0, 3.0])
    assert verdict.start_skew_ms == pytest.approx(1e3 * late_s)
    assert verdict.unverified == 0


@pytest.mark.parametrize(
    ("second", "stop_ms"),
    [
        ([(1.0, 1.4)], 200.0),  # arrives, when the first was broken off
        ([(1.0, 1.21)], 10.0),
        ([(1.0, 0.99)], 200.0),  # its countdown was ended: the first has moved alone
        ([], 200.0),  # the same without a countdown
    ],
)
def test_the_stop_lasts_until_the_last_robot_of_a_start_rests(bench, second, stop_ms):
    verdict = judged(bench, [(0.5, 0.9), (1.0, 1.2)], [(0.5, 0.9), *second], [0.5, 1.0])
    assert verdict.stop_ms == pytest.approx(stop_ms)


def test_a_robot_that_stands_still_among_others_of_its_sector_is_seen(bench):
    first, second = [(0.5, 0.9), (1.0, 1.4)], [(0.5, 0.9)]
    verdict = judged(bench, first, second, [0.5, 1.0], sector=(0, 0))
    assert verdict.stop_ms == pytest.approx(400.0)


def test_a_robot_that_does_not_start_is_seen_on_a_plane(bench):
    sectors, rng = bench("sectors"), np.random.default_rng(0)
    first = sectors.problem_of(60, 2, 0)
    problem = bench("sector_plane").near_problem(first.plane, first.start, rng)
    orders = sectors.make_orders(problem)
    row = int(np.flatnonzero(orders.wire.moves & (problem.plane.sector == 1))[0])
    own = int((problem.plane.sector[:row] == 1).sum())

    def carried_out(fault):
        plane = sectors._Plane(problem, 2, 0, fault=fault)
        session = plane.session
        session.configure(0.0)
        session.submit(orders.wire, problem.targets)
        session.start(0.0)
        start_s = session.loaded_plan.start_s
        sectors._run(session)
        verdict, _ = plane.truth()
        plane.close()
        return verdict, start_s

    verdict, start_s = carried_out(None)
    assert verdict.stop_ms == 0.0
    # it has confirmed the countdown, and loses its power just before the motion
    verdict, _ = carried_out((1, own, start_s - 1e-3, Event.POWER))
    assert 0.0 < verdict.stop_ms <= 1e3 * Safety().border_stop_skew_s
    assert verdict.contacts == verdict.unverified == 0


def test_what_a_process_says_about_its_failure_is_kept(bench, tmp_path, monkeypatch):
    faults, plane = bench("sector_faults"), bench("sector_plane")
    log = tmp_path / "log"

    def fails(text):
        raise ValueError(text)

    process = plane.CONTEXT.Process(target=plane.logged, args=(fails, log, "a bad value"))
    process.start()
    process.join()
    assert process.exitcode == 1 and "ValueError: a bad value" in log.read_text()
    line = GOOD | NEXT | {"errors": log.read_text().splitlines()}
    assert faults.broken_in(line) == ["errors"]
    assert faults.broken_in({"error": "no plant"}) == ["error"]


def test_the_table_of_a_campaign_says_what_was_promised_and_of_which_commit(bench):
    line = GOOD | NEXT | {
        "kind": "nothing", "stage": "moving", "struck": "moving", "broken": ["contacts"],
        "others_asked": 30, "others_reached": 29, "commit": "abc", "contacts": 2,
    }  # fmt: skip
    text = bench("sector_faults").summary([line, line | {"commit": "abd"}, {"error": "no plant"}])
    assert "| nothing | 2 | 2 | 58 of 60 | 60 of 60 | 0.030 | 3.0 | 4 | 0 | 0 | 2 |" in text
    assert "1 of abc, 1 of abd. 1 more" in text


def test_a_countdown_that_was_ended_is_no_motion(bench):
    verdict = judged(bench, [(1.0, 0.97)], [(1.0, 0.96)], [1.0])
    assert verdict.stop_ms == verdict.start_skew_ms == 0.0
    # a GO that was sent late: the coordinator heard of it, and no lease was given
    verdict = judged(bench, [(1.0, 0.97)], [(1.004, 0.99)], [1.0])
    assert verdict.stop_ms == verdict.start_skew_ms == 0.0


def test_a_movement_without_a_start_or_verification_is_unverified(bench):
    assert judged(bench, [(1.0, 1.4)], [(0.5, 0.9)], [1.0]).unverified == 1
    assert judged(bench, [(1.0, 1.4)], [(1.0, 1.4)], [1.0], verified=False).unverified == 2
