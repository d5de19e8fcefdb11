# SPDX-License-Identifier: Apache-2.0
"""The architecture: which package may import which.

An arrow A -> B means: A may import B, and everything that B may import. A compartment is a
package or a part of one; the longest name in `ARROWS` that a module starts with is its compartment.
"""

import sys

import import_graph
import pytest
import state_diagram
from import_graph import imports
from packages import MODULES, PACKAGES, imports_of, starts

STOCK_MESSAGES = {
    "builtin_interfaces",
    "diagnostic_msgs",
    "geometry_msgs",
    "lifecycle_msgs",
    "sensor_msgs",
    "std_msgs",
    "std_srvs",
    "trajectory_msgs",
}
NODES = {
    "fiber_planner.node",
    "fiber_discretizer.node",
    "fiber_bus_bridge.node",
    "fiber_recording.node",
    "fiber_metrology.node",
    "fiber_metrology.camera.node",
}
ROS = {"rclpy", "rcl_interfaces"}
ARROWS = {
    "fiber_core": {"numpy", "numba", "scipy"},
    "fiber_formats": {"fiber_core", "numpy", "astropy"},
    "fiber_metrology": {"fiber_core"},
    "fiber_metrology.node": {"fiber_metrology", "fiber_node"} | ROS,
    "fiber_metrology.camera.node": {"fiber_metrology", "fiber_node", "fiber_bus_bridge.plant"}
    | ROS,
    "fiber_msgs_py": {"fiber_core", "rclpy.qos"} | STOCK_MESSAGES,
    "fiber_node": {"fiber_core", "fiber_msgs_py", "ament_index_python", "yaml"} | ROS,
    "fiber_planner": {"fiber_core"},
    "fiber_planner.node": {"fiber_planner", "fiber_node"} | ROS,
    "fiber_discretizer": {"fiber_core"},
    "fiber_discretizer.node": {"fiber_discretizer", "fiber_node"} | ROS,
    "fiber_bus_bridge": {"fiber_core", "yaml", "vcd", "smbus2"},
    "fiber_bus_bridge.simulation": {"fiber_bus_bridge", "fiber_formats"},
    "fiber_bus_bridge.plant": {"fiber_bus_bridge.simulation"},
    "fiber_bus_bridge.node": {"fiber_bus_bridge.node.hardware"},
    "fiber_bus_bridge.node.hardware": {"fiber_bus_bridge.plant", "fiber_node"} | ROS,
    "fiber_sectors": {"fiber_bus_bridge"},
    "fiber_sectors.node": {"fiber_sectors", "fiber_bus_bridge.node", "fiber_node"} | ROS,
    "fiber_client": {"fiber_node", "fiber_formats", "rich"} | ROS,
    "fiber_client.wiring": {"fiber_client", "fiber_metrology"},
    "fiber_client.gateway": {"fiber_client", "fiber_interfaces"},
    "fiber_recording": {"fiber_bus_bridge"},
    "fiber_recording.node": {
        "fiber_recording.measured_images",
        "fiber_recording.received_plans",
        "fiber_node",
    }
    | ROS,
    "fiber_recording.measured_images": {"fiber_recording", "fiber_msgs_py"},
    "fiber_recording.received_plans": {"fiber_recording", "fiber_msgs_py"},
    "fiber_recording.settled_replay": {"fiber_recording", "fiber_client"},
    "fiber_recording.bag": {"fiber_recording", "fiber_msgs_py", "rosbags"} | ROS,
    "fiber_viewer": {"fiber_recording", "matplotlib"},
    "fiber_viewer.node": {"fiber_viewer", "fiber_node", "visualization_msgs"} | ROS,
    "fiber_console": {"fiber_client", "fiber_msgs_py", "fiber_viewer", "tornado"} | ROS,
    "fiber_positioners": {
        "fiber_planner",
        "fiber_discretizer",
        "fiber_bus_bridge.simulation",
        "fiber_metrology",
        "fiber_viewer",
        "rich",
    },
    "fiber_bringup": {
        "fiber_bus_bridge.plant",
        "fiber_client",
        "fiber_positioners",
        "fiber_viewer",
        "fiber_viewer.node",
        "ament_index_python",
    }
    | NODES,
    "bench": {
        "fiber_planner",
        "fiber_discretizer",
        "fiber_bus_bridge.plant",
        "fiber_viewer",
        "fiber_positioners",
    },
    "bench.goals": {"bench", "planners"},
    "bench.identification": {"bench", "closed_loop"},
    "bench.sectors": {"bench", "fiber_sectors", "sector_judge", "sector_plane"},
    "bench.sector_beats": {"bench", "fiber_bus_bridge.plant", "fiber_sectors"},
    "bench.sector_hosts": {"fiber_bus_bridge.plant", "fiber_sectors", "numpy"},
    "bench.sector_judge": {"bench"},
    "bench.sector_plane": {"bench", "fiber_sectors", "sector_hosts", "sector_judge"},
    "bench.kill": {"fiber_node", "kill_campaign", "kill_jobs", "kill_table"},
    "bench.kill_campaign": {"fiber_bringup", "forked_processes", "kill_judge", "kill_others"},
    "bench.sector_faults": {
        "bench",
        "kill_jobs",
        "kill_table",
        "sector_hosts",
        "sector_judge",
        "sector_plane",
        "sectors",
    },
    "bench.joins": {"fiber_bringup", "fiber_client", "fiber_node", "numpy"},
    "bench.kill_jobs": {"fiber_node"},
    "bench.kill_judge": {"fiber_bus_bridge.plant", "fiber_msgs_py"},
    "bench.memory": {"fiber_bringup", "forked_processes"},
    "bench.manners": {"fiber_bringup", "processor_time"},
    "bench.forked_preload": {"bench", "forked_processes"},
    "bench.forked_processes": {"fiber_bringup"},
    "bench.paper": {"bench", "paper_runs"},
    "bench.paper_runs": {"bench", "bus", "discretizers", "dnf_family"},
    "bench.drive_checker": {"gap_judge", "numpy", "scipy"},  # shares no code with what it judges
    "bench.gap_judge": {"numba", "numpy", "scipy"},  # neither
    "bench.motors": {
        "bench",
        "closed_loop",
        "correction_field",
        "drive_checker",
        "linear_robots",
        "listed_checker",
        "motors_table",
    },
    "bench.motors_table": {"numpy"},
    "bench.geometry": {"bench", "gap_judge", "motor_judge"},
    "bench.linear_robots": {"bench", "closed_loop"},
    "bench.listed_checker": {"gap_judge", "numpy"},  # neither
    "bench.motor_judge": {"numpy"},  # neither
    "bench.kaiju_adapter": {"kaiju", "numpy"},  # runs in the Python of the rival
    "bench.kill_others": {"fiber_client"},
    "bench.soak": {"bench", "soak_judge"},
    "bench.soak_judge": {"bench"},
}
# Compartments that may import the simulated plant directly. Run-time code for real buses may not;
# the demonstration may, because it checks the names of faults before it starts the bridge.
SIMULATION_USERS = (
    "fiber_bus_bridge.simulation",
    "fiber_bus_bridge.plant",
    "fiber_bus_bridge.node.hardware",
    "fiber_metrology.camera.node",
    "fiber_positioners",
    "fiber_bringup.demo",
    "bench",
)


def compartment_of(module: str) -> str | None:
    return max((name for name in ARROWS if starts(module, name)), key=len, default=None)


def reachable(compartment: str) -> set[str]:
    """Return every module name prefix that a compartment may import."""
    seen, todo = set(), [compartment]
    while todo:
        name = todo.pop()
        if name not in seen:
            seen.add(name)
            todo += ARROWS.get(name, ())
    return seen


def may_import(compartment: str, target: str) -> bool:
    if target.split(".")[0] in sys.stdlib_module_names:
        return True
    target_compartment = compartment_of(target)
    if target_compartment is not None:
        return target_compartment in reachable(compartment)
    return any(starts(target, allowed) for allowed in reachable(compartment))


def forbidden(module: str, targets: list[str]) -> list[str]:
    compartment = compartment_of(module)
    return [f"{module} -> {t}" for t in targets if not may_import(compartment, t)]


def test_no_import_leaves_the_allowed_arrows():
    assert {"fiber_core.kinematics", "fiber_msgs_py.table"} <= set(MODULES)
    wrong = [arrow for module in MODULES for arrow in forbidden(module, imports_of(module))]
    assert not wrong, "\n".join(wrong)


@pytest.mark.parametrize(
    ("module", "source"),
    [
        ("fiber_core.kinematics", "import rclpy"),
        ("fiber_core.kinematics", "def f():\n    from fiber_planner import dnf"),
        ("fiber_core", "from importlib import import_module\nimport_module('sensor_msgs.msg')"),
        ("fiber_planner.dnf", "import fiber_discretizer.makarem2014.margin"),
        ("fiber_planner.dnf", "from fiber_msgs_py import targets"),
        ("fiber_planner.dnf", "from . import node"),
        ("fiber_planner", "from fiber_planner import node"),
        ("fiber_planner.node", "from fiber_discretizer.node import main"),
        ("fiber_planner.node", "import fiber_bringup"),
        ("fiber_msgs_py.table", "from rclpy.node import Node"),
        ("fiber_msgs_py.table", "from fiber_bus_bridge.wire import Frames"),
        ("fiber_bus_bridge.wire.frames", "from ...fiber_planner import dnf"),
        ("fiber_bus_bridge.session", "from fiber_bus_bridge.simulation import Positioners"),
        ("fiber_bus_bridge.simulation.lines", "import rclpy"),
        ("fiber_viewer.snapshot", "import fiber_planner"),
        ("bench.plan_field", "import fiber_msgs_py.topics"),
        ("bench.drive_checker", "from fiber_core.drive import carried_out"),
        ("bench.listed_checker", "from fiber_core.drive import rules_broken"),
        ("bench.gap_judge", "from fiber_core.clearance import certify"),
        ("fiber_core.kinematics", "import pandas"),
    ],
)
def test_a_planted_import_is_caught(module, source):
    known = set(MODULES) | {"fiber_planner.node"}
    targets = imports(source, module, module in PACKAGES, known)
    assert forbidden(module, [t for t in targets if t != "importlib"])


@pytest.mark.parametrize(
    ("module", "source"),
    [
        ("fiber_core.motion", "import numpy as np\nfrom fiber_core.errors import MotionError"),
        ("fiber_planner.node", "import rclpy\nfrom fiber_planner import dnf"),
        ("fiber_planner.node", "from std_srvs.srv import Trigger"),
        ("fiber_bus_bridge.wire", "from .frames import Frames\nimport numba"),
        ("fiber_bringup.graph", "from fiber_planner.node import main\nimport fiber_core"),
    ],
)
def test_an_allowed_import_is_let_through(module, source):
    is_package = module == "fiber_bus_bridge.wire"
    assert not forbidden(module, imports(source, module, is_package, set(MODULES)))


def simulation_imports(module: str, targets: list[str]) -> list[str]:
    if any(starts(module, user) for user in SIMULATION_USERS):
        return []
    return [f"{module} -> {t}" for t in targets if starts(t, "fiber_bus_bridge.simulation")]


def test_the_simulated_plant_is_imported_only_where_hardware_is_chosen():
    assert "fiber_bus_bridge.simulation.positioners" in MODULES
    wrong = [
        arrow for module in MODULES for arrow in simulation_imports(module, imports_of(module))
    ]
    assert not wrong, "\n".join(wrong)
    planted = "from fiber_bus_bridge.simulation import Positioners"
    for module in (
        "fiber_bus_bridge.session",
        "fiber_bus_bridge.node.bridge",
        "fiber_viewer.scene",
    ):
        assert simulation_imports(module, imports(planted, module, False, set(MODULES)))


def test_the_picture_of_the_packages_is_made_from_the_imports():
    page = import_graph.PAGE.read_text()
    assert import_graph.mermaid() in page, "stale: run python3 tools/import_graph.py"
    assert ("fiber_planner", "fiber_core") in import_graph.package_arrows()


def test_the_diagram_of_the_protocol_is_made_from_its_table(monkeypatch):
    page = state_diagram.PAGE.read_text()
    assert state_diagram.fresh(page) == page, "stale: run make pictures"
    state, event = state_diagram.State.READY, state_diagram.Event.START
    monkeypatch.delitem(state_diagram.TRANSITIONS, (state, event))
    assert state_diagram.fresh(page) != page
