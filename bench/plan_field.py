#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Take a focal plane through one reconfiguration without ROS, and print one JSON line.

The same command as `fiber-positioners plan`, for a clone that is not installed.
"""

import sys

from fiber_positioners.command import main

if __name__ == "__main__":
    sys.exit(main(["plan", *sys.argv[1:]]))
