# SPDX-License-Identifier: Apache-2.0
from setuptools import find_packages, setup

setup(
    name="fiber_msgs_py",
    version="0.1.0",
    description="Stock ROS messages to and from the types of the core, with topic names and QoS.",
    maintainer="fiber positioner team",
    maintainer_email="maintainers@example.org",
    license="Apache-2.0",
    packages=find_packages(exclude=["test", "test.*"]),
    package_data={"fiber_msgs_py": ["py.typed"]},
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/fiber_msgs_py"]),
        ("share/fiber_msgs_py", ["package.xml"]),
    ],
    # package.xml names the ROS packages as well
    install_requires=["fiber_core", "numpy"],
    extras_require={"test": ["pytest", "hypothesis"]},  # colcon looks for pytest here
    zip_safe=False,  # compiled loops are cached beside the modules
)
