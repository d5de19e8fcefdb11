# SPDX-License-Identifier: Apache-2.0
"""Check that a sourced ROS 2 Jazzy has all packages that the workspace needs."""

import sys
from importlib.util import find_spec

NEEDED = (
    "rclpy sensor_msgs trajectory_msgs diagnostic_msgs std_srvs colcon_core "
    "numpy numba scipy astropy matplotlib rich pytest xdist hypothesis"
)

missing = [name for name in NEEDED.split() if find_spec(name) is None]
if missing:
    sys.exit(
        f"ROS 2 Jazzy is sourced, but {sys.executable} lacks {', '.join(missing)}:\n"
        "  rosdep install --from-paths src --ignore-src\n"
        "or, to use the wheels in .venv instead: env -u ROS_DISTRO make ..."
    )
