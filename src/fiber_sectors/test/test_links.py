# SPDX-License-Identifier: Apache-2.0
"""The thread of the links to sectors ends with the context of its node."""

import threading

import pytest
import rclpy
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node

from fiber_sectors.node.links import TopicLinks


@pytest.mark.parametrize("ended", [True, False])
def test_an_error_of_a_wait_is_one_unless_the_context_has_ended(monkeypatch, new_domain, ended):
    def spin(executor):
        if ended:
            context.shutdown()
        raise RuntimeError("failed to initialize wait set")

    told = []
    monkeypatch.setattr(threading, "excepthook", lambda given: told.append(given.exc_value))
    monkeypatch.setattr(SingleThreadedExecutor, "spin", spin)
    context = Context()
    rclpy.init(args=[], context=context, domain_id=new_domain())
    links = TopicLinks(Node("coordinator", context=context), 1)
    links._thread.join(60)
    assert not links._thread.is_alive()
    assert [str(error) for error in told] == ([] if ended else ["failed to initialize wait set"])
    context.try_shutdown()
