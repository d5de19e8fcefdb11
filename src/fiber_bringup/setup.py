# SPDX-License-Identifier: Apache-2.0
from glob import glob

from setuptools import find_packages, setup

setup(
    name="fiber_bringup",
    version="0.1.0",
    description="Starts the node graph of a focal plane and takes it through a reconfiguration.",
    maintainer="fiber positioner team",
    maintainer_email="maintainers@example.org",
    license="Apache-2.0",
    packages=find_packages(exclude=["test", "test.*"]),
    package_data={"fiber_bringup": ["py.typed"]},
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/fiber_bringup"]),
        ("share/fiber_bringup", ["package.xml"]),
        ("share/fiber_bringup/launch", glob("launch/*.launch.py")),
        ("share/fiber_bringup/config", glob("config/*")),
        ("share/fiber_bringup/rviz", glob("rviz/*.rviz")),
        ("share/fiber_bringup/foxglove", glob("foxglove/*.json")),
    ],
    # package.xml names the ROS packages as well
    install_requires=[
        "fiber_bus_bridge",
        "fiber_client",
        "fiber_core",
        "fiber_formats",
        "fiber_discretizer",
        "fiber_node",
        "fiber_sectors",
        "fiber_planner",
        "fiber_positioners",
        "fiber_recording",
        "fiber_viewer",
        "numpy",
    ],
    extras_require={"test": ["pytest", "hypothesis"]},  # colcon looks for pytest here
    zip_safe=False,  # compiled loops are cached beside the modules
    entry_points={
        "console_scripts": [
            "demo = fiber_bringup.demo:main",
            "graph = fiber_bringup.graph:main",
            "live = fiber_bringup.live:main",
        ]
    },
)
