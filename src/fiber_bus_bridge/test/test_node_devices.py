# SPDX-License-Identifier: Apache-2.0
"""The bridge node on I2C adapters: devices /dev/i2c-N that umockdev mocks."""

import errno
import logging
import os
import re
import shutil
import subprocess
import sys
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import pytest
from kernel_buses import umockdev
from rest_of_graph import Rest, problem_file

from fiber_bus_bridge import BridgeError
from fiber_bus_bridge.node import BridgeNode
from fiber_bus_bridge.node.hardware import device_hardware
from fiber_bus_bridge.simulation import SimulationConfig
from fiber_core.drive.named import with_drive
from fiber_core.problem import load_problem, save_problem
from fiber_msgs_py import topics
from fiber_node import RosClient

pytestmark = pytest.mark.timeout(600)

WRAPPER = shutil.which("umockdev-wrapper")
THIS_FILE = Path(__file__)


def test_the_node_passes_its_tests_on_devices():
    if WRAPPER is None or umockdev() is None:
        pytest.skip("umockdev with its Python bindings is not installed: devices are not tested")
    pytest.importorskip("smbus2", reason="smbus2 is not installed: devices are not tested")
    inside = str(THIS_FILE.with_name("node_on_devices.py"))
    run = subprocess.run(
        [WRAPPER, sys.executable, "-m", "pytest", "-q", inside],
        capture_output=True,
        text=True,
        timeout=500,
        cwd=THIS_FILE.parents[3],
    )
    assert run.returncode == 0, run.stdout + run.stderr
    assert re.search(r"\b2 passed\b", run.stdout), run.stdout


@pytest.mark.parametrize(
    ("devices", "problem", "message"),
    [
        (["/dev/i2c-0"], False, "devices need the parameter problem"),
        (["a", "b"], True, r"\['a', 'b'\] for the 1 buses \[0\]"),
        (["/dev/no-such"], True, "No such file or directory"),
    ],
)
def test_unusable_devices_end_the_bridge(tmp_path, devices, problem, message):
    pytest.importorskip("smbus2", reason="smbus2 is not installed: devices are not tested")
    path = problem_file(tmp_path)
    with RosClient("rest") as peer, pytest.raises(BridgeError, match=message):
        peer.add_node(BridgeNode, devices=devices, problem=path if problem else "")


@pytest.mark.parametrize("drive", ["accelerated", "desi"])
def test_motors_with_a_ramp_are_refused_on_devices(tmp_path, drive):
    problem = load_problem(problem_file(tmp_path))
    ramped = replace(problem, plane=with_drive(problem.plane, drive))
    save_problem(tmp_path / "ramped.npz", ramped)
    config = SimulationConfig(problem=str(tmp_path / "ramped.npz"))
    with pytest.raises(
        BridgeError, match=f"'{drive}' has a ramp of .* come to rest within the stop skew"
    ):
        device_hardware(config, ["/dev/i2c-0"])


class Unsupported:
    """An adapter with a driver that supports no message."""

    def __init__(self, path):
        self.path = path

    def i2c_rdwr(self, *messages):
        raise OSError(errno.EOPNOTSUPP, os.strerror(errno.EOPNOTSUPP))


@contextmanager
def messages_of(name):
    """List of the messages that a logger writes; plugins of launch_testing empty `caplog`."""
    messages, handler, logger = [], logging.Handler(), logging.getLogger(name)
    handler.emit = lambda record: messages.append(record.getMessage())
    logger.addHandler(handler)
    try:
        yield messages
    finally:
        logger.removeHandler(handler)


def test_an_unusable_adapter_counts_as_stuck_and_is_logged(tmp_path, monkeypatch):
    pytest.importorskip("smbus2", reason="smbus2 is not installed: devices are not tested")
    monkeypatch.setattr("smbus2.SMBus", Unsupported)
    with RosClient("rest") as peer, messages_of("fiber_bus_bridge") as messages:
        rest = Rest(peer, problem_file(tmp_path), devices=["/dev/i2c-0"])
        answer = rest.call(topics.CONFIGURE)
        assert answer.success and answer.message == "0 of 7 robots configured"
    assert any("bus 0 counts as stuck: [Errno 95] Operation not" in text for text in messages)
