# SPDX-License-Identifier: Apache-2.0
"""A node ends when it is told to while it starts."""

import os
import signal
import subprocess
import sys
import time

import pytest

pytestmark = pytest.mark.timeout(120)

ENDS_S = 45.0  # less than the wait takes
SIGNALS = (signal.SIGINT, signal.SIGTERM)


def started(module, domain, *arguments):
    code = f"import sys; from {module} import main; sys.exit(main())"
    process = subprocess.Popen(
        [sys.executable, "-c", code, "--ros-args", *arguments],
        env=os.environ | {"ROS_DOMAIN_ID": str(domain)},
        stderr=subprocess.PIPE,
        text=True,
    )
    for line in process.stderr:
        if "settings: " in line:
            return process
    raise AssertionError(f"{module} has ended with code {process.wait()}")


def ends_with_code_0(process, how):
    begin = time.monotonic()
    process.send_signal(how)
    try:
        _, text = process.communicate(timeout=ENDS_S)
    finally:
        process.kill()
    print(f"{how.name}: ended after {time.monotonic() - begin:.2f} s")
    assert process.returncode == 0 and "Traceback" not in text, text


@pytest.mark.parametrize("how", SIGNALS)
def test_a_bridge_ends_while_it_waits_for_its_plant(new_domain, tmp_path, how):
    # it waits for a minute
    plant = f"plant:={tmp_path / 'plant.sock'}"
    ends_with_code_0(
        started("fiber_bus_bridge.node.bridge", new_domain(), "-p", "robots:=7", "-p", plant), how
    )
