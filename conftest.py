# SPDX-License-Identifier: Apache-2.0
"""The environment of every test process, set before rclpy and the messages are imported.

A ROS domain of its own, on loopback, and messages that check the values assigned to them, which is
decided once in a process, when the first message is imported.
"""

import os
import random
import socket
import sys
from pathlib import Path

import pytest

_ROOT = Path(__file__).parent
_FIRST_PORT = 47_000
_held = []


def _claim_domain() -> int:
    """Return a ROS domain id 1..101 that no other test process of this machine uses.

    A bound port stands for the domain. The system frees it when the process ends,
    however it ends.
    """
    for domain in random.sample(range(1, 102), 101):
        claim = socket.socket()
        try:
            claim.bind(("127.0.0.1", _FIRST_PORT + domain))
        except OSError:
            claim.close()
            continue
        _held.append(claim)
        return domain
    raise RuntimeError("all 101 ROS domains are in use")


os.environ |= {
    "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
    "RMW_IMPLEMENTATION": "rmw_fastrtps_cpp",
    "FASTRTPS_DEFAULT_PROFILES_FILE": str(_ROOT / "src/fiber_node/config/fastdds.xml"),
    "ROS_DOMAIN_ID": str(_claim_domain()),
    "ROS_PYTHON_CHECK_FIELDS": "1",
}
os.environ.setdefault("ROS_LOG_DIR", str(_ROOT / "log/ros"))
os.environ.pop("PYTEST_ADDOPTS", None)  # it is for this run, and not for those that tests start


@pytest.hookimpl(wrapper=True)
def pytest_runtest_teardown(item: pytest.Item):
    """Fail a test in which an exception escaped a callback: the guard keeps the node alive."""
    yield
    guard = sys.modules.get("fiber_msgs_py.callback_guard")  # not loaded by every suite
    failures = guard.take_failures() if guard else []
    if failures:
        raise failures[0]


@pytest.fixture
def domain() -> int:
    """ROS domain id of this process."""
    return int(os.environ["ROS_DOMAIN_ID"])


@pytest.fixture(scope="session")
def new_domain():
    """Returns another ROS domain id at each call, all held until the process ends."""
    return _claim_domain


@pytest.fixture
def other_domain() -> int:
    """A second ROS domain id, held until the process ends."""
    return _claim_domain()
