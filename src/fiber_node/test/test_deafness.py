# SPDX-License-Identifier: Apache-2.0
"""A process whose thread of the middleware does not receive any more ends; any other goes on."""

import os
import subprocess
import sys

import pytest

from fiber_node.deafness import DEAF_CODE

pytestmark = [
    pytest.mark.timeout(60),
    pytest.mark.skipif(not os.path.isdir("/proc/self/task"), reason="NOT TESTED: needs Linux"),
]

# a thread with the name of one of Fast DDS, at a socket to which something is sent all the time
PROCESS = """
import socket, subprocess, sys, threading, time
from pathlib import Path
from fiber_node import deafness

deafness._LOOK_S = 0.1
inbox, other = [socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(2)]
inbox.bind(("127.0.0.1", 0))
place = inbox.getsockname()
kind, to = sys.argv[1], place
if kind == "another's":  # has a socket with the same port at another address, and does not read it
    to = ("127.0.0.2", place[1])
    code = f"import socket, time; s = socket.socket(socket.AF_INET, socket.SOCK_DGRAM); "
    code += f"s.bind({to}); print(flush=True); time.sleep(4)"
    child = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE)
    child.stdout.readline()

def receive():
    name = "dds.udp." if kind != "another" else "dds.shm."
    Path(f"/proc/self/task/{threading.get_native_id()}/comm").write_text(f"{name}{place[1]}")
    while kind == "hears":
        inbox.recv(100)
    while kind == "slow":
        inbox.recv(100)
        time.sleep(0.3)
    never = threading.Lock()
    never.acquire()
    never.acquire()

threading.Thread(target=receive, daemon=True).start()
deafness.watch_hearing()
end = time.monotonic() + 3.0
while time.monotonic() < end:
    other.sendto(b"announcement", to)
    time.sleep(0.01)
"""


@pytest.mark.parametrize(
    ("kind", "code"),
    [("deaf", DEAF_CODE), ("hears", 0), ("slow", 0), ("another", 0), ("another's", 0)],
)
def test_a_process_that_does_not_receive_any_more_ends(kind, code):
    done = subprocess.run(
        [sys.executable, "-c", PROCESS, kind], capture_output=True, text=True, check=False
    )
    assert done.returncode == code, done.stderr
    assert ("has not received at port" in done.stderr) == (kind == "deaf")


# PyDLL keeps the interpreter's lock for the call, as rclpy does where it destroys a subscription
FROZEN = """
import ctypes, os, sys, time
from fiber_node import deafness

deafness._LOOK_S, deafness._FROZEN_S = 0.1, 4.0
deafness.watch_hearing()
end = time.monotonic() + 5.0
while time.monotonic() < end:
    time.sleep(0.01)
print("goes on", flush=True)
if sys.argv[1] == "frozen":
    ctypes.PyDLL(None).sleep(40)
os._exit(0)
"""


@pytest.mark.parametrize(("kind", "code"), [("frozen", 1), ("well", 0)])
def test_a_process_whose_interpreter_stands_still_tells_where_and_ends(kind, code):
    done = subprocess.run(
        [sys.executable, "-c", FROZEN, kind], capture_output=True, text=True, check=False
    )
    assert done.stdout == "goes on\n"
    assert done.returncode == code, done.stderr
    assert ("Timeout" in done.stderr and "line 12" in done.stderr) == (kind == "frozen")
