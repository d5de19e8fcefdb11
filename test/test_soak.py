# SPDX-License-Identifier: Apache-2.0
"""The campaigns of bench/soak.py: they pass, they repeat, and they detect what must not happen."""

import importlib
import json
from pathlib import Path

import numpy as np
import pytest

from fiber_bus_bridge.protocol import STEPS, Event, State
from fiber_bus_bridge.protocol.decisions import failing
from fiber_bus_bridge.simulation import Movements

pytestmark = pytest.mark.timeout(600)


@pytest.fixture(scope="module")
def soak():
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(Path(__file__).parents[1] / "bench")
        return importlib.import_module("soak")


@pytest.mark.parametrize(
    ("kind", "drive"),
    [
        ("none", "ideal"), ("stall", "ideal"), ("sda_stuck", "ideal"), ("noise", "ideal"),
        ("mixed", "ideal"), ("stall", "accelerated"), ("mixed", "accelerated"),
    ],
)  # fmt: skip
def test_a_campaign_ends_with_nothing_wrong(soak, kind, drive):
    campaign = soak.run_campaign(kind, 1, robots=37, drive=drive)
    assert campaign.wrong == []
    assert 0.0 < campaign.gap_mm < 5.0
    assert sum(campaign.outcomes.values()) % 37 == 0 and campaign.outcomes


def test_a_campaign_is_its_kind_and_its_seed(soak):
    logs = [soak.run_campaign("mixed", seed, robots=37).log for seed in (5, 5, 6)]
    assert logs[0] == logs[1] != logs[2]


def test_the_judge_detects_robots_that_were_not_stopped(soak, monkeypatch):
    # in this campaign arms touch if the others are not stopped after a robot has lost power
    move = STEPS[State.MOVING]

    def without_stop(c):
        event = move(c)
        if event is not Event.FAILURE:
            return event
        c.watch.stop_all_at_s = None
        c.robots["arrived"] |= failing(c.robots)
        return Event.STEPPED

    monkeypatch.setitem(STEPS, State.MOVING, without_stop)
    wrong = soak.run_campaign("brown_out", 26).wrong
    assert any("arms touch" in words for words in wrong)
    monkeypatch.undo()
    assert soak.run_campaign("brown_out", 26).wrong == []


def test_the_judge_detects_orders_that_were_not_verified(soak):
    campaign = soak.Campaign("none", 0)
    ones = np.ones((1, 2, 15), dtype=np.int64)
    one = np.array([1.0])
    odd = Movements(np.array([3]), one, one + 1.0, one, np.array([[1, 1]]), ones, ones, 0 * ones)
    importlib.import_module("soak_judge")._judge_movements(campaign, odd, [])
    assert campaign.wrong == ["robot 3 moved at 1.0000 s unverified"]


def test_an_interrupted_run_continues_and_the_table_has_all_campaigns(soak, tmp_path, capsys):
    lines, out = tmp_path / "lines.jsonl", tmp_path / "table.md"
    some = ["--kind", "none", "stall", "--robots", "37", "--lines", str(lines), "--out", str(out)]
    assert soak.main([*some, "--campaigns", "1"]) == 0
    first = lines.read_text()
    assert soak.main([*some, "--campaigns", "2"]) == 0
    assert lines.read_text().startswith(first)
    told = [json.loads(line) for line in lines.read_text().splitlines()]
    assert sorted((line["kind"], line["seed"]) for line in told) == [
        ("none", 0), ("none", 1), ("stall", 0), ("stall", 1),
    ]  # fmt: skip
    assert out.read_text() == soak.table(told)
    assert "| all | 4 | 0 |" in out.read_text()
    # kind and seed of a line replay its campaign
    capsys.readouterr()
    assert soak.main(["--replay", "stall:1", "--robots", "37"]) == 0
    words = capsys.readouterr().out
    gap_mm = next(line["gap_mm"] for line in told if (line["kind"], line["seed"]) == ("stall", 1))
    assert f"smallest true gap {gap_mm:.4f} mm" in words and "nothing wrong" in words


@pytest.mark.parametrize(
    ("kind", "seed"),
    [("absent", 5), ("brown_out", 4), ("reset", 40), ("stretch", 5), ("scl_stuck", 9)],
)
def test_stops_are_no_farther_apart_than_what_is_certified(soak, kind, seed):
    # in these campaigns a robot stops during the motion
    campaign = soak.run_campaign(kind, seed)
    assert campaign.wrong == []
    assert 0.0 < campaign.apart_ms <= 1e3 * soak.SAFETY.stop_skew_s
