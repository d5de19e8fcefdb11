"""The graph in one process: what it says when one of its nodes dies."""

import signal
import threading

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


@pytest.fixture
def interrupts():
    """Interrupts are heard, also where whoever runs the tests ignores them."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.mark.usefixtures("interrupts")
def test_an_interrupt_while_waiting_ends_the_loop_before_the_nodes_go(new_domain, monkeypatch):
    looping = []
    leave = Graph._leave
    monkeypatch.setattr(Graph, "_leave", lambda self: (looping.append(self.running), leave(self)))
    with (
        pytest.raises(KeyboardInterrupt),
        Graph(bridge={"robots": 7}, domain=new_domain()) as graph,
    ):
        main = threading.main_thread().ident
        threading.Timer(0.5, signal.pthread_kill, [main, signal.SIGINT]).start()
        graph.wait()
    assert looping == [False]
