# SPDX-License-Identifier: Apache-2.0
"""A node as a process: its sockets are on loopback, and what it writes is its owner's."""

import os
import re
import signal
import stat
import subprocess
import sys
import time
from pathlib import Path

import pytest
from rcl_interfaces.srv import ListParameters
from rclpy.qos import qos_profile_sensor_data
from std_msgs.msg import String

from fiber_node import RosClient

pytestmark = [
    pytest.mark.timeout(120),
    pytest.mark.skipif(not Path("/proc/net/udp").exists(), reason="NOT TESTED, no /proc/net"),
]

SCRIPT = """
import sys
from pathlib import Path
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data
from std_msgs.msg import String
from fiber_node import run

def make():
    Path(sys.argv[1], "written").write_text("by a node")
    node = Node("lonely")
    node.create_subscription(String, "flood", lambda _: None, qos_profile_sensor_data)
    return node

run(make, [])
"""
OURS = ("ROS_AUTOMATIC_DISCOVERY_RANGE", "FASTRTPS_DEFAULT_PROFILES_FILE")
LOOPBACK = "0100007F"


def inodes(pid):
    """Return the inodes of the sockets of a process."""
    links = [os.readlink(each) for each in Path(f"/proc/{pid}/fd").iterdir() if each.is_symlink()]
    return {match[1] for link in links if (match := re.match(r"socket:\[(\d+)\]", link))}


def sockets(pid):
    """Return the local address, in hexadecimal, of each internet socket of a process."""
    found, own = [], inodes(pid)
    for table in ("udp", "udp6", "tcp", "tcp6"):
        lines = Path(f"/proc/{pid}/net/{table}").read_text().splitlines()[1:]
        found += [line.split()[1].split(":")[0] for line in lines if line.split()[9] in own]
    return found


@pytest.fixture
def lonely(tmp_path, new_domain):
    """Function that starts a node as a process, and returns its process id when it is in the graph.

    Its environment has no settings of the network but those that are given.
    """
    started, domain = [], new_domain()

    def start(**environment):
        start.domain = domain
        rest = {name: value for name, value in os.environ.items() if name not in OURS}
        rest |= {"ROS_DOMAIN_ID": str(domain), "ROS_LOG_DIR": str(tmp_path / "log"), **environment}
        command = [sys.executable, "-c", SCRIPT, str(tmp_path)]
        started.append(subprocess.Popen(command, env=rest, stdin=subprocess.DEVNULL))
        with RosClient("observer", domain) as observer:
            observer.wait_for(lambda: "lonely" in observer.node.get_node_names(), 60.0)
        return started[-1].pid

    yield start
    for process in started:
        process.terminate()
        process.wait(20)


def test_all_sockets_of_a_node_are_on_loopback(lonely):
    found = sockets(lonely())
    assert len(found) >= 3 and set(found) == {LOOPBACK}


def test_the_settings_of_the_environment_win(lonely):
    # as before there was a profile: sockets on all interfaces, which this test can see
    assert set(sockets(lonely(ROS_AUTOMATIC_DISCOVERY_RANGE="SUBNET"))) != {LOOPBACK}


def shared(pid):
    """Return the segments of Fast DDS in shared memory that a process has mapped."""
    maps = Path(f"/proc/{pid}/maps").read_text()
    return set(map(Path, re.findall(r"/dev/shm/fastrtps_[0-9a-f]{16}\b", maps)))


def test_no_message_passes_through_shared_memory(lonely):
    # its ports lose a process that is paused while others send
    assert not shared(lonely())


SENT = 50
IN_ONE_PROCESS = f"""
from pathlib import Path
from rclpy.qos import QoSProfile
from std_msgs.msg import String
from fiber_node import RosClient

def packets():
    lines = Path("/proc/net/snmp").read_text().splitlines()
    names, values = (line.split() for line in lines if line.startswith("Udp:"))
    return int(dict(zip(names, values))["OutDatagrams"])

with RosClient("hears") as hears, RosClient("tells") as tells:
    heard = []
    hears.node.create_subscription(String, "told", heard.append, QoSProfile(depth={SENT}))
    told = tells.node.create_publisher(String, "told", QoSProfile(depth={SENT}))
    tells.wait_for(lambda: told.get_subscription_count() == 1, 30.0, "the subscription")
    before = packets()
    for _ in range({SENT}):
        told.publish(String(data="x" * 50_000))
    hears.wait_for(lambda: len(heard) == {SENT}, 30.0, "the messages")
    print(packets() - before)
"""
OWN_NETWORK = ("unshare", "--map-root-user", "--net", "sh", "-c", 'ip link set lo up && exec "$@"')


@pytest.mark.skipif(
    bool(
        subprocess.run(
            [*OWN_NETWORK, "-", "true"], check=False, stderr=subprocess.DEVNULL
        ).returncode
    ),
    reason="NOT TESTED: no network of its own can be made, so no packets are counted",
)
def test_nodes_of_one_process_hear_each_other_through_sockets():
    # of what the middleware hands over inside a process a new subscription can miss all, for ever
    command = [*OWN_NETWORK, "-", sys.executable, "-c", IN_ONE_PROCESS]
    ran = subprocess.run(command, check=True, capture_output=True, text=True, timeout=100)
    assert int(ran.stdout) >= SENT


def test_a_request_that_the_kernel_drops_is_sent_again_at_once(lonely):
    # the order to stop is such a request, and large tables fill the same socket
    pid = lonely()
    with RosClient("asks", lonely.domain) as asks:
        client = asks.node.create_client(ListParameters, "/lonely/list_parameters")
        flood = asks.node.create_publisher(String, "flood", qos_profile_sensor_data)
        asks.wait_for(client.service_is_ready, 20.0, "the services of the node")
        asks.wait_for(lambda: flood.get_subscription_count() == 1, 20.0, "its subscription")
        os.kill(pid, signal.SIGSTOP)
        for size in (*[4_000_000] * 4, *[1] * 4000):  # small ones fill the rest of the buffer
            flood.publish(String(data="x" * size))
        answer = client.call_async(ListParameters.Request())
        dropped = _drops(pid)
        os.kill(pid, signal.SIGCONT)
        woken = time.monotonic()
        asks.wait_for(answer.done, 20.0, "the answer")
        took_s = time.monotonic() - woken
    assert dropped > 0, "nothing was dropped, so this test shows nothing"
    assert took_s < 1.5  # the middleware's own settings send it again after 3 s


def _drops(pid):
    """Return how many packets the UDP sockets of a process have dropped."""
    lines = Path(f"/proc/{pid}/net/udp").read_text().splitlines()[1:]
    return sum(int(line.split()[12]) for line in lines if line.split()[9] in inodes(pid))


def test_what_a_node_writes_is_readable_by_its_owner_only(lonely, tmp_path):
    pid = lonely(ROS_AUTOMATIC_DISCOVERY_RANGE="SUBNET")  # with shared memory

    def modes():
        found = [path for path in shared(pid) if path.exists()]
        assert found, "no shared memory is in use, so this test shows nothing"
        written = [tmp_path / "written", *(tmp_path / "log").glob("*.log"), *found]
        return {path.name: stat.S_IMODE(path.stat().st_mode) & 0o077 for path in written}

    with RosClient("waits") as waits:  # the node may still be at it
        waits.wait_for(lambda: not any(modes().values()), 20.0, lambda: str(modes()))
