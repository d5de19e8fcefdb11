# SPDX-License-Identifier: Apache-2.0
"""Plant, bridge, planner, discretizer, recorder and viewer of one focal plane, on this machine.

ros2 launch fiber_bringup focal_plane.launch.py preset:=desi robots:=500
"""

from typing import Any

from launch import LaunchDescription
from launch.actions import (
    DeclareLaunchArgument,
    ExecuteProcess,
    GroupAction,
    SetEnvironmentVariable,
    Shutdown,
)
from launch.conditions import IfCondition, UnlessCondition
from launch.substitutions import (
    EnvironmentVariable,
    EqualsSubstitution,
    LaunchConfiguration,
    PathJoinSubstitution,
)
from launch_ros.actions import Node, PushRosNamespace, SetParameter
from launch_ros.parameter_descriptions import ParameterValue
from launch_ros.substitutions import FindPackagePrefix, FindPackageShare


def generate_launch_description() -> LaunchDescription:
    """Return the launch arguments, the environment and the nodes."""
    parameters = LaunchConfiguration("params_file")
    scope = [
        *_environment(),
        PushRosNamespace(LaunchConfiguration("namespace")),
        SetParameter("use_sim_time", LaunchConfiguration("use_sim_time")),
        _plant(parameters),
        *_control(parameters),
        *_observers(parameters),
    ]
    return LaunchDescription(
        [
            *_arguments(),
            *_arguments_of_all_nodes(),
            GroupAction(scope),
        ]
    )


def _arguments() -> list[DeclareLaunchArgument]:
    return [
        DeclareLaunchArgument(
            "preset",
            default_value="",
            description="instrument; none: desi, or the name in the layout",
        ),
        DeclareLaunchArgument(
            "robots", default_value="0", description="number of robots; 0: all of the instrument"
        ),
        DeclareLaunchArgument("seed", default_value="0", description="seed of random starts"),
        DeclareLaunchArgument(
            "layout", default_value="", description="files of robots; none: a preset"
        ),
        DeclareLaunchArgument(
            "starts", default_value="", description="files of present angles; none: random"
        ),
        DeclareLaunchArgument(
            "spacing_mm",
            default_value="-1.0",
            description="least distance between two targets; -1: that of the layout",
        ),
        DeclareLaunchArgument(
            "problem",
            default_value="",
            description="problem.npz with plane and starts; none: random starts",
        ),
        DeclareLaunchArgument(
            "disabled_file",
            default_value="",
            description="file that keeps the list of disabled robots; none: in memory only",
        ),
        DeclareLaunchArgument(
            "planner",
            default_value="direct",
            description="name of the planner, such as direct, dnf_priority, dnf",
        ),
        DeclareLaunchArgument(
            "time_scale",
            default_value="1.0",
            description="simulated seconds per second; 0: as fast as possible",
        ),
        DeclareLaunchArgument(
            "plant",
            default_value="auto",
            description="socket of the simulated plant; auto: by user and domain; none: no plant, "
            "the bridge simulates the robots itself",
        ),
        DeclareLaunchArgument(
            "faults", default_value="", description="simulated faults, as stall:2,scl_stuck"
        ),
        DeclareLaunchArgument(
            "folder", default_value="recordings", description="folder of the recordings"
        ),
        DeclareLaunchArgument(
            "console", default_value="false", description="serve the console for a browser"
        ),
        DeclareLaunchArgument(
            "port", default_value="8137", description="port of the console, on loopback"
        ),
    ]


def _arguments_of_all_nodes() -> list[DeclareLaunchArgument]:
    return [
        DeclareLaunchArgument(
            "namespace", default_value="", description="namespace of all nodes, as north"
        ),
        DeclareLaunchArgument(
            "params_file",
            default_value=PathJoinSubstitution(
                [FindPackageShare("fiber_bringup"), "config", "focal_plane.yaml"]
            ),
            description="file with the parameters of the nodes",
        ),
        DeclareLaunchArgument(
            "use_sim_time", default_value="false", description="follow the time on /clock"
        ),
        DeclareLaunchArgument(
            "log_level", default_value="info", description="level of the log: debug, info, warn"
        ),
        DeclareLaunchArgument(
            "use_respawn",
            default_value="false",
            description="start nodes again that end; false: such a node ends the launch",
        ),
    ]


def _environment() -> list[SetEnvironmentVariable]:
    # values of the environment win, as a profile of another machine or another range
    profile = PathJoinSubstitution([FindPackageShare("fiber_node"), "config", "fastdds.xml"])
    return [
        SetEnvironmentVariable(
            "ROS_AUTOMATIC_DISCOVERY_RANGE",
            EnvironmentVariable("ROS_AUTOMATIC_DISCOVERY_RANGE", default_value="LOCALHOST"),
        ),
        SetEnvironmentVariable(
            "FASTRTPS_DEFAULT_PROFILES_FILE",
            EnvironmentVariable("FASTRTPS_DEFAULT_PROFILES_FILE", default_value=profile),
        ),
    ]


def _process() -> dict[str, Any]:
    """Return what all nodes have in common as processes."""
    respawn = LaunchConfiguration("use_respawn")
    return {
        "ros_arguments": ["--log-level", LaunchConfiguration("log_level")],
        "respawn": respawn,
        "respawn_delay": 2.0,
        "on_exit": [Shutdown(reason="a node has ended", condition=UnlessCondition(respawn))],
    }


def _plant(parameters: LaunchConfiguration) -> ExecuteProcess:
    """Return the process of the simulated robots, which outlives the bridge."""
    folder = PathJoinSubstitution([FindPackagePrefix("fiber_bus_bridge"), "lib"])
    return ExecuteProcess(
        cmd=[
            PathJoinSubstitution([folder, "fiber_bus_bridge", "plant"]),
            ["--params-file=", parameters],
            ["--preset=", LaunchConfiguration("preset")],
            ["--robots=", LaunchConfiguration("robots")],
            ["--seed=", LaunchConfiguration("seed")],
            ["--layout=", LaunchConfiguration("layout")],
            ["--starts=", LaunchConfiguration("starts")],
            ["--problem=", LaunchConfiguration("problem")],
            ["--faults=", LaunchConfiguration("faults")],
            ["--time-scale=", LaunchConfiguration("time_scale")],
            ["--socket=", LaunchConfiguration("plant")],
            ["--name=", LaunchConfiguration("namespace")],
        ],
        name="plant",
        output="screen",
        condition=UnlessCondition(EqualsSubstitution(LaunchConfiguration("plant"), "none")),
    )


def _control(parameters: LaunchConfiguration) -> list[Node]:
    """Return the nodes that plan and move."""
    return [
        Node(
            package="fiber_bus_bridge",
            executable="bridge",
            name="bridge",
            output="screen",
            **_process(),
            parameters=[
                parameters,
                {
                    "preset": ParameterValue(LaunchConfiguration("preset"), value_type=str),
                    "robots": ParameterValue(LaunchConfiguration("robots"), value_type=int),
                    "seed": ParameterValue(LaunchConfiguration("seed"), value_type=int),
                    "layout": ParameterValue(LaunchConfiguration("layout"), value_type=str),
                    "starts": ParameterValue(LaunchConfiguration("starts"), value_type=str),
                    "spacing_mm": ParameterValue(
                        LaunchConfiguration("spacing_mm"), value_type=float
                    ),
                    "problem": ParameterValue(LaunchConfiguration("problem"), value_type=str),
                    "time_scale": ParameterValue(
                        LaunchConfiguration("time_scale"), value_type=float
                    ),
                    "plant": ParameterValue(LaunchConfiguration("plant"), value_type=str),
                    "disabled_file": ParameterValue(
                        LaunchConfiguration("disabled_file"), value_type=str
                    ),
                },
            ],
        ),
        Node(
            package="fiber_planner",
            executable="planner",
            name="planner",
            output="screen",
            **_process(),
            parameters=[
                parameters,
                {"planner": ParameterValue(LaunchConfiguration("planner"), value_type=str)},
            ],
        ),
        Node(
            package="fiber_discretizer",
            executable="discretizer",
            name="discretizer",
            output="screen",
            **_process(),
            parameters=[parameters],
        ),
    ]


def _observers(parameters: LaunchConfiguration) -> list[Node]:
    """Return the nodes that only receive and record or show."""
    return [
        Node(
            package="fiber_recording",
            executable="recorder",
            name="recorder",
            output="screen",
            **_process(),
            parameters=[
                parameters,
                {
                    "folder": ParameterValue(LaunchConfiguration("folder"), value_type=str),
                    "seed": ParameterValue(LaunchConfiguration("seed"), value_type=int),
                    "planner": ParameterValue(LaunchConfiguration("planner"), value_type=str),
                    "preset": ParameterValue(LaunchConfiguration("preset"), value_type=str),
                },
            ],
        ),
        Node(
            package="fiber_viewer",
            executable="viewer",
            name="viewer",
            output="screen",
            **_process(),
            parameters=[parameters],
        ),
        # no part of the plane: it is started again, and the plane goes on without it
        Node(
            package="fiber_console",
            executable="console",
            name="console",
            output="screen",
            ros_arguments=["--log-level", LaunchConfiguration("log_level")],
            respawn=True,
            respawn_delay=2.0,
            condition=IfCondition(LaunchConfiguration("console")),
            parameters=[
                parameters,
                {
                    "folder": ParameterValue(LaunchConfiguration("folder"), value_type=str),
                    "port": ParameterValue(LaunchConfiguration("port"), value_type=int),
                },
            ],
        ),
    ]
