# SPDX-License-Identifier: Apache-2.0
"""The SROS 2 policy grants what the nodes declare, and orders to few."""

import xml.etree.ElementTree as ET

import pytest
import security

pytestmark = pytest.mark.timeout(300)


@pytest.fixture(scope="module")
def root():
    return ET.fromstring(security.POLICY.read_text())


def holders(root, right, name):
    """Return the enclaves with a right: "publish", "subscribe", "reply" or "request"."""
    found = set()
    for enclave in root.iter("enclave"):
        for group in enclave.iter():
            if group.get(right) == "ALLOW" and f"/{name}" in {each.text for each in group}:
                found.add(enclave.get("path").rpartition("/")[2])
    return found


def test_the_policy_is_what_the_nodes_declare(new_domain):
    old, new = (text.splitlines() for text in (
        security.POLICY.read_text(), security.policy(new_domain())
    ))  # fmt: skip
    assert old == new, f"run tools/security.py: {sorted(set(old) ^ set(new))[:5]}"


def test_orders_come_from_those_alone_that_make_them(root):
    clients = {"operator", "gateway", "console"}
    # the console shows a plane and passes on orders; targets come from observatories
    assert holders(root, "publish", "focal_plane/targets") == {"bridge", "operator", "gateway"}
    assert holders(root, "publish", "focal_plane/trajectory") == {"planner"}
    assert holders(root, "publish", "focal_plane/segments") == {"discretizer"}
    for service in ("start", "stop", "home", "turn", "clear", "configure"):
        assert holders(root, "reply", f"focal_plane/{service}") == {"bridge"}
        least = clients - ({"console"} if service == "turn" else set())  # it needs a camera
        assert holders(root, "request", f"focal_plane/{service}") == least
    assert holders(root, "request", "bridge/set_parameters") == clients
    # only the bridge may claim the plane
    assert holders(root, "subscribe", "focal_plane/_bridge_session_*") == {"bridge"}


def test_a_monitor_hears_everything_and_says_nothing(root):
    (monitor,) = (e for e in root.iter("enclave") if e.get("path") == "/focal_plane/monitor")
    said = {t.text for group in monitor.iter("topics") if group.get("publish") for t in group}
    assert said == {"/rosout", "/parameter_events"} and not list(monitor.iter("services"))
    heard = {t.text for group in monitor.iter("topics") if group.get("subscribe") for t in group}
    assert {"/focal_plane/layout", "/focal_plane/joint_states", "/focal_plane/outcome"} <= heard
