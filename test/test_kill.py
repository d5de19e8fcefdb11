# SPDX-License-Identifier: Apache-2.0
"""A short kill campaign: processes are killed and paused in motion, and the truth is the judge."""

import importlib
import signal
import time
from pathlib import Path

import numpy as np
import pytest

from fiber_client import PlaneClient
from fiber_core.outcomes import Outcome
from fiber_msgs_py import session_of, topics

pytestmark = pytest.mark.timeout(900)

NEVER = "unverified", "unordered", "contacts", "false_reached", "died"
MOST_S = 40.0
ALL_AT_ONCE = ["bridge", "planner", "discretizer", "recorder", "viewer"]


def load(name):
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(Path(__file__).parents[1] / "bench")
        return importlib.import_module(name)


@pytest.fixture(scope="module")
def campaign(tmp_path_factory, new_domain):
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("ROS_DOMAIN_ID", str(new_domain()))
        with load("kill_campaign").Campaign(tmp_path_factory.mktemp("kill"), 37, seed=1) as made:
            yield made


def judge_motion(line):
    assert {name: line["counted"][name] for name in NEVER} == dict.fromkeys(NEVER, 0), line
    assert line["movements"] >= 37, "no robot moved, so this run shows nothing"


@pytest.mark.parametrize(
    ("number", "names", "how", "stage"),
    [
        (0, ["bridge"], "kill", "moving"),
        (1, ["plant"], "kill", "moving"),
        (2, ["bridge"], "pause", "moving"),
        (3, ALL_AT_ONCE, "kill", "loading"),
        (4, [], "strangers", "moving"),
        (5, [], "services", "moving"),
        (8, ["client", "bridge"], "kill", "moving"),
        (9, ["client", "bridge"], "kill", "discretizing"),
    ],
)
def test_robots_never_touch_nor_move_unverified(campaign, number, names, how, stage):
    line = campaign.run(number, names=names, how=how, stage=stage, pause_s=0.8)
    judge_motion(line)
    assert line["next_s"] < MOST_S, f"the graph does not come back: {line}"
    assert line["ended"] != "nothing", f"the plan has no end: {line}"
    if how == "kill" and names[0] == "bridge":
        refused = [why for why in line["why"] if "clear first" in why]
        assert not refused, f"an operator had to clear first: {line}"


def test_a_plan_whose_bridge_and_client_are_killed_ends_once_and_for_late_listeners(campaign):
    client, processes = campaign._client, campaign._processes
    told, before = client.collect(topics.OUTCOME), campaign._newest
    campaign._operate()
    arguments = ["--timeout", "60", "random:77"]
    processes.start_command("fiber_client", "reconfigure", arguments)
    client.wait_for(lambda: campaign._newest != before, 60.0, "a plan")
    stamp = campaign._newest
    client.wait_for(lambda: client.moving, 60.0, "motion")
    for name in ("reconfigure", "bridge"):
        processes.send(name, signal.SIGKILL)
    processes.restart("bridge")
    client.wait_for(lambda: stamp in client.outcomes, 60.0, "the outcome of the plan")
    outcome = client.outcomes[stamp]
    assert load("kill_judge").count_false(
        client.plane, outcome, campaign._sent, campaign._truth.since(0)
    ) == 0  # fmt: skip
    assert np.array_equal(outcome.ids, client.plane.ids)
    processes.send("bridge", signal.SIGKILL)
    processes.restart("bridge")

    def sessions():
        return [session_of(each) for each in told if each.header.stamp == stamp.to_time()]

    client.wait_for(lambda: len(set(sessions())) == 2, 60.0, "the same of the next bridge")
    with PlaneClient() as late:
        late.wait_for(lambda: stamp in late.outcomes, 60.0, "what the bridge before has told")
        for column in ("outcome", "reason", "error_mm"):
            first, again = getattr(outcome, column), getattr(late.outcomes[stamp], column)
            np.testing.assert_array_equal(first, again)
    line = {"names": ["bridge"], "how": "kill", "back_s": time.monotonic()}
    assert campaign._recover(line)[0] < MOST_S
    assert len(sessions()) == 2, "each bridge tells it once"


def test_the_judge_counts_robots_that_stand_elsewhere_than_reported(campaign):
    client, count_false = campaign._client, load("kill_judge").count_false
    outcome = client.reconfigure(*campaign._new_targets(), 120.0)
    truth, sent = campaign._truth.since(0), campaign._sent
    assert outcome.count(Outcome.REACHED) > 18
    assert count_false(client.plane, outcome, sent, truth) == 0
    elsewhere = truth._replace(position=truth.position + [100_000, 0])
    assert count_false(client.plane, outcome, sent, elsewhere) > 18
    # a plan whose targets did not come is marked, and does not pass for one without a fault
    assert count_false(client.plane, outcome, [], elsewhere) is None
    sent.clear()
    line = {"unjudged": 0}
    assert campaign._count_false(outcome, elsewhere, line) == 0 and line["unjudged"] == 1


def test_a_pause_longer_than_the_lease_moves_nothing_unverified(campaign):
    names = ["planner", "discretizer", "bridge"]
    line = campaign.run(6, names=names, how="pause", stage="after", pause_s=3.0)
    judge_motion(line)
    assert line["next_s"] < MOST_S, f"nodes that were paused hear nothing any more: {line}"


def test_the_table_counts_each_kind_of_event():
    line = {
        "how": "kill", "names": ["bridge"], "stage": "moving", "next_s": 2.0, "load": 1.0,
        "counted": {"contacts": 2, "no_end": 0}, "memory": {"planner": [17, 200.0]},
    }  # fmt: skip
    later = line | {"memory": {"planner": [17, 201.5]}, "stage": "after", "next_s": 6.0}
    text = load("kill_table").table([line, later])
    assert "| kill bridge | 2 | 4 | 0 | 4.0 | 6.0 |" in text
    assert "| after | 1 | 2 | 0 | 6.0 | 6.0 |" in text
    assert "| planner | 2 | 200.0 | 201.5 |" in text


def test_runs_of_different_code_are_counted_apart():
    line = {
        "how": "kill", "names": ["bridge"], "stage": "moving", "next_s": 2.0, "load": 1.0,
        "counted": {"contacts": 0}, "memory": {}, "commit": "aaaaaaa", "unjudged": 1,
    }  # fmt: skip
    lines = [line, line, line | {"commit": "bbbbbbb", "counted": {"contacts": 3}}]
    text = load("kill_table").table(lines)
    assert "| aaaaaaa | 2 | 0 |" in text and "| bbbbbbb | 1 | 3 |" in text
    assert "Of 3 plans" in text and "0 further runs ended" in text
    text = load("kill_table").table([*lines, {"number": 4, "error": "WaitError: no plant"}])
    assert "3 runs" in text and "1 further runs ended" in text


def test_a_campaign_goes_on_after_its_last_run(tmp_path):
    first_left, lines = load("kill_jobs").first_left, tmp_path / "kill.jsonl"
    assert first_left(lines, 0) == 0
    lines.write_text('{"number":4,"seed":0}\n{"number":3,"seed":0}\n{"number":9,"seed":1}\n')
    assert first_left(lines, 0) == 5 and first_left(lines, 1) == 10 and first_left(lines, 2) == 0
