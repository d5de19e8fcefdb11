# SPDX-License-Identifier: Apache-2.0
from setuptools import find_packages, setup

setup(
    name="fiber_sectors",
    version="0.1.0",
    description="One focal plane on many hosts: sectors that start and stop together.",
    maintainer="fiber positioner team",
    maintainer_email="maintainers@example.org",
    license="Apache-2.0",
    packages=find_packages(exclude=["test", "test.*"]),
    package_data={"fiber_sectors": ["py.typed"]},
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/fiber_sectors"]),
        ("share/fiber_sectors", ["package.xml"]),
    ],
    # package.xml names the ROS packages as well
    install_requires=["fiber_bus_bridge", "fiber_core", "fiber_msgs_py", "fiber_node", "numpy"],
    extras_require={"test": ["pytest"]},  # colcon looks for pytest here
    zip_safe=True,
    entry_points={
        "console_scripts": [
            "coordinator = fiber_sectors.node.coordinator:main",
            "sector = fiber_sectors.node.sector_node:main",
        ]
    },
)
