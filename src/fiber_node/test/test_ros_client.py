# SPDX-License-Identifier: Apache-2.0
"""A client hears every message: after an interrupt, and beside those of strangers."""

import os
import signal
import time

import pytest
from sensor_msgs.msg import PointCloud2

from fiber_msgs_py import topics
from fiber_node import RosClient

WAIT_S = 20.0


@pytest.fixture
def sigterm_interrupts():
    before = signal.signal(signal.SIGTERM, signal.default_int_handler)
    yield
    signal.signal(signal.SIGTERM, before)


def test_a_client_that_is_interrupted_while_it_takes_a_message_hears_later_ones(
    new_domain, monkeypatch, sigterm_interrupts
):
    with RosClient("interrupted", new_domain()) as client:
        heard = client.collect(topics.STOPPED)
        sender = topics.STOPPED.publisher(client.node)
        client.wait_for(sender.get_subscription_count, WAIT_S)
        take = client._executor._take_subscription

        def take_interrupted(subscription):
            os.kill(os.getpid(), signal.SIGTERM)
            return take(subscription)

        with monkeypatch.context() as patch:
            patch.setattr(client._executor, "_take_subscription", take_interrupted)
            sender.publish(topics.STOPPED.type())
            with pytest.raises(KeyboardInterrupt):
                client.wait_for(lambda: len(heard) > 1, WAIT_S)
        assert signal.getsignal(signal.SIGTERM) is signal.default_int_handler
        before = len(heard)
        sender.publish(topics.STOPPED.type())
        client.wait_for(lambda: len(heard) > before, WAIT_S, "a message after the interrupt")


@pytest.mark.parametrize(
    "topic", [topics.OUTCOME, topics.SEGMENTS, topics.TARGETS], ids=lambda t: t.name
)
def test_messages_of_strangers_push_out_none_that_was_not_read_yet(topic):
    with RosClient("bridge") as bridge, RosClient("stranger") as stranger, RosClient("c") as client:
        received = []
        topic.subscription(client.node, received.append)
        ours, theirs = topic.publisher(bridge.node), topic.publisher(stranger.node)
        for each in ours, theirs:
            client.wait_for(lambda each=each: each.get_subscription_count(), WAIT_S)
        ours.publish(PointCloud2(width=37))
        time.sleep(0.5)  # the client is busy meanwhile
        for _ in range(30):
            theirs.publish(PointCloud2())
        time.sleep(0.5)
        client.wait_for(lambda: any(message.width == 37 for message in received), 10.0)
