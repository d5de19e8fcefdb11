# SPDX-License-Identifier: Apache-2.0
"""Launch file, parameter file and nodes agree, checked with stand-ins for launch."""

import array
import json
from types import SimpleNamespace

import pytest
import rclpy
import yaml
from launch_stand_ins import SHARE, all_of, load
from rclpy.context import Context
from sensor_msgs.msg import PointCloud2
from visualization_msgs.msg import MarkerArray

from fiber_bringup.graph import Graph
from fiber_bus_bridge.plant import main
from fiber_bus_bridge.simulation import SimulationConfig
from fiber_client.robot_model import RobotModelNode
from fiber_console.node import ConsoleNode
from fiber_metrology.camera.node import CameraNode
from fiber_metrology.node import MetrologyNode
from fiber_msgs_py import FRAME_ID
from fiber_msgs_py.topics import JOINT_STATES, VIEW_ARMS, VIEW_PLANE, VIEW_TARGETS
from fiber_viewer.node import WATCHED

VIEWS = VIEW_ARMS, VIEW_PLANE, VIEW_TARGETS, WATCHED
_NOTED = {("recorder", "seed"), ("recorder", "planner")}
# a bridge alone simulates its robots itself
_OF_LAUNCH = {("bridge", "plant")}


@pytest.fixture(scope="module")
def launch_file():
    return load()


@pytest.fixture(scope="module")
def description(launch_file):
    return launch_file[1]


def _plain(value):
    return list(value) if isinstance(value, array.array) else value


@pytest.fixture(scope="module")
def nodes(description):
    """Name of each node started, and names and types of parameters set from arguments."""
    found = {}
    for node in all_of(description, "Node"):
        file, *given = node.given["parameters"]
        assert file.args == ("params_file",)
        typed = found[node.given["name"]] = {}
        for name, value in (given[0] if given else {}).items():
            assert value.args[0].args == (name,)
            typed[name] = value.given["value_type"].__name__
    return found


@pytest.fixture(scope="module")
def defaults(description):
    """Default of each launch argument."""
    return {
        each.args[0]: each.given["default_value"]
        for each in all_of(description, "DeclareLaunchArgument")
    }


@pytest.fixture(scope="module")
def plant_arguments(description):
    """Launch arguments that the plant is given, and the option of each."""
    (process,) = all_of(description, "ExecuteProcess")
    options = [part for part in process.given["cmd"] if isinstance(part, list)]
    return {value.args[0]: option for option, value in options if value.args[0] != "params_file"}


@pytest.fixture(scope="module")
def declared(new_domain):
    """Parameters of every node, with their values, as the nodes declare them."""
    context = Context()
    rclpy.init(args=[], context=context, domain_id=new_domain())
    # processes of their own, not part of a graph
    kinds = ConsoleNode, RobotModelNode, MetrologyNode, CameraNode
    others = [kind(context=context) for kind in kinds]
    with Graph(bridge={"robots": 7}, recorder={}, viewer={}, domain=new_domain()) as graph:
        found = {
            node.get_name(): {
                name: _plain(parameter.value)
                for name, parameter in node.get_parameters_by_prefix("").items()
            }
            for node in [*graph.nodes, *others]
        }
    for node in others:
        node.destroy_node()
    context.try_shutdown()
    return found


def test_every_argument_is_declared_and_used(description, defaults, nodes, plant_arguments):
    of_nodes = {name for typed in nodes.values() for name in typed}
    of_all = {"namespace", "params_file", "use_sim_time", "log_level", "use_respawn"}
    # which nodes are started
    of_all |= {"sectors", "sectors_clock", "sectors_here", "camera", "console"}
    used = {each.args[0] for each in all_of(description, "LaunchConfiguration")}
    used |= {"sectors_clock"}  # by _sectors, which is called at the launch
    assert of_all <= used == set(defaults)
    assert set(defaults) - of_all == of_nodes | set(plant_arguments) - of_all


def test_arguments_have_the_type_of_the_parameter_they_set(declared, nodes, defaults):
    for node, typed in nodes.items():
        for name, kind in typed.items():
            value = declared[node][name]
            assert type(value).__name__ == kind, name
            # a recorder writes down what the other nodes were given, and has no default of its own
            if name != "robots" and (node, name) not in _NOTED | _OF_LAUNCH:
                assert type(value)(defaults[name]) == value, name


class LaunchEnd:
    """The launch context of the end of a process."""

    def __init__(self, respawn, is_shutdown=False):
        self.configurations, self.is_shutdown = {"use_respawn": respawn}, is_shutdown


def ended(code):
    return SimpleNamespace(process_name="bridge-2", returncode=code)


def test_the_end_of_a_node_ends_the_launch_and_its_failure_fails_it(launch_file):
    module, description = launch_file
    node_ended = module["_node_ended"]
    of_the_plane = [n for n in all_of(description, "Node") if n.given["name"] != "console"]
    assert all(node.given["on_exit"] is node_ended for node in of_the_plane)
    (plant,) = all_of(description, "ExecuteProcess")
    plant_ended = plant.given["on_exit"]
    with pytest.raises(RuntimeError, match="bridge-2 has ended with code 2"):
        node_ended(ended(2), LaunchEnd("false"))
    (shutdown,) = node_ended(ended(0), LaunchEnd("false"))
    assert shutdown.kind == "Shutdown"
    for context in (LaunchEnd("true"), LaunchEnd("True"), LaunchEnd("false", is_shutdown=True)):
        assert node_ended(ended(1), context) is None
    with pytest.raises(RuntimeError, match="bridge-2 has ended with code 2"):
        node_ended(ended(2), LaunchEnd("true"))  # it has refused its settings
    # a bridge would wait for ever for a plant that has ended, which is not started again
    for respawn in ("true", "false"):
        with pytest.raises(RuntimeError, match="bridge-2 has ended with code 2"):
            plant_ended(ended(2), LaunchEnd(respawn))
    assert plant_ended(ended(2), LaunchEnd("false", is_shutdown=True)) is None


def test_the_environment_is_set_for_the_nodes_of_this_launch_alone(description):
    (group,) = [each for each in description.args[0] if each.kind == "GroupAction"]
    assert len(all_of(group, "Node")) == len(all_of(description, "Node"))
    assert all_of(group, "SetEnvironmentVariable") == all_of(description, "SetEnvironmentVariable")
    assert "scoped" not in group.given  # it is by default


def test_the_parameter_file_holds_the_defaults_of_parameters_that_exist(declared, nodes):
    content = yaml.safe_load((SHARE / "config" / "focal_plane.yaml").read_text())
    content = {name.removeprefix("/**/"): entry for name, entry in content.items()}
    plant = content.pop("plant")["ros__parameters"]
    assert plant and plant == {name: getattr(SimulationConfig(), name) for name in plant}
    assert plant["clock"] == content["bridge"]["ros__parameters"]["clock"]
    # nodes that the launch starts only when it is asked to may have none
    assert {"bridge", "planner", "discretizer", "recorder", "viewer"} <= set(content)
    assert set(content) <= set(declared) == set(nodes)
    for node, entry in content.items():
        assert entry["ros__parameters"]
        for name, value in entry["ros__parameters"].items():
            assert declared[node][name] == value and type(declared[node][name]) is type(value), name
            assert name not in nodes[node], f"{name} is set by the launch file anyway"


def test_the_plant_has_the_options_that_the_launch_file_gives_it(
    tmp_path, monkeypatch, nodes, plant_arguments
):
    monkeypatch.setattr(main, "_serve", lambda options: served.append(options))
    served = []
    given = plant_arguments
    assert {name for name in given if name in nodes["bridge"]} == set(given) - {
        "faults",
        "namespace",
    }
    values = {
        "robots": "7", "seed": "3", "time_scale": "0.5", "faults": "stall", "plant": "auto",
        "drive": "desi", "motors_on": "0.55",
    }  # fmt: skip
    parameters = SHARE / "config" / "focal_plane.yaml"
    options = [f"{option}{values.get(name, '')}" for name, option in given.items()]
    assert main.main([f"--params-file={parameters}", *options]) == 0
    assert served[0].robots == 7 and served[0].faults == "stall" and served[0].socket == "auto"
    assert served[0].clock == "1M" and served[0].time_scale == 0.5
    (tmp_path / "wrong.yaml").write_text("plant: {ros__parameters: {clocks: 1M}}")
    assert main.main([f"--params-file={tmp_path / 'wrong.yaml'}"]) == 2


def test_files_of_the_launch_file_are_installed(description):
    found = [each.args[0] for each in all_of(description, "PathJoinSubstitution")]
    named = {path[-1]: path[0].args[0] for path in found if "config" in path}
    assert named == {"focal_plane.yaml": "fiber_bringup", "fastdds.xml": "fiber_node"}
    for name, package in named.items():
        assert (SHARE.parent / package / "config" / name).is_file()
        setup = (SHARE.parent / package / "setup.py").read_text()
        assert 'glob("config/*")' in setup or f'"config/{name}"' in setup


def test_every_node_of_the_launch_file_is_an_executable_of_its_package(description):
    for node in all_of(description, "Node"):
        package, executable = node.given["package"], node.given["executable"]
        setup = (SHARE.parent / package / "setup.py").read_text()
        assert f'"{executable} = {package}.' in setup


def test_discovery_stays_on_this_machine_by_default(description):
    values = {}
    for each in all_of(description, "SetEnvironmentVariable"):
        name, value = each.args
        assert value.kind == "EnvironmentVariable" and value.args == (name,)
        values[name] = value.given["default_value"]
    assert values["ROS_AUTOMATIC_DISCOVERY_RANGE"] == "LOCALHOST"


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


@pytest.mark.parametrize(
    ("camera", "sectors", "refused"),
    [("true", "2", True), ("1", "0-4; 5", True), ("false", "2", False), ("true", "0", False)],
)
def test_a_camera_with_sectors_is_refused_before_anything_is_started(
    launch_file, camera, sectors, refused
):
    module, description = launch_file
    context = SimpleNamespace(
        configurations={"camera": camera, "sectors": sectors, "blind_um": "0.0"}
    )
    if refused:
        with pytest.raises(RuntimeError, match="a camera needs one bridge"):
            module["_check_camera"](context)
    else:
        module["_check_camera"](context)
    functions = [each.given["function"].__name__ for each in all_of(description, "OpaqueFunction")]
    assert functions[:2] == ["_name_unknown", "_check_camera"]


def test_errors_of_drives_with_sectors_are_refused(launch_file):
    module, _ = launch_file
    given = {"camera": "false", "sectors": "2", "blind_um": "40"}
    with pytest.raises(RuntimeError, match="blind_um:=40 sectors:=2: robots of sectors"):
        module["_check_camera"](SimpleNamespace(configurations=given))
    module["_check_camera"](SimpleNamespace(configurations=given | {"sectors": "0"}))


def test_an_argument_that_the_launch_file_does_not_have_is_named(launch_file):
    module, description = launch_file
    given = ["robot:=61", "seed:=3", "params_file:=own.yaml", "bogus:=1", "--noninteractive"]
    texts = [each.given["msg"] for each in module["_name_unknown"](SimpleNamespace(argv=given))]
    assert texts == [
        "focal_plane.launch.py has no argument robot: it has no effect; did you mean robots?",
        "focal_plane.launch.py has no argument bogus: it has no effect",
    ]
    declared = {each.args[0] for each in all_of(description, "DeclareLaunchArgument")}
    others = [f"{name}:=" for name in declared]
    assert len(others) > 20 and not module["_name_unknown"](SimpleNamespace(argv=others))
    checklist = SHARE.parents[1] / "docs" / "checklist-ros2.md"
    assert f"| {len(others)} arguments with meaning and default |" in checklist.read_text()
