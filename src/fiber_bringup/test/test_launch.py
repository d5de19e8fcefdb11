# SPDX-License-Identifier: Apache-2.0
"""Launch file, parameter file and nodes agree, checked without launching."""

import array
import ast
import json
import re
from pathlib import Path

import pytest
import rclpy
import yaml
from rclpy.context import Context
from sensor_msgs.msg import PointCloud2
from visualization_msgs.msg import MarkerArray

from fiber_bringup.graph import Graph
from fiber_bus_bridge.plant import main
from fiber_bus_bridge.simulation import SimulationConfig
from fiber_console.node import ConsoleNode
from fiber_msgs_py import FRAME_ID
from fiber_msgs_py.topics import JOINT_STATES, VIEW_ARMS, VIEW_PLANE, VIEW_TARGETS
from fiber_viewer.node import WATCHED

SHARE = Path(__file__).parents[1]
VIEWS = VIEW_ARMS, VIEW_PLANE, VIEW_TARGETS, WATCHED
TREE = ast.parse((SHARE / "launch" / "focal_plane.launch.py").read_text())


_NOTED = {("recorder", "seed"), ("recorder", "planner")}
# a bridge alone simulates its robots itself
_OF_LAUNCH = {("bridge", "plant")}


def calls(name):
    return [
        node
        for node in ast.walk(TREE)
        if isinstance(node, ast.Call) and ast.unparse(node.func) == name
    ]


def _plain(value):
    return list(value) if isinstance(value, array.array) else value


def keywords(call):
    return {keyword.arg: keyword.value for keyword in call.keywords}


def nodes():
    """Name of each node started, and names and types of parameters set from arguments."""
    found = {}
    for call in calls("Node"):
        given = keywords(call)
        typed = {}
        for entry in given["parameters"].elts:
            if isinstance(entry, ast.Dict):
                for key, value in zip(entry.keys, entry.values):
                    assert ast.unparse(value.args[0]) == f"LaunchConfiguration('{key.value}')"
                    typed[key.value] = ast.unparse(keywords(value)["value_type"])
        found[ast.literal_eval(given["name"])] = typed
    return found


def plant_arguments():
    """Launch arguments that the plant is given, and the option of each."""
    (call,) = calls("ExecuteProcess")
    found = {}
    for part in keywords(call)["cmd"].elts:
        if isinstance(part, ast.List) and "LaunchConfiguration" in ast.unparse(part):
            option, value = part.elts
            found[value.args[0].value] = option.value
    return found


@pytest.fixture(scope="module")
def declared(new_domain):
    """Parameters of every node, with their values, as the nodes declare them."""
    context = Context()
    rclpy.init(args=[], context=context, domain_id=new_domain())
    console = ConsoleNode(context=context)  # a process of its own, not part of a graph
    with Graph(bridge={"robots": 7}, recorder={}, viewer={}, domain=new_domain()) as graph:
        found = {
            node.get_name(): {
                name: _plain(parameter.value)
                for name, parameter in node.get_parameters_by_prefix("").items()
            }
            for node in [*graph.nodes, console]
        }
    console.destroy_node()
    context.try_shutdown()
    return found


def test_every_argument_is_declared_and_used():
    arguments = {call.args[0].value for call in calls("DeclareLaunchArgument")}
    of_nodes = {name for typed in nodes().values() for name in typed}
    of_all = {"namespace", "params_file", "use_sim_time", "log_level", "use_respawn", "console"}
    for name in of_all:
        assert f"LaunchConfiguration('{name}')" in ast.unparse(TREE), name
    arguments -= of_all
    assert arguments == of_nodes | set(plant_arguments()) - of_all
    known = {"preset", "robots", "seed", "layout", "problem", "planner", "time_scale", "folder"}
    assert known | {"starts", "disabled_file", "plant", "faults", "spacing_mm", "port"} == arguments


def test_arguments_have_the_type_of_the_parameter_they_set(declared):
    defaults = {
        call.args[0].value: keywords(call)["default_value"].value
        for call in calls("DeclareLaunchArgument")
        if isinstance(keywords(call)["default_value"], ast.Constant)
    }
    for node, typed in nodes().items():
        for name, kind in typed.items():
            value = declared[node][name]
            assert type(value).__name__ == kind, name
            # a recorder writes down what the other nodes were given, and has no default of its own
            if name != "robots" and (node, name) not in _NOTED | _OF_LAUNCH:
                assert type(value)(defaults[name]) == value, name


def test_the_parameter_file_holds_the_defaults_of_parameters_that_exist(declared):
    content = yaml.safe_load((SHARE / "config" / "focal_plane.yaml").read_text())
    content = {name.removeprefix("/**/"): entry for name, entry in content.items()}
    plant = content.pop("plant")["ros__parameters"]
    assert plant and plant == {name: getattr(SimulationConfig(), name) for name in plant}
    assert plant["clock"] == content["bridge"]["ros__parameters"]["clock"]
    assert set(content) == set(declared) == set(nodes())
    for node, entry in content.items():
        assert entry["ros__parameters"]
        for name, value in entry["ros__parameters"].items():
            assert declared[node][name] == value and type(declared[node][name]) is type(value), name
            assert name not in nodes()[node], f"{name} is set by the launch file anyway"


def test_the_plant_has_the_options_that_the_launch_file_gives_it(tmp_path, monkeypatch):
    monkeypatch.setattr(main, "_serve", lambda options: served.append(options))
    served = []
    given = plant_arguments()
    assert {name for name in given if name in nodes()["bridge"]} == set(given) - {
        "faults",
        "namespace",
    }
    values = {"robots": "7", "seed": "3", "time_scale": "0.5", "faults": "stall", "plant": "auto"}
    parameters = SHARE / "config" / "focal_plane.yaml"
    options = [f"{option}{values.get(name, '')}" for name, option in given.items()]
    assert main.main([f"--params-file={parameters}", *options]) == 0
    assert served[0].robots == 7 and served[0].faults == "stall" and served[0].socket == "auto"
    assert served[0].clock == "1M" and served[0].time_scale == 0.5
    (tmp_path / "wrong.yaml").write_text("plant: {ros__parameters: {clocks: 1M}}")
    assert main.main([f"--params-file={tmp_path / 'wrong.yaml'}"]) == 2


def test_files_of_the_launch_file_are_installed():
    named = set(re.findall(r'"([\w.]+\.(?:yaml|xml|rviz))"', ast.unparse(TREE).replace("'", '"')))
    packages = {"focal_plane.yaml": "fiber_bringup", "fastdds.xml": "fiber_node"}
    assert named == set(packages)
    for name, package in packages.items():
        assert (SHARE.parent / package / "config" / name).is_file()
        setup = (SHARE.parent / package / "setup.py").read_text()
        assert 'glob("config/*")' in setup or f'"config/{name}"' in setup
        assert f"FindPackageShare('{package}')" in ast.unparse(TREE)


def test_every_node_of_the_launch_file_is_an_executable_of_its_package():
    for call in calls("Node"):
        given = {name: ast.literal_eval(keywords(call)[name]) for name in ("package", "executable")}
        setup = (SHARE.parent / given["package"] / "setup.py").read_text()
        assert f'"{given["executable"]} = {given["package"]}.' in setup


def test_discovery_stays_on_this_machine_by_default():
    for call in calls("SetEnvironmentVariable"):
        inner = call.args[1]
        assert ast.unparse(inner.func) == "EnvironmentVariable"
        assert inner.args[0].value == call.args[0].value
    values = {
        c.args[0].value: keywords(c.args[1])["default_value"]
        for c in calls("SetEnvironmentVariable")
    }
    assert values["ROS_AUTOMATIC_DISCOVERY_RANGE"].value == "LOCALHOST"


# fields of a display in RViz 14.1 (Jazzy), which drops unknown fields in silence
READ_BY_RVIZ = set(
    "Alpha,Class,Color,Color Transformer,Enabled,Name,Position Transformer,Size (Pixels),Size (m),"
    "Style,Topic,Topic/Depth,Topic/Durability Policy,Topic/History Policy,"
    "Topic/Reliability Policy,Topic/Value".split(",")
)


def test_rviz_shows_what_the_viewer_publishes():
    (path,) = (SHARE / "rviz").glob("*.rviz")
    content = yaml.safe_load(path.read_text())["Visualization Manager"]
    assert content["Global Options"]["Fixed Frame"] == FRAME_ID
    classes = {PointCloud2: "rviz_default_plugins/PointCloud2"}
    classes[MarkerArray] = "rviz_default_plugins/MarkerArray"
    shown = {}
    for display in content["Displays"]:
        if "Topic" in display:
            durability = display["Topic"]["Durability Policy"]
            shown[display["Topic"]["Value"]] = display["Class"], durability
        assert READ_BY_RVIZ >= set(display) | {f"Topic/{name}" for name in display["Topic"]}
    assert shown == {f"/{topic.name}": (classes[topic.type], "Transient Local") for topic in VIEWS}
    assert 'glob("rviz/*.rviz")' in (SHARE / "setup.py").read_text()


def test_foxglove_shows_the_same_and_the_encoders():
    (path,) = (SHARE / "foxglove").glob("*.json")
    layout = json.loads(path.read_text())
    panels = layout["configById"]
    (scene,) = (panel for panel in panels.values() if "topics" in panel)
    assert scene["followTf"] == FRAME_ID
    assert set(scene["topics"]) == {f"/{topic.name}" for topic in VIEWS}
    lines = [line["value"] for panel in panels.values() for line in panel.get("paths", ())]
    assert sorted(lines) == [
        f"/{JOINT_STATES.name}.{column}[${joint}]"
        for column in ("position", "velocity")
        for joint in ("phi", "theta")
    ]
    assert layout["globalVariables"] == {"theta": 0, "phi": 1}
    assert 'glob("foxglove/*.json")' in (SHARE / "setup.py").read_text()
