# SPDX-License-Identifier: Apache-2.0
"""The ROS domain and the range of discovery: this machine only, where not set otherwise."""

import os
from pathlib import Path

from ament_index_python.packages import PackageNotFoundError, get_package_share_directory

__all__ = ["own_domain", "use_loopback"]

_DOMAINS = 101  # the ports of domains 1..101 are free on every system


def use_loopback() -> None:
    """Keep discovery on loopback, with the Fast DDS profile of this package.

    Call it before the first rclpy.init. Variables that the environment already has keep their
    values: with another discovery range the profile is left out, because it binds to loopback.
    """
    discovery = os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    if discovery != "LOCALHOST":
        return
    try:
        share = Path(get_package_share_directory("fiber_node"))
    except (PackageNotFoundError, OSError):  # run from its sources
        return
    os.environ.setdefault("FASTRTPS_DEFAULT_PROFILES_FILE", str(share / "config" / "fastdds.xml"))


def own_domain() -> int:
    """Return the ROS domain of the environment, or without one a domain of this process alone."""
    given = os.environ.get("ROS_DOMAIN_ID")
    return int(given) if given else 1 + os.getpid() % _DOMAINS
