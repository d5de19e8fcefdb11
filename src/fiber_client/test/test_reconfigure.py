# SPDX-License-Identifier: Apache-2.0
"""The output and the exit code of the command reconfigure, given the outcome of the robots."""

import argparse
import io
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from fiber_client.bus_counters import BusCounterTotals
from fiber_client.errors import PlaneError
from fiber_client.reconfigure import _parser, _run, _write_results, main, summary, went_well
from fiber_client.terminal import ProgressDisplay, table
from fiber_core.outcomes import Outcome, PlanOutcome, Reason
from fiber_core.presets import preset
from fiber_formats import FormatError, read_results, read_starts
from fiber_msgs_py import Attempt, Level, PlanStamp, Progress, Status

STAMP = PlanStamp(7)
ATTEMPT = Attempt.first(STAMP)


def end_of(*pairs):
    outcome, reason = np.array(pairs).T
    n = len(pairs)
    return PlanOutcome(STAMP.ns, np.arange(10, 10 + n), outcome, reason, np.linspace(0, 1, n))


GOOD = (Outcome.REACHED, Reason.OK)


@pytest.mark.parametrize(
    ("pair", "well"),
    [
        (GOOD, True),
        ((Outcome.HELD, Reason.UNREACHABLE), True),
        ((Outcome.HELD, Reason.UNSAFE), True),
        ((Outcome.HELD, Reason.STOPPED), False),
        ((Outcome.HELD, Reason.NOT_PLANNED), False),
        ((Outcome.FAILED, Reason.OFF_TARGET), False),
    ],
)
def test_one_robot_decides_the_exit_code(pair, well):
    assert went_well(end_of(GOOD, pair, GOOD)) is well


def test_robots_are_found_by_id_in_any_order():
    ended = end_of(GOOD, (Outcome.HELD, Reason.DISABLED), (Outcome.FAILED, Reason.REFUSED))
    some = ended.of([12, 10])
    assert some.ids.tolist() == [12, 10]
    assert some.reason.tolist() == [Reason.REFUSED, Reason.OK]
    assert some.error_mm.tolist() == [1.0, 0.0]


def test_the_summary_counts_all_and_names_the_first_missed():
    missed = [(Outcome.HELD, Reason.UNSAFE)] * 7
    text = summary(end_of(GOOD, GOOD, *missed))
    lines = [line.split() for line in text.splitlines()]
    assert ["reached", "ok", "2"] in lines and ["held", "unsafe", "7"] in lines
    assert ["asked", "9"] in lines and ["12", "held", "unsafe", "0.250"] in lines
    assert "and 2 more" in text and ["17", "held", "unsafe", "0.875"] not in lines


def test_a_table_aligns_numbers_to_the_right():
    assert table([("name", "n"), ("a", 7), ("b", 123)]) == "name  n\na       7\nb     123"


def test_progress_is_a_few_lines_where_there_is_no_terminal():
    stream = io.StringIO()
    with ProgressDisplay(stream) as display:
        for step in range(101):
            display(Progress("planner", step / 100, f"step {step}", ATTEMPT))
        display(Progress("bridge", 0.0, "moving", ATTEMPT))
    lines = stream.getvalue().splitlines()
    assert 4 <= len(lines) <= 7
    assert lines[-2].split() == ["planner", "100", "%", "step", "100"]
    assert lines[-1].startswith("bridge")


def bus(number, frames, level=Level.OK, **counters):
    return Status(f"bridge: bus {number}", level, "n frames failed", {"frames": frames} | counters)


def test_totals_of_the_buses_count_from_the_first_status():
    now = [100.0]
    totals = BusCounterTotals(lambda: now[0])
    for number, frames in ((0, 1000), (1, 50), (0, 1010), (1, 70)):
        assert totals.add(bus(number, frames, retries=frames // 10))
    assert totals.totals["frames"] == 10 + 20 and totals.totals["retries"] == 1 + 2
    assert not totals.add(Status("planner", Level.OK, "waiting", {"frames": 9}))
    now[0] += 2.0
    totals.add(bus(0, 1110, retries=101))
    assert totals.frames_per_s == pytest.approx((30 + 100) / 2)
    assert "130 frames" in str(totals) and "3 retries" in str(totals)


def test_an_alert_is_shown_once_until_it_gets_worse():
    stream = io.StringIO()
    with ProgressDisplay(stream) as display:
        good, warn = bus(0, 1), bus(0, 9, Level.WARN)
        error = Status("planner", Level.ERROR, "targets refused: robot 9")
        for status, before in (
            (good, None), (warn, good), (warn, warn), (good, warn), (warn, good), (error, None)
        ):  # fmt: skip
            display.status(status, before)
    lines = [line.split(maxsplit=1) for line in stream.getvalue().splitlines()]
    assert [line[0] for line in lines] == ["WARN", "WARN", "ERROR"]
    assert "robot 9" in lines[-1][1] and len(display.alerts) == 3


class Terminal(io.StringIO):
    def isatty(self):
        return True


def test_a_terminal_shows_bars_rates_and_alerts(monkeypatch):
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setenv("COLUMNS", "110")
    stream = Terminal()
    with ProgressDisplay(stream) as display:
        display(Progress("planner", 0.5, "half way [here]", ATTEMPT))
        display(Progress("planner", 0.1, "the next plan", ATTEMPT))
        display.status(bus(0, 5), None)
        display.status(bus(0, 25, Level.WARN), bus(0, 5))
        display.say("a line of its own")
    text = stream.getvalue()
    for words in ("planner", "the next plan", "20 frames", "a line of its own", "n frames failed"):
        assert words in text, words
    assert "\x1b[" in text


def test_help_describes_the_kinds_of_targets(capsys):
    with pytest.raises(SystemExit) as left:
        main(["--help"])
    assert left.value.code == 0
    text = capsys.readouterr().out
    for word in ("random[:SEED]", "problem.npz", "id, x_mm, y_mm", "--home-first", "Exit code"):
        assert word in text


def test_results_have_a_row_for_each_robot_with_its_angles(tmp_path):
    plane = preset("desi", 4)
    plane = replace(
        plane, fibres=np.tile([[3.0, 0.0], [3.0, 0.5]], (4, 1, 1)), fibre_names=("A", "B")
    )
    angles = np.array([[0.1, 0.2], [0.3, 0.4], [0.5, 0.6], [0.7, 0.8]])
    ended = PlanOutcome(
        STAMP.ns, np.arange(4), np.full(4, Outcome.HELD), np.full(4, Reason.NO_TARGET), np.zeros(4)
    )
    path = tmp_path / "results.fits"
    client = SimpleNamespace(plane=plane, angles=angles)
    asked = np.array([2, 9]), np.array([[1.0, 2.0], [3.0, 4.0]]), np.array([1, -1])
    _write_results(client, argparse.Namespace(results=path, form="desi"), ended, asked)
    table = read_results(path)
    assert table.ids.tolist() == [0, 1, 2, 3] and table.fibre[2] == "B"
    assert np.array_equal(table.angles_deg, np.rad2deg(angles))
    assert np.allclose(read_starts(path, plane).angles, angles, rtol=0, atol=1e-15)


@pytest.mark.parametrize(
    ("options", "error"),
    [(["--results", "all.xlsx"], FormatError), (["--form", "desi"], PlaneError)],
)
def test_results_that_cannot_be_written_are_refused_before_the_motion(options, error):
    with pytest.raises(error, match=r"a table is written as|--form tells"):
        _run(None, _parser().parse_args(["random", *options]), None)
