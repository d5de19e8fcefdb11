# SPDX-License-Identifier: Apache-2.0
from setuptools import find_packages, setup

setup(
    name="fiber_planner",
    version="0.1.0",
    description="Plans joint trajectories from one configuration of a focal plane to the next.",
    maintainer="fiber positioner team",
    maintainer_email="maintainers@example.org",
    license="Apache-2.0",
    packages=find_packages(exclude=["test", "test.*"]),
    package_data={"fiber_planner": ["py.typed"]},
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/fiber_planner"]),
        ("share/fiber_planner", ["package.xml"]),
    ],
    # package.xml names the ROS packages as well
    install_requires=["fiber_core", "numpy", "numba", "scipy"],
    extras_require={"test": ["pytest", "hypothesis"]},  # colcon looks for pytest here
    zip_safe=False,  # compiled loops are cached beside the modules
    entry_points={"console_scripts": ["planner = fiber_planner.node:main"]},
)
