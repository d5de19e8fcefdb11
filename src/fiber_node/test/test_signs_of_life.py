# SPDX-License-Identifier: Apache-2.0
"""A node that claims a role is believed while it lives, whatever the graph has of it."""

import signal
import subprocess
import sys
import threading

import pytest
import rclpy
from std_msgs.msg import Empty

from fiber_node import PLANNER, Claim, RosClient, ThreadExecutor, claims
from fiber_node.signs_of_life import LIFE_QOS, SignsOfLife, _LifeSubscription

pytestmark = pytest.mark.timeout(300)

WAIT_S = 60.0
PAUSE_S = 1.0  # after its death is known, and less than the lease
# many endpoints that come and go: its peers ask often for the list of them
PLANNER_SCRIPT = """
import time
import rclpy
from rclpy.node import Node
from std_msgs.msg import Empty
from fiber_node import PLANNER, Claim

rclpy.init()
node = Node("planner")
for _ in range(80):
    node.destroy_publisher(node.create_publisher(Empty, "some", 1))
    time.sleep(0.02)
publisher = node.create_publisher(Empty, "beat", 1)
node.create_timer(0.05, lambda: publisher.publish(Empty()))
claim = Claim(node, PLANNER)
rclpy.spin(node)
"""


@pytest.fixture
def client():
    with RosClient("observer") as made:
        yield made


@pytest.fixture
def planner():
    """A process with the role of the planner, which beats."""
    process = subprocess.Popen([sys.executable, "-c", PLANNER_SCRIPT])
    yield process
    process.kill()
    process.wait()


def test_a_node_that_was_paused_is_dead_meanwhile_and_is_heard_as_soon_as_it_goes_on(
    client, planner
):
    beats = []
    client.node.create_subscription(Empty, "beat", beats.append, 10)
    client.wait_for(lambda: beats and claims(client.node, PLANNER), WAIT_S)
    before = claims(client.node, PLANNER)
    planner.send_signal(signal.SIGSTOP)
    try:
        client.wait_for(lambda: not claims(client.node, PLANNER), 2.5, "the death of the planner")
        client.wait_quietly(PAUSE_S, lambda: 0)
    finally:
        planner.send_signal(signal.SIGCONT)
    beats.clear()
    client.wait_for(lambda: claims(client.node, PLANNER) == before, 2.0, "its claim")
    client.wait_for(lambda: beats, 2.0, "a beat")


def test_the_claim_of_a_node_that_was_killed_is_gone_within_two_seconds(client, planner):
    client.wait_for(lambda: claims(client.node, PLANNER), WAIT_S)
    client.wait_quietly(2.5, lambda: 0)  # and it stays
    assert claims(client.node, PLANNER)
    planner.kill()
    client.wait_for(lambda: not claims(client.node, PLANNER), 2.5, "its death")


class Clock:
    def __init__(self):
        self.now_s = 100.0

    def __call__(self):
        return self.now_s


def test_a_claim_without_a_sign_of_life_is_not_believed_for_long(client):
    clock = Clock()
    signs = SignsOfLife(client.node, clock)
    assert signs.alive(PLANNER, ["never"]) == {"never"}
    clock.now_s += 1.9
    assert signs.alive(PLANNER, ["never"]) == {"never"}
    clock.now_s += 0.2
    assert signs.alive(PLANNER, ["never"]) == set()
    signs.end()


def test_a_node_that_gives_no_sign_is_dead_after_a_while_and_alive_again_with_the_next(client):
    clock = Clock()
    signs = SignsOfLife(client.node, clock)
    others = RosClient("others")  # the middleware gives no sign of a node to itself
    publisher = others.node.create_publisher(Empty, "life", LIFE_QOS)

    def seen():
        return signs.alive(PLANNER, ["life"]) == {"life"}

    def given():
        seen()
        return signs._signs[PLANNER]["life"]._present

    client.wait_for(given, WAIT_S, "a sign")
    clock.now_s += 10.0
    assert seen(), "the present counts, not what was before"
    others.node.destroy_publisher(publisher)
    client.wait_for(lambda: not given(), WAIT_S, "its end")
    assert seen(), "the observer may have been paused itself"
    clock.now_s += 0.6
    assert seen()
    clock.now_s += 0.2
    assert not seen()
    others.node.create_publisher(Empty, "life", LIFE_QOS)
    client.wait_for(seen, WAIT_S, "another sign")
    signs.end()
    others.close()


def test_signs_of_claims_that_are_gone_are_kept_only_until_the_middleware_is_done(client):
    clock = Clock()
    signs, count = SignsOfLife(client.node, clock), client.node.count_subscribers
    signs.alive(PLANNER, ["one", "other"])
    client.wait_for(lambda: count("one") == count("other") == 1, WAIT_S)
    signs.alive(PLANNER, ["other"])
    clock.now_s += 1.9
    signs.alive(PLANNER, ["other"])
    ((_, gone),) = signs._gone
    with gone._subscriptions[0]._subscription:  # refused once it is destroyed
        assert count("one") == 1
    clock.now_s += 0.2
    signs.alive(PLANNER, ["other"])
    client.wait_for(lambda: count("one") == 0, WAIT_S)
    assert count("other")
    signs.end()
    client.wait_for(lambda: count("other") == 0, WAIT_S)


def test_every_observer_of_a_process_sees_the_sign_that_another_has_seen_before(client, planner):
    client.wait_for(lambda: claims(client.node, PLANNER), WAIT_S)
    client.wait_quietly(1.0, lambda: 0)  # the middleware has told of the sign
    later = rclpy.create_node("later_observer", context=client.node.context)
    try:
        for _ in range(2):  # the second time its first signs are kept, to be destroyed
            client.wait_for(lambda: claims(later, PLANNER), WAIT_S)
            client.wait_quietly(4.0, lambda: 0)
            assert claims(later, PLANNER), "it lives"
            SignsOfLife.of(later).alive(PLANNER, [])
    finally:
        SignsOfLife.of(later).end()
        later.destroy_node()


def test_a_sign_that_a_subscription_has_missed_is_asked_for_anew(client, planner, monkeypatch):
    heard = _LifeSubscription.hears
    deaf: list[_LifeSubscription] = []

    def hears(self):
        heard(self)
        if not deaf:
            deaf.append(self)
        return self is not deaf[0] and heard(self)

    monkeypatch.setattr(_LifeSubscription, "hears", hears)
    client.wait_for(lambda: claims(client.node, PLANNER), WAIT_S)
    client.wait_quietly(4.0, lambda: claims(client.node, PLANNER) and 0)
    assert claims(client.node, PLANNER), "it lives"
    planner.kill()
    client.wait_for(lambda: not claims(client.node, PLANNER), 2.5, "its death")


def test_a_sign_that_never_comes_is_asked_for_three_times(client):
    clock = Clock()
    signs, count = SignsOfLife(client.node, clock), client.node.count_subscribers
    for _ in range(100):
        signs.alive(PLANNER, ["never"])
        clock.now_s += 0.1
    client.wait_for(lambda: count("never") == 3, WAIT_S)
    signs.end()
    client.wait_for(lambda: count("never") == 0, WAIT_S)


class CountingExecutor(ThreadExecutor):
    """Counts how often it looks what is ready."""

    looks = 0

    def get_nodes(self):
        self.looks += 1
        return super().get_nodes()


def test_a_sign_that_is_not_asked_for_does_not_wake_the_executor(client, planner):
    client.wait_for(lambda: claims(client.node, PLANNER), WAIT_S)
    context = client.node.context
    beats, executor = [], CountingExecutor(2, context)
    observer = rclpy.create_node("another_observer", context=context)
    observer.create_subscription(Empty, "beat", beats.append, 10)
    executor.add_node(observer)
    loop = threading.Thread(target=executor.spin)
    loop.start()
    try:
        assert claims(observer, PLANNER)  # the sign comes later
        client.wait_for(lambda: len(beats) > 10, WAIT_S)
        beats.clear()
        before = executor.looks
        client.wait_for(lambda: len(beats) >= 20, WAIT_S)
        assert executor.looks - before < 10 * len(beats)
    finally:
        executor.stop()
        loop.join()
        SignsOfLife.of(observer).end()
        executor.shutdown()
        observer.destroy_node()


def test_a_claim_of_this_process_lives_until_it_is_released(client):
    claim = Claim(client.node, PLANNER)
    client.wait_for(lambda: claims(client.node, PLANNER) == [claim.id], WAIT_S)
    client.wait_quietly(3.5, lambda: 0)
    assert claims(client.node, PLANNER) == [claim.id]
    claim.release()
    client.wait_for(lambda: not claims(client.node, PLANNER), WAIT_S)
