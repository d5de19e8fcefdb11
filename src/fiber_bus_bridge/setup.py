# SPDX-License-Identifier: Apache-2.0
from setuptools import find_packages, setup

setup(
    name="fiber_bus_bridge",
    version="0.1.0",
    description="Puts segments on the buses and reports what every positioner did.",
    maintainer="fiber positioner team",
    maintainer_email="maintainers@example.org",
    license="Apache-2.0",
    packages=find_packages(exclude=["test", "test.*"]),
    package_data={"fiber_bus_bridge": ["py.typed"]},
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/fiber_bus_bridge"]),
        ("share/fiber_bus_bridge", ["package.xml"]),
    ],
    # package.xml names the ROS packages as well
    install_requires=["fiber_core", "fiber_formats", "numpy", "numba", "pyyaml"],
    extras_require={
        "test": ["pytest", "hypothesis"],
        "capture": ["pyvcd"],
        "linux": ["smbus2"],
    },  # colcon looks for pytest here
    zip_safe=False,  # compiled loops are cached beside the modules
    entry_points={
        "console_scripts": [
            "bridge = fiber_bus_bridge.node.bridge:main",
            "plant = fiber_bus_bridge.plant.main:main",
        ]
    },
)
