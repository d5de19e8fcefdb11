# SPDX-License-Identifier: Apache-2.0
"""The launch file with sectors, checked with stand-ins for launch."""

from types import SimpleNamespace

import pytest
from launch_stand_ins import SHARE, all_of, everything, load

MODULE, DESCRIPTION = load()


def _hosts(**given):
    return SimpleNamespace(configurations={"sectors": "0", "sectors_here": "all"} | given)


@pytest.mark.parametrize(("shares", "sectors"), [("0", 0), ("3", 3), ("0-4; 5; 6,7", 3)])
def test_a_plane_of_sectors_has_a_node_for_each_and_a_coordinator(shares, sectors):
    context = _hosts(sectors=shares)
    others = [each.given for each in MODULE["_sectors"](context)]
    coordinators = [each.given for each in MODULE["_coordinator"](context)]
    assert len(others) == sectors and bool(coordinators) == bool(sectors)
    if not sectors:
        return
    (coordinator,) = coordinators
    assert [each["namespace"] for each in others] == [f"sector_{k}" for k in range(sectors)]
    assert {each["executable"] for each in others} == {"sector"}
    own = [each["parameters"][1] for each in others]
    assert [each["sectors.number"] for each in own] == list(range(sectors))
    assert {each["sectors.shares"].args[0] for each in own} == {shares}
    scales = [each["sectors.clock_scale"].args[0] for each in own]
    assert {each.args[0] for each in scales} == {"sectors_clock"}
    # for clients the coordinator is the bridge
    assert (coordinator["executable"], coordinator["name"]) == ("coordinator", "bridge")
    setup = (SHARE.parent / "fiber_sectors" / "setup.py").read_text()
    assert all(
        f'"{each["executable"]} = fiber_sectors.' in setup for each in [*others, coordinator]
    )


def test_hosts_start_their_own_sectors_alone():
    def numbers(here):
        nodes = MODULE["_sectors"](_hosts(sectors="10", sectors_here=here))
        return [each.given["parameters"][1]["sectors.number"] for each in nodes]

    assert numbers("3") == [3] and numbers("0-2, 5,5") == [0, 1, 2, 5]
    assert numbers("none") == [] and numbers("all") == list(range(10))
    for wrong in ("10", "8-12", "2-1", "-1", "1-", "one", ""):
        with pytest.raises(RuntimeError, match=f"sectors_here:={wrong} "):
            numbers(wrong)
    with pytest.raises(RuntimeError, match="it has 0 sectors"):
        MODULE["_sectors"](_hosts(sectors_here="0"))


def test_only_a_host_without_numbered_sectors_starts_the_rest():
    groups = all_of(DESCRIPTION, "GroupAction")
    (group,) = [each for each in groups if "condition" in each.given]
    executables = {each.given["executable"] for each in all_of(group, "Node")}
    assert executables >= {"bridge", "planner", "discretizer", "recorder", "viewer", "console"}
    assert not [each for each in all_of(DESCRIPTION, "Node") if each not in all_of(group, "Node")]
    equal = [each.args for each in everything(group.given["condition"])]
    assert {args[1] for args in equal if len(args) == 2 and args[1] in ("all", "none")} == {
        "all", "none",
    }  # fmt: skip
