# SPDX-License-Identifier: Apache-2.0
"""Plant, bridge, planner, discretizer, recorder and viewer of one focal plane, on this machine.

ros2 launch fiber_bringup focal_plane.launch.py preset:=desi robots:=500
"""

import difflib
from collections.abc import Mapping
from typing import Any

from launch import LaunchContext, LaunchDescription
from launch.actions import (
    DeclareLaunchArgument,
    ExecuteProcess,
    GroupAction,
    LogInfo,
    OpaqueFunction,
    SetEnvironmentVariable,
    Shutdown,
)
from launch.conditions import IfCondition, UnlessCondition
from launch.events.process import ProcessExited
from launch.substitutions import (
    AndSubstitution,
    EnvironmentVariable,
    EqualsSubstitution,
    LaunchConfiguration,
    NotSubstitution,
    OrSubstitution,
    PathJoinSubstitution,
)
from launch_ros.actions import Node, PushRosNamespace, SetParameter
from launch_ros.parameter_descriptions import ParameterValue
from launch_ros.substitutions import FindPackagePrefix, FindPackageShare

# default and meaning of each argument
_ARGUMENTS = {
    "preset": ("", "instrument; none: desi, or the name in the layout"),
    "robots": ("0", "number of robots; 0: all of the instrument"),
    "seed": ("0", "seed of random starts"),
    "layout": ("", "files of robots; none: a preset"),
    "starts": ("", "files of present angles; none: random"),
    "spacing_mm": ("-1.0", "least distance between two targets; -1: that of the layout"),
    "drive": ("", "motors of the robots, as desi; none: those of the layout, ideal without any"),
    "motors_on": ("0.0", "most motors of a supply on at once, to 1; 0: as the layout tells"),
    "problem": ("", "problem.npz with plane and starts; none: random starts"),
    "disabled_file": ("", "file that keeps the list of disabled robots; none: in memory only"),
    "sectors": (
        "0",
        "sectors of the plane, each with a share of its buses and a process of its own, with "
        "robots in that process; 0: one bridge",
    ),
    "sectors_clock": (
        "0.0",
        "seconds of the sectors' buses in one of their hosts, 1: real time; 0: time goes on when "
        "all sectors have come to one instant",
    ),
    "sectors_here": (
        "all",
        "what this host starts of a plane of sectors: 0-2,5: these sectors alone; none: all nodes "
        "but the sectors, which other hosts start; all: everything",
    ),
    "planner": ("direct", "name of the planner, such as direct, dnf_priority, dnf"),
    "time_scale": ("1.0", "simulated seconds per second; 0: as fast as possible"),
    "plant": (
        "auto",
        "socket of the simulated plant; auto: by user and domain; none: no plant, the bridge "
        "simulates the robots itself",
    ),
    "faults": ("", "simulated faults, as stall:2,scl_stuck"),
    "folder": ("recordings", "folder of the recordings"),
    "camera": ("false", "start metrology and a simulated camera, for reconfigure --tolerance-um"),
    "blind_um": (
        "0.0",
        "error of one coordinate of a fibre after a blind move, 1 sigma [um]: blind moves keep "
        "arms apart that are off by twice as much; 40 for the arms of a simulated camera",
    ),
    "console": ("false", "serve the console for a browser"),
    "port": ("8137", "port of the console, on loopback"),
    "robot_model": ("-1", "id of a robot whose URDF is on robot_description; -1: none"),
    "namespace": ("", "namespace of all nodes, as north"),
    "use_sim_time": ("false", "follow the time on /clock"),
    "log_level": ("info", "level of the log: debug, info, warn; of one node: planner:=debug"),
    "autostart": (
        "true",
        "configure and activate the managed nodes; false: they wait for `ros2 lifecycle set`",
    ),
    "use_respawn": (
        "false",
        "start nodes again that end, unless they refuse their settings; false: such a node ends "
        "the launch",
    ),
}

_REFUSED = 2  # exit code of a node whose parameters are refused
_MANAGED: Mapping[str, type] = {"autostart": bool}
_ALL, _NONE = "all", "none"
_OF_PLANE: Mapping[str, type] = {
    "preset": str, "robots": int, "seed": int, "layout": str, "starts": str,
    "spacing_mm": float, "drive": str, "motors_on": float, "problem": str,
}  # fmt: skip


def generate_launch_description() -> LaunchDescription:
    """Return the launch arguments, the environment and the nodes."""
    scope = [
        OpaqueFunction(function=_name_unknown),
        *_environment(),
        PushRosNamespace(LaunchConfiguration("namespace")),
        SetParameter("use_sim_time", LaunchConfiguration("use_sim_time")),
        OpaqueFunction(function=_check_camera),
        OpaqueFunction(function=_sectors),
        GroupAction(
            [
                _plant(),
                *_control(),
                *_camera(),
                OpaqueFunction(function=_coordinator),
                *_observers(),
            ],
            condition=IfCondition(
                OrSubstitution(
                    EqualsSubstitution(LaunchConfiguration("sectors_here"), _ALL),
                    EqualsSubstitution(LaunchConfiguration("sectors_here"), _NONE),
                )
            ),
        ),
    ]
    return LaunchDescription([*_arguments(), GroupAction(scope)])


def _arguments() -> list[DeclareLaunchArgument]:
    file = PathJoinSubstitution([FindPackageShare("fiber_bringup"), "config", "focal_plane.yaml"])
    return [
        DeclareLaunchArgument(name, default_value=default, description=about)
        for name, (default, about) in _ARGUMENTS.items()
    ] + [
        DeclareLaunchArgument(
            "params_file", default_value=file, description="file with the parameters of the nodes"
        )
    ]


def _name_unknown(context: LaunchContext) -> list[LogInfo]:
    """Name the arguments of the command line that this file does not have: launch says nothing.

    They are not refused, as a launch file that includes this one may have them.
    """
    known = [*_ARGUMENTS, "params_file"]
    texts = []
    for name in (each.split(":=")[0] for each in context.argv if ":=" in each):
        if name not in known:
            meant = difflib.get_close_matches(name, known, 1)
            hint = f"; did you mean {meant[0]}?" if meant else ""
            texts.append(f"focal_plane.launch.py has no argument {name}: it has no effect{hint}")
    return [LogInfo(msg=text) for text in texts]


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


def _node_ended(event: ProcessExited, context: LaunchContext) -> list[Shutdown] | None:
    """End the launch with a node, unless nodes are started again.

    A node that has refused its settings would refuse them again.

    Raises:
        RuntimeError: the node has failed; `ros2 launch` shows the text, and ends with code 1.
    """
    respawn = LaunchConfiguration("use_respawn").perform(context).lower() in ("true", "1")
    return None if respawn and event.returncode != _REFUSED else _process_ended(event, context)


def _process_ended(event: ProcessExited, context: LaunchContext) -> list[Shutdown] | None:
    """End the launch with a process without which the others would wait for ever.

    Raises:
        RuntimeError: the process has failed.
    """
    if context.is_shutdown:
        return None
    text = f"{event.process_name} has ended with code {event.returncode}"
    if event.returncode:
        raise RuntimeError(text)
    return [Shutdown(reason=text)]


def _node(
    package: str,
    executable: str,
    arguments: Mapping[str, type] | None = None,
    also: Mapping[str, Any] | None = None,
    **options: Any,
) -> Node:
    """Return a node as a process.

    Args:
        package: its package.
        executable: its executable, and its name unless `options` have another.
        arguments: type of each launch argument that sets the parameter of its name.
        also: further parameters.
        options: options of Node in place of those that all nodes have.
    """
    given = {
        each: ParameterValue(LaunchConfiguration(each), value_type=kind)
        for each, kind in (arguments or {}).items()
    } | dict(also or {})
    common: dict[str, Any] = {
        "output": "screen",
        "ros_arguments": ["--log-level", LaunchConfiguration("log_level")],
        "respawn": LaunchConfiguration("use_respawn"),
        "respawn_delay": 2.0,
        "on_exit": _node_ended,
        "parameters": [LaunchConfiguration("params_file"), *([given] if given else [])],
    }
    return Node(package=package, executable=executable, **{"name": executable} | common | options)


def _plant() -> ExecuteProcess:
    """Return the process of the simulated robots, which outlives the bridge."""
    folder = PathJoinSubstitution([FindPackagePrefix("fiber_bus_bridge"), "lib"])
    return ExecuteProcess(
        cmd=[
            PathJoinSubstitution([folder, "fiber_bus_bridge", "plant"]),
            ["--params-file=", LaunchConfiguration("params_file")],
            ["--preset=", LaunchConfiguration("preset")],
            ["--robots=", LaunchConfiguration("robots")],
            ["--seed=", LaunchConfiguration("seed")],
            ["--layout=", LaunchConfiguration("layout")],
            ["--starts=", LaunchConfiguration("starts")],
            ["--drive=", LaunchConfiguration("drive")],
            ["--motors-on=", LaunchConfiguration("motors_on")],
            ["--problem=", LaunchConfiguration("problem")],
            ["--faults=", LaunchConfiguration("faults")],
            ["--time-scale=", LaunchConfiguration("time_scale")],
            ["--socket=", LaunchConfiguration("plant")],
            ["--name=", LaunchConfiguration("namespace")],
        ],
        name="plant",
        output="screen",
        on_exit=_process_ended,
        condition=IfCondition(
            AndSubstitution(
                _one_bridge(),
                NotSubstitution(EqualsSubstitution(LaunchConfiguration("plant"), "none")),
            )
        ),
    )


def _control() -> list[Node]:
    """Return the nodes that plan and move."""
    of_bridge = {
        **_OF_PLANE, "time_scale": float, "plant": str, "disabled_file": str, "autostart": bool,
        "blind_um": float,
    }  # fmt: skip
    return [
        _node("fiber_bus_bridge", "bridge", of_bridge, condition=IfCondition(_one_bridge())),
        _node("fiber_planner", "planner", {"planner": str} | _MANAGED),
        _node("fiber_discretizer", "discretizer", _MANAGED),
    ]


def _camera() -> list[Node]:
    """Return the nodes that see the robots."""
    wanted = IfCondition(LaunchConfiguration("camera"))
    return [
        _node("fiber_metrology", "metrology", _MANAGED, condition=wanted),
        _node(
            "fiber_metrology",
            "camera",
            {"plant": str, "seed": int} | _MANAGED,
            condition=wanted,
        ),
    ]


def _one_bridge() -> EqualsSubstitution:
    return EqualsSubstitution(LaunchConfiguration("sectors"), "0")


def _check_camera(context: LaunchContext) -> None:
    """Refuse what no camera can see yet, and errors of drives that sectors do not contain yet.

    Raises:
        RuntimeError: a camera or `blind_um` with sectors; `ros2 launch` shows the text.
    """
    given = {
        name: LaunchConfiguration(name).perform(context).lower()
        for name in ("camera", "sectors", "blind_um")
    }
    if float(given["blind_um"]) != 0.0 and given["sectors"] != "0":
        raise RuntimeError(
            f"blind_um:={given['blind_um']} sectors:={given['sectors']}: robots of sectors have no "
            "wider outlines, leave out sectors or blind_um"
        )
    if given["camera"] in ("true", "1") and given["sectors"] != "0":
        raise RuntimeError(
            f"camera:={given['camera']} sectors:={given['sectors']}: a camera needs one bridge "
            "for its plane, leave out sectors or camera"
        )


def _sectors(context: LaunchContext) -> list[Node]:
    """Return the sectors of the plane that this host starts, none with one bridge."""
    shared = _shared_out(context)
    return [
        _node(
            "fiber_sectors", "sector", {**_OF_PLANE, "faults": str}, namespace=f"sector_{k}",
            also=shared | {"sectors.number": k},
        )
        for k in _sectors_here(context)
    ]  # fmt: skip


def _coordinator(context: LaunchContext) -> list[Node]:
    """Return the coordinator of the sectors, nothing with one bridge."""
    if not (shared := _shared_out(context)):
        return []
    given = {**_OF_PLANE, "time_scale": float, "disabled_file": str} | _MANAGED
    return [_node("fiber_sectors", "coordinator", given, name="bridge", also=shared)]


def _shared_out(context: LaunchContext) -> dict[str, ParameterValue]:
    """Return the parameters by which sectors and coordinator share the plane; none for a bridge."""
    shares = LaunchConfiguration("sectors").perform(context)
    scale = ParameterValue(LaunchConfiguration("sectors_clock"), value_type=float)
    own = {
        "sectors.shares": ParameterValue(shares, value_type=str),
        "sectors.clock_scale": scale,
    }
    return {} if shares == "0" else own


def _sectors_here(context: LaunchContext) -> list[int]:
    """Return the numbers of the sectors that this host starts.

    Raises:
        RuntimeError: `sectors_here` names none, or one that the plane does not have.
    """
    shares = LaunchConfiguration("sectors").perform(context)
    here = LaunchConfiguration("sectors_here").perform(context)
    number = int(shares) if shares.isdigit() else len(shares.split(";"))
    if here == _ALL or here == _NONE:
        return list(range(number)) if here == _ALL else []
    named = [each.strip().partition("-") for each in here.split(",")]
    if not all(a.isdigit() and (b.isdigit() if dash else not b) for a, dash, b in named):
        raise RuntimeError(f"sectors_here:={here} is neither all nor none nor numbers as 0-2,5")
    chosen = sorted({k for a, _, b in named for k in range(int(a), int(b or a) + 1)})
    if not chosen or chosen[-1] >= number:
        raise RuntimeError(f"sectors_here:={here} with sectors:={shares}: it has {number} sectors")
    return chosen


def _observers() -> list[Node]:
    """Return the nodes that only receive, and record or show."""
    noted = {"folder": str, "seed": int, "planner": str, "preset": str}
    return [
        _node("fiber_recording", "recorder", noted),
        _node("fiber_viewer", "viewer"),
        _node(
            "fiber_client",
            "robot_model",
            {"robot_model": int},
            condition=UnlessCondition(EqualsSubstitution(LaunchConfiguration("robot_model"), "-1")),
        ),
        # no part of the plane: it is started again, and the plane goes on without it
        _node(
            "fiber_console",
            "console",
            {"folder": str, "port": int},
            respawn=True,
            on_exit=None,
            condition=IfCondition(LaunchConfiguration("console")),
        ),
    ]
