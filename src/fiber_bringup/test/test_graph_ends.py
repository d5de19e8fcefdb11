"""The graph in one process: what it says when one of its nodes dies."""

import pytest

from fiber_bringup.graph import Graph

pytestmark = pytest.mark.timeout(120)


def test_an_exception_that_escapes_a_node_ends_the_graph_and_is_told_at_once(new_domain, capfd):
    def fail():
        raise ZeroDivisionError("a callback without care")

    with (
        pytest.raises(ZeroDivisionError),
        Graph(bridge={"robots": 7}, domain=new_domain()) as graph,
    ):
        graph.nodes[0].create_timer(0.01, fail)
        graph.wait()
        assert not graph.running
        said = capfd.readouterr().err
        assert "a node has died" in said and "a callback without care" in said
