# SPDX-License-Identifier: Apache-2.0
"""Robots with both elbows in range whose counters tell nothing: turns of phi, through the nodes."""

import numpy as np
import pytest
from night import COMPILE_S, Night

from fiber_bus_bridge.plant import touching
from fiber_bus_bridge.simulation import true_angles
from fiber_client.recover import recover

pytestmark = pytest.mark.timeout(600)


@pytest.fixture(scope="module")
def night(tmp_path_factory, new_domain):
    folder = tmp_path_factory.mktemp("night")
    made = Night(
        folder, new_domain(), simulation={"volatile": True}, preset="desi_petals",
        memory=str(folder / "memory.json"), **{"session.counters_kept": False},
    )  # fmt: skip
    yield made
    made.end()


def test_small_turns_of_phi_tell_the_elbow_of_each_robot_that_is_found(night):
    client = night.client
    both = (client.plane.limits[:, 1, 0] < 0.0) & (client.plane.limits[:, 1, 1] > 0.0)
    both |= client.plane.limits[:, 1, 1] > np.pi
    assert both.all() and (client.unplaced == 1).all()
    night.true_fibres()
    before = true_angles(night.camera._mechanics, night.camera._arms)
    ended = recover(client, COMPILE_S, to_stops=False)
    lit = night.camera._lit
    assert len(ended.found) >= 0.7 * lit.sum()
    night.true_fibres()
    true = true_angles(night.camera._mechanics, night.camera._arms)
    turned = np.abs(true - before).max(axis=0)
    assert turned[1] > 0.0 and turned.max() < 0.02
    rows = client.plane.index_of(np.asarray(ended.found))
    off = client.angles[rows] - true[rows]
    assert np.abs(off[:, 1]).max() < 0.1  # the other elbow would be twice phi away
    assert np.abs(np.remainder(off[:, 0] + np.pi, 2 * np.pi) - np.pi).max() < 0.1
    truth = night.camera._truth.since(0)
    exact = night.graph.nodes[0]._hardware.plane
    assert not touching(exact, truth, night.camera._mechanics).unsafe.any()
