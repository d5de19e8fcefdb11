# SPDX-License-Identifier: Apache-2.0
from setuptools import find_packages, setup

setup(
    name="fiber_console",
    version="0.1.0",
    description="A running focal plane in a browser: what moves, what is wrong, and orders.",
    maintainer="fiber positioner team",
    maintainer_email="maintainers@example.org",
    license="Apache-2.0",
    packages=find_packages(exclude=["test", "test.*"]),
    package_data={"fiber_console": ["py.typed"]},
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/fiber_console"]),
        ("share/fiber_console", ["package.xml"]),
    ],
    # package.xml names the ROS packages as well
    install_requires=[
        "fiber_client",
        "fiber_core",
        "fiber_msgs_py",
        "fiber_node",
        "fiber_viewer",
        "numpy",
        "tornado",
    ],
    extras_require={"test": ["pytest"]},  # colcon looks for pytest here
    zip_safe=False,  # compiled loops are cached beside the modules
    entry_points={"console_scripts": ["console = fiber_console.node:main"]},
)
