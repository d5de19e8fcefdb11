# SPDX-License-Identifier: Apache-2.0
from setuptools import find_packages, setup

setup(
    name="fiber_recording",
    version="0.1.0",
    description="Recordings of plans, built from the frames on the buses; the recorder; bags.",
    maintainer="fiber positioner team",
    maintainer_email="maintainers@example.org",
    license="Apache-2.0",
    packages=find_packages(exclude=["test", "test.*"]),
    package_data={"fiber_recording": ["py.typed"]},
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/fiber_recording"]),
        ("share/fiber_recording", ["package.xml"]),
    ],
    # package.xml names the ROS packages as well
    install_requires=["fiber_bus_bridge", "fiber_core", "numpy"],
    extras_require={"test": ["pytest", "hypothesis"]},  # colcon looks for pytest here
    zip_safe=False,  # compiled loops are cached in the folder of the package
    entry_points={
        "console_scripts": [
            "recorder = fiber_recording.node:main",
            "bag = fiber_recording.bag:main",
        ]
    },
)
