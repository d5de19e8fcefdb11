# SPDX-License-Identifier: Apache-2.0
"""A dump of the parameters of all nodes is complete, and loads into other nodes."""

import array

import pytest
import yaml

from fiber_bringup.graph import Graph

pytestmark = pytest.mark.timeout(300)


def values(graph):
    """Parameters of each node as `ros2 param dump` writes them."""
    return {
        node.get_name(): {
            name: list(value.value)
            if isinstance(value.value, (array.array, list, tuple))
            else value.value
            for name, value in node.get_parameters_by_prefix("").items()
        }
        for node in graph.nodes
    }


def test_a_dump_is_complete_and_loads_into_other_nodes(new_domain, tmp_path):
    given = {
        "bridge": {"robots": 7, "time_scale": 0, "disabled": [3]},  # a whole number for a number
        "planner": {"planner": "dnf", "dnf.outer_mm": 9.5},
        "recorder": {"folder": str(tmp_path)},
    }
    with Graph(**given, viewer={}, domain=new_domain()) as graph:
        dumped = values(graph)
    assert all(value is not None for node in dumped.values() for value in node.values())
    assert dumped["bridge"]["time_scale"] == 0.0 and dumped["bridge"]["disabled"] == [3]
    file = tmp_path / "dump.yaml"
    sections = {f"/{node}": {"ros__parameters": found} for node, found in dumped.items()}
    file.write_text(yaml.safe_dump(sections))
    args = ["--ros-args", "--params-file", str(file)]
    with Graph(recorder={}, viewer={}, domain=new_domain(), args=args) as graph:
        assert values(graph) == dumped
