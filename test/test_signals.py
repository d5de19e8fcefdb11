# SPDX-License-Identifier: Apache-2.0
"""A node ends when it is told to, while it starts and while it works."""

import importlib.util
import os
import signal
import subprocess
import sys
import time
from contextlib import ExitStack
from pathlib import Path

import numpy as np
import pytest

from fiber_bus_bridge.node import BridgeNode
from fiber_core.fields import random_problem
from fiber_core.presets import preset
from fiber_msgs_py import PlanStamp, progress, session_of, targets, topics
from fiber_node import DISCRETIZER, Claim, RosClient

pytestmark = pytest.mark.timeout(120)

ENDS_S = 45.0  # less than the wait takes
SIGNALS = (signal.SIGINT, signal.SIGTERM)
with pytest.MonkeyPatch.context() as patch:
    patch.syspath_prepend(Path(__file__).parents[1] / "bench")
    PROCESSORS = importlib.import_module("processor_time")


def started(module, domain, *arguments, said="settings: "):
    """Start a node; return its process once it has said something."""
    code = f"import sys; from {module} import main; sys.exit(main())"
    process = subprocess.Popen(
        [sys.executable, "-c", code, "--ros-args", *arguments],
        env=os.environ | {"ROS_DOMAIN_ID": str(domain)},
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )
    for line in process.stdout:
        if said in line:
            return process
    raise AssertionError(f"{module} has ended with code {process.wait()}")


def ends_with_code_0(process, how):
    """Tell a process to end; return the time of the processors that this takes."""
    begin, before = time.monotonic(), PROCESSORS.processor_s(process.pid)
    earlier = PROCESSORS.of_children_s()
    process.send_signal(how)
    try:
        text, _ = process.communicate(timeout=ENDS_S)
    finally:
        process.kill()
    took = PROCESSORS.of_children_s() - earlier - before
    print(f"{how.name}: ended after {time.monotonic() - begin:.2f} s, processors {took:.2f} s")
    assert process.returncode == 0 and "Traceback" not in text, text
    return took


@pytest.mark.parametrize(
    "module", ["fiber_planner.node", "fiber_discretizer.node", "fiber_viewer.node"]
)
def test_a_node_that_waits_needs_little_to_end(new_domain, module):
    # of the second in which it ends, on a machine with other work
    process = started(module, new_domain(), said="waits for")
    assert ends_with_code_0(process, signal.SIGTERM) < 0.15


@pytest.mark.parametrize(
    ("module", "said", "how"),
    [
        ("fiber_viewer.node", "waits for", signal.SIGINT),
        ("fiber_console.node", "the console is at", signal.SIGINT),
        ("fiber_console.node", "the console is at", signal.SIGTERM),
    ],
)
def test_signals_that_follow_the_first_do_not_break_into_the_end(
    new_domain, tmp_path, module, said, how
):
    # a terminal and a launch both tell a node to end
    given = ("-p", "port:=0", "-p", f"token_file:={tmp_path / 'token'}")
    process = started(module, new_domain(), *given, said=said)
    try:
        while process.poll() is None:
            process.send_signal(how)
            time.sleep(0.002)
        text, _ = process.communicate(timeout=ENDS_S)
    finally:
        process.kill()
    assert process.returncode == 0 and "Traceback" not in text, text


@pytest.mark.parametrize("how", SIGNALS)
def test_a_bridge_ends_while_it_waits_for_its_plant(new_domain, tmp_path, how):
    # it waits for a minute
    plant = f"plant:={tmp_path / 'plant.sock'}"
    ends_with_code_0(
        started("fiber_bus_bridge.node.bridge", new_domain(), "-p", "robots:=7", "-p", plant), how
    )


@pytest.mark.parametrize("how", SIGNALS)
def test_a_coordinator_ends_while_it_waits_for_its_sectors(new_domain, how):
    domain = new_domain()
    process = started("fiber_sectors.node.coordinator", domain, "-p", "robots:=61")
    with ExitStack() as stack:
        stack.callback(process.kill)
        peer = stack.enter_context(RosClient("peer", domain))
        peer.wait_for(
            lambda: ("bridge_links", "/") in peer.node.get_node_names_and_namespaces(), ENDS_S
        )
        ends_with_code_0(process, how)


@pytest.mark.parametrize("module", ["fiber_console.node", "fiber_client.gateway"])
def test_a_node_with_a_main_of_its_own_names_sections_that_do_not_apply(
    new_domain, tmp_path, module
):
    if module == "fiber_client.gateway" and importlib.util.find_spec("fiber_interfaces") is None:
        pytest.skip("NOT TESTED: the gateway; fiber_interfaces is not built (no compiler?)")
    file = tmp_path / "params.yaml"
    name = module.split(".")[-1].replace("node", "console")
    file.write_text(f"/north/{name}:\n  ros__parameters: {{port: 0}}\n")
    options = "--params-file", str(file), "-p", "port:=0"
    said = f"north/{name} of {file} does not apply to /{name}"
    process = started(module, new_domain(), *options[: 4 if "console" in module else 2], said=said)
    ends_with_code_0(process, signal.SIGTERM)


PLANE = preset("desi", 19)
SLOW = ("planner:=dnf", "dnf.dt_s:=1.0e-5", "dnf.horizon_s:=9.0")  # it plans for minutes


def planner_says(messages):
    decoded = map(progress.decode, messages)
    return [each.text for each in decoded if each.stage == "planner"]


@pytest.mark.parametrize("how", SIGNALS)
def test_a_planner_ends_while_it_plans(new_domain, how):
    domain = new_domain()
    process = started("fiber_planner.node", domain, *(x for each in SLOW for x in ("-p", each)))
    with ExitStack() as stack:
        stack.callback(process.kill)
        peer = stack.enter_context(RosClient("peer", domain))
        layouts, told = peer.collect(topics.LAYOUT), peer.collect(topics.PROGRESS)
        trajectories = peer.collect(topics.TRAJECTORY)
        publisher = topics.TARGETS.publisher(peer.node)
        peer.add_node(BridgeNode, preset="desi", robots=19, time_scale=0.0)
        Claim(peer.node, DISCRETIZER)
        peer.wait_for(lambda: layouts and publisher.get_subscription_count() == 2, ENDS_S)
        xy_mm = random_problem(PLANE, np.random.default_rng(2)).targets
        stamp = PlanStamp(time.time_ns())
        publisher.publish(targets.encode(PLANE.ids, xy_mm, stamp, session_of(layouts[-1])))
        peer.wait_for(lambda: any("s of motion" in text for text in planner_says(told)), ENDS_S)
        ends_with_code_0(process, how)
        peer.wait_for(lambda: not peer.node.count_publishers(topics.TRAJECTORY.name), ENDS_S)
    assert not trajectories and not any("arrive" in text for text in planner_says(told))


EARLY = """
import asyncio, os, signal, sys
from asyncio import events
made = events.new_event_loop

def interrupted():
    os.kill(os.getpid(), signal.SIGTERM)
    return made()

events.new_event_loop = interrupted
from fiber_console.node import main
sys.exit(main(["--ros-args", "-p", "port:=0"]))
"""


def test_a_signal_while_the_loop_of_the_console_is_made_ends_it(new_domain):
    ran = subprocess.run(
        [sys.executable, "-c", EARLY],
        env=os.environ | {"ROS_DOMAIN_ID": str(new_domain())},
        capture_output=True, text=True, timeout=ENDS_S, check=False,
    )  # fmt: skip
    assert ran.returncode == 0, ran.stderr
    assert "Traceback" not in ran.stderr and "never awaited" not in ran.stderr
