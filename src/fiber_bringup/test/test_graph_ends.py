# SPDX-License-Identifier: Apache-2.0
"""The end of a graph in one process: by an exception in a node, and by an interrupt."""

import signal
import threading

import pytest

from fiber_bringup.graph import Graph

pytestmark = pytest.mark.timeout(120)


def test_an_exception_that_escapes_a_node_ends_the_graph_and_is_logged_at_once(new_domain, capfd):
    def fail():
        raise ZeroDivisionError("a callback without care")

    with (
        pytest.raises(ZeroDivisionError),
        Graph(bridge={"robots": 7}, domain=new_domain()) as graph,
    ):
        graph.nodes[0].create_timer(0.01, fail)
        graph.wait()
        assert not graph.running
        log = capfd.readouterr().err
        assert "a node has died" in log and "a callback without care" in log


@pytest.fixture
def interrupts():
    """Interrupts are received, also where the shell that runs the tests ignores them."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.mark.usefixtures("interrupts")
def test_an_interrupt_while_waiting_ends_the_loop_before_the_nodes_go(new_domain, monkeypatch):
    was_running = []
    destroy = Graph._destroy_nodes
    monkeypatch.setattr(
        Graph, "_destroy_nodes", lambda self: (was_running.append(self.running), destroy(self))
    )
    with (
        pytest.raises(KeyboardInterrupt),
        Graph(bridge={"robots": 7}, domain=new_domain()) as graph,
    ):
        main = threading.main_thread().ident
        threading.Timer(0.5, signal.pthread_kill, [main, signal.SIGINT]).start()
        graph.wait()
    assert was_running == [False]
