# SPDX-License-Identifier: Apache-2.0
"""The executor of nodes: it ends when stopped, waits for callbacks, raises what escapes them."""

import threading

import pytest
import rclpy
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.context import Context
from rclpy.node import Node

from fiber_node import ThreadExecutor

pytestmark = pytest.mark.timeout(60)

WAIT_S = 20.0


@pytest.fixture
def running():
    """Function that runs a node's executor in a thread; returns node, executor and thread."""
    context = Context()
    rclpy.init(args=[], context=context)
    made = []

    def start(threads=2):
        node = Node("node", context=context, enable_rosout=False)
        executor = ThreadExecutor(threads, context=context)
        executor.add_node(node)
        errors = []

        def spin():
            try:
                executor.spin()
            except Exception as error:
                errors.append(error)

        thread = threading.Thread(target=spin)
        thread.start()
        made.append((node, executor, thread))
        return node, executor, thread, errors

    yield start
    for node, executor, thread in made:
        executor.stop()
        thread.join(WAIT_S)
        executor.shutdown()
        node.destroy_node()
    context.try_shutdown()


def test_shutdown_returns_only_after_the_callback_at_work(running):
    node, executor, thread, errors = running()
    begun, may_return, returned = threading.Event(), threading.Event(), []

    def work():
        begun.set()
        may_return.wait(WAIT_S)
        returned.append(True)

    timer = node.create_timer(0.01, work)
    assert begun.wait(WAIT_S)
    timer.cancel()
    executor.stop()
    thread.join(WAIT_S)
    assert not thread.is_alive() and not returned  # the loop does not wait for the callback
    threading.Timer(0.2, may_return.set).start()
    executor.shutdown()
    assert returned and not errors


def test_a_quiet_loop_ends_at_once_when_it_is_stopped(running):
    _, executor, thread, errors = running()
    executor.stop()
    thread.join(WAIT_S)
    assert not thread.is_alive() and not errors


def test_an_exception_that_escapes_a_callback_ends_the_loop(running):
    node, _, thread, errors = running()

    def fail():
        raise ZeroDivisionError("in a callback")

    node.create_timer(0.01, fail)
    thread.join(WAIT_S)
    assert not thread.is_alive() and isinstance(errors[0], ZeroDivisionError)


def test_no_more_callbacks_are_at_work_than_there_are_threads(running):
    node, executor, thread, _ = running(threads=2)
    lock, done = threading.Lock(), threading.Event()
    at_work, most, finished = 0, 0, 0

    def work():
        nonlocal at_work, most, finished
        with lock:
            at_work += 1
            most = max(most, at_work)
        threading.Event().wait(0.02)
        with lock:
            at_work -= 1
            finished += 1
            if finished == 20:
                done.set()

    group = ReentrantCallbackGroup()
    for _ in range(5):
        node.create_timer(0.005, work, callback_group=group)
    assert done.wait(WAIT_S)
    executor.stop()
    thread.join(WAIT_S)
    executor.shutdown()
    assert most == 2 and at_work == 0


def test_a_context_that_is_shut_down_without_a_wake_ends_the_loop(running):
    # so rclpy does it at a signal, when the loop is quicker than its thread
    node, executor, thread, errors = running()
    idle = threading.Event()

    def rest():
        timer.cancel()
        idle.set()

    timer = node.create_timer(0.01, rest)
    assert idle.wait(WAIT_S)
    threading.Event().wait(0.1)  # the loop waits again; without that the test shows less
    executor.context.handle.shutdown()
    thread.join(WAIT_S)
    assert not thread.is_alive() and not errors


def test_callbacks_are_served_where_no_thread_can_be_started(running, monkeypatch):
    node, executor, thread, errors = running(threads=2)

    def refuse(_):
        raise RuntimeError("can't start new thread")

    monkeypatch.setattr(threading.Thread, "start", refuse)
    together, group = threading.Barrier(2), ReentrantCallbackGroup()
    served = threading.Event()

    def serve():
        together.wait(WAIT_S)  # in both threads at once
        served.set()

    for _ in range(2):
        node.create_timer(0.01, serve, callback_group=group)
    executor.wake()
    assert served.wait(WAIT_S) and thread.is_alive() and not errors
