# SPDX-License-Identifier: Apache-2.0
"""A client that is interrupted can still hear the answer to its stop."""

import os
import signal

import pytest

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
