# SPDX-License-Identifier: Apache-2.0
"""The bridge takes layout and starts from files of any format, and logs what it does not use."""

import numpy as np
import pytest

from fiber_bus_bridge.node import BridgeNode
from fiber_bus_bridge.simulation import SimulationConfig, simulated_plane
from fiber_core.errors import FiberError
from fiber_node import RosClient

LAYOUT = (
    "LOCATION;X_MM;Y_MM;ARM_THETA_MM;ARM_PHI_MM;nonfunctional;colour\n"
    "7;0;0;3;3;no;red\n5;10.4;0;3;3;no;red\n6;20.8;0;3;3;yes;blue\n"
)
STARTS = "id,theta_deg,phi_deg\n5,10,150\n6,20,160\n7,30,140\n"


@pytest.fixture
def files(tmp_path):
    (tmp_path / "layout.csv").write_text(LAYOUT)
    (tmp_path / "starts.csv").write_text(STARTS)
    return {name: str(tmp_path / f"{name}.csv") for name in ("layout", "starts")}


def test_robots_stand_where_the_file_of_starts_says(files):
    plane, start = simulated_plane(SimulationConfig(**files))
    assert plane.ids.tolist() == [5, 6, 7] and plane.enabled.tolist() == [True, False, True]
    np.testing.assert_allclose(np.rad2deg(start), [[10, 150], [20, 160], [30, 140]])
    assert plane.spacing_mm == 0.0
    assert simulated_plane(SimulationConfig(**files, spacing_mm=5.0))[0].spacing_mm == 5.0


@pytest.mark.timeout(600)
def test_the_bridge_logs_what_it_read_and_what_it_does_not_use(files, capfd):
    with RosClient("rest") as peer:
        peer.add_node(BridgeNode, **files)
    logged = capfd.readouterr().err
    assert "layout.csv: 3 robots, 1 disabled; from preset desi: " in logged
    assert "columns not used: colour" in logged
    assert "starts.csv: present angles of 3 robots" in logged


@pytest.mark.timeout(600)
def test_a_misspelt_column_ends_the_bridge(files, tmp_path):
    (tmp_path / "layout.csv").write_text(LAYOUT.replace("nonfunctional", "nonfunctinal"))
    with RosClient("rest") as peer, pytest.raises(FiberError, match="is nonfunctional meant?"):
        peer.add_node(BridgeNode, **files)
