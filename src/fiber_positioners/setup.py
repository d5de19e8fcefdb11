# SPDX-License-Identifier: Apache-2.0
from setuptools import find_packages, setup

setup(
    name="fiber_positioners",
    version="0.1.0",
    description="Plans and carries out reconfigurations of a focal plane from Python, without ROS.",
    maintainer="fiber positioner team",
    maintainer_email="maintainers@example.org",
    license="Apache-2.0",
    packages=find_packages(exclude=["test", "test.*"]),
    package_data={"fiber_positioners": ["py.typed"]},
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/fiber_positioners"]),
        ("share/fiber_positioners", ["package.xml"]),
    ],
    install_requires=[
        "fiber_bus_bridge",
        "fiber_core",
        "fiber_discretizer",
        "fiber_metrology",
        "fiber_planner",
        "fiber_recording",
        "fiber_viewer",
        "numpy",
        "matplotlib",
        "rich",
        "scipy",
    ],
    extras_require={"test": ["pytest"]},  # colcon looks for pytest here
    zip_safe=False,
    entry_points={"console_scripts": ["fiber-positioners = fiber_positioners.command.main:main"]},
)
