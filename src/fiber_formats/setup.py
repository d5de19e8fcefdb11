# SPDX-License-Identifier: Apache-2.0
from setuptools import find_packages, setup

setup(
    name="fiber_formats",
    version="0.1.0",
    description="Layouts, starts and targets from the files of many instruments; results.",
    maintainer="fiber positioner team",
    maintainer_email="maintainers@example.org",
    license="Apache-2.0",
    packages=find_packages(exclude=["test", "test.*"]),
    package_data={"fiber_formats": ["py.typed"]},
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/fiber_formats"]),
        ("share/fiber_formats", ["package.xml"]),
    ],
    # package.xml names the ROS packages as well
    install_requires=["fiber_core", "numpy", "scipy", "astropy"],
    extras_require={"test": ["pytest", "hypothesis"]},  # colcon looks for pytest here
    zip_safe=True,
)
