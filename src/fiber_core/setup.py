# SPDX-License-Identifier: Apache-2.0
from setuptools import find_packages, setup

setup(
    name="fiber_core",
    version="0.1.0",
    description="The focal plane of fibre positioners, its motions and their certificates.",
    maintainer="fiber positioner team",
    maintainer_email="maintainers@example.org",
    license="Apache-2.0",
    packages=find_packages(exclude=["test", "test.*"]),
    package_data={"fiber_core": ["py.typed"]},
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/fiber_core"]),
        ("share/fiber_core", ["package.xml"]),
    ],
    # package.xml names the ROS packages as well
    install_requires=["numpy", "numba", "scipy"],
    extras_require={"test": ["pytest", "hypothesis"]},  # colcon looks for pytest here
    zip_safe=False,  # compiled loops are cached next to the modules
)
