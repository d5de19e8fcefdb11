# SPDX-License-Identifier: Apache-2.0
"""A request that was sent while the middleware knew a dead server alone is answered by the next."""

import subprocess
import sys
from types import SimpleNamespace

import pytest
from rclpy.task import Future
from std_srvs.srv import Trigger

from fiber_node import PLANNER, RepeatedRequest, RosClient, claims

pytestmark = pytest.mark.timeout(300)

WAIT_S = 60.0
SERVER = """
import rclpy
from rclpy.node import Node
from std_srvs.srv import Trigger
from fiber_node import PLANNER, Claim

rclpy.init()
node = Node("server")
node.create_service(Trigger, "stop", lambda _, response: response)
claim = Claim(node, PLANNER)
rclpy.spin(node)
"""


@pytest.fixture
def serve():
    """Starts a process with the service."""
    started = []

    def start():
        started.append(subprocess.Popen([sys.executable, "-c", SERVER]))
        return started[-1]

    yield start
    for process in started:
        process.kill()
        process.wait()


def test_the_next_server_answers_what_was_asked_when_the_dead_one_was_known_alone(serve):
    with RosClient("asks") as asks:
        client = asks.node.create_client(Trigger, "stop")
        dead = serve()
        asks.wait_for(client.service_is_ready, WAIT_S, "the service")
        asks.wait_for(lambda: claims(asks.node, PLANNER), WAIT_S, "its claim")
        dead.kill()
        dead.wait()
        assert client.service_is_ready()  # what misleads
        request = RepeatedRequest(
            asks.node, client, Trigger.Request(), lambda: claims(asks.node, PLANNER)
        )
        serve()
        asks.wait_for(request.done, WAIT_S, "the answer of the next server")
        assert isinstance(request.result(), Trigger.Response)


class Graph:
    """A node and a client of a service with some servers, at some time."""

    def __init__(self):
        self.servers, self.now_s, self.sent = 1, 0.0, []
        self.service_name = "stop"

    def count_services(self, name):
        assert name == self.service_name
        return self.servers

    def call_async(self, request):
        self.sent.append(Future())
        return self.sent[-1]

    def after(self, request, servers):
        """Number of times that the request has been sent once the graph has some servers."""
        self.servers = servers
        for _ in range(20):
            self.now_s += 0.05
            request.done()
        return len(self.sent)


def test_a_request_is_sent_once_more_for_each_server_that_comes_and_none_that_goes():
    graph = Graph()
    request = RepeatedRequest(graph, graph, SimpleNamespace(), list, lambda: graph.now_s)
    counts = [graph.after(request, servers) for servers in (1, 0, 1, 2, 1)]
    assert counts == [1, 1, 2, 3, 3]
    assert not request.done() and request.result() is None
    graph.sent[1].set_result("answer")
    assert request.done() and request.result() == "answer"
    assert graph.after(request, 5) == 3


def test_a_server_that_lives_is_asked_once_also_when_one_comes_that_stays_out():
    graph, living = Graph(), ["first"]
    request = RepeatedRequest(graph, graph, SimpleNamespace(), lambda: living, lambda: graph.now_s)
    living.append("second")
    assert graph.after(request, 2) == 1
    # the first one turns out to be dead
    living.remove("first")
    assert graph.after(request, 2) == 2
    assert graph.after(request, 2) == 2
