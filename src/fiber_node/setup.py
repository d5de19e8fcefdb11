# SPDX-License-Identifier: Apache-2.0
from setuptools import find_packages, setup

setup(
    name="fiber_node",
    version="0.1.0",
    description="What every node of the graph does alike: settings, reporting, running.",
    maintainer="fiber positioner team",
    maintainer_email="maintainers@example.org",
    license="Apache-2.0",
    packages=find_packages(exclude=["test", "test.*"]),
    package_data={"fiber_node": ["py.typed"]},
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/fiber_node"]),
        ("share/fiber_node", ["package.xml"]),
        ("share/fiber_node/config", ["config/fastdds.xml"]),
    ],
    # package.xml names the ROS packages as well
    install_requires=["fiber_core", "fiber_msgs_py", "numpy", "pyyaml"],
    extras_require={"test": ["pytest", "hypothesis"]},  # colcon looks for pytest here
    zip_safe=False,  # compiled loops are cached beside the modules
)
