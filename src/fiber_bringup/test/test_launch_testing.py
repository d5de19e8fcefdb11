# SPDX-License-Identifier: Apache-2.0
"""The launch file under the real launch, where it is installed: it is not among the wheels.

launch and launch_testing run in processes of their own: their pytest plugins need an
older pytest than ours.
"""

import importlib.util
import os
import subprocess
import sys
from pathlib import Path

import pytest

HERE = Path(__file__).parent
FILE = HERE.parent / "launch" / "focal_plane.launch.py"
MISSING = [
    name
    for name in ("launch", "launch_ros", "launch_testing")
    if importlib.util.find_spec(name) is None
]

pytestmark = [
    pytest.mark.timeout(400),
    pytest.mark.skipif(
        bool(MISSING), reason=f"NOT TESTED: the launch file as it is run; without {MISSING}"
    ),
]

RUN = """
import sys
from launch import LaunchDescription, LaunchService
from launch.actions import IncludeLaunchDescription
from launch.launch_description_sources import PythonLaunchDescriptionSource
path, *given = sys.argv[1:]
arguments = [tuple(each.split(":=", 1)) for each in given]
source = PythonLaunchDescriptionSource(path)
service = LaunchService(argv=[])
service.include_launch_description(
    LaunchDescription([IncludeLaunchDescription(source, launch_arguments=arguments)])
)
sys.exit(service.run())
"""


def run(command, domain):
    return subprocess.run(
        [sys.executable, *command],
        env=os.environ | {"ROS_DOMAIN_ID": str(domain)},
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        timeout=300,
    )


def test_a_plane_starts_answers_and_ends(new_domain):
    command = ["-m", "launch_testing.launch_test", str(HERE / "focal_plane.test.py")]
    done = run(command, new_domain())
    assert done.returncode == 0, done.stdout[-8000:]
    assert "escalating" not in done.stdout, done.stdout[-8000:]


@pytest.mark.parametrize(
    ("argument", "words"),
    [
        ("robots:=-3", "robots is -3"),
        ("faults:=no_such_fault", "plant-1 has ended with code 2"),
        ("planner:=bogus", "no planner is called 'bogus'"),
    ],
)
def test_a_process_that_fails_at_the_start_fails_the_launch(new_domain, tmp_path, argument, words):
    others = "robots:=7" if "robots" not in argument else "seed:=1"
    command = ["-c", RUN, str(FILE), f"folder:={tmp_path}", others, argument]
    done = run(command, new_domain())
    assert done.returncode == 1 and words in done.stdout, done.stdout[-8000:]
    assert "has ended with code 2" in done.stdout
