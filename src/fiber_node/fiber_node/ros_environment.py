# SPDX-License-Identifier: Apache-2.0
"""The ROS environment of a process: this machine and this user only, where not set otherwise."""

import os
from pathlib import Path

from ament_index_python.packages import PackageNotFoundError, get_package_share_directory

__all__ = ["keep_memory_private", "keep_private", "own_domain", "use_loopback"]

_RANGE, _PROFILE = "ROS_AUTOMATIC_DISCOVERY_RANGE", "FASTRTPS_DEFAULT_PROFILES_FILE"
_FAST_DDS = ("", "rmw_fastrtps_cpp", "rmw_fastrtps_dynamic_cpp")
_SOURCES = Path(__file__).parents[1] / "config" / "fastdds.xml"
_SEGMENT = "/dev/shm/fastrtps_"
_OTHERS = 0o077  # all rights of group and others
_DOMAINS = 101  # the ports of domains 1..101 are free on every system


def use_loopback() -> None:
    """Keep all traffic on loopback, with the Fast DDS profile of this package.

    Call it before the first rclpy.init. An environment with another discovery range, or with
    another profile, keeps both. For LOCALHOST the middleware adds a transport of its own, which
    opens sockets on all interfaces; so with our profile, which is stricter, the range is left to
    the profile.
    """
    if os.environ.setdefault(_RANGE, "LOCALHOST") != "LOCALHOST":
        return
    if os.environ.get("RMW_IMPLEMENTATION", "") not in _FAST_DDS:
        return
    ours = _profile()
    if ours is None:
        return
    given = Path(os.environ.setdefault(_PROFILE, str(ours)))
    try:
        same = given.read_bytes() == ours.read_bytes()
    except OSError:
        return
    if same:
        os.environ[_RANGE] = "SYSTEM_DEFAULT"


def _profile() -> Path | None:
    """The profile as installed, or in the sources."""
    try:
        path = Path(get_package_share_directory("fiber_node")) / "config" / "fastdds.xml"
    except (PackageNotFoundError, OSError):
        path = _SOURCES
    return next((each for each in (path, _SOURCES) if each.is_file()), None)


def keep_private() -> None:
    """Let only the owner read the files and logs that this process writes from now on."""
    os.umask(os.umask(_OTHERS) | _OTHERS)


def keep_memory_private() -> None:
    """Let only the owner open the shared memory that this process has mapped, with its messages.

    Fast DDS gives its segments the mode 0644 whatever the umask is, so they are changed when a
    node has made them. Segments of other users are left alone.
    """
    try:
        maps = Path("/proc/self/maps").read_text(encoding="utf-8")
    except OSError:  # another system
        return
    for path in {line.split()[-1] for line in maps.splitlines() if _SEGMENT in line}:
        try:
            os.chmod(path, 0o600)
        except OSError:
            continue  # of another user, or gone


def own_domain() -> int:
    """Return the ROS domain of the environment, or without one a domain of this process alone."""
    given = os.environ.get("ROS_DOMAIN_ID")
    return int(given) if given else 1 + os.getpid() % _DOMAINS
