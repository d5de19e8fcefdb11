# SPDX-License-Identifier: Apache-2.0
from setuptools import find_packages, setup

setup(
    name="fiber_viewer",
    version="0.1.0",
    description="Shows recordings of a focal plane: player, figures, live view.",
    maintainer="fiber positioner team",
    maintainer_email="maintainers@example.org",
    license="Apache-2.0",
    packages=find_packages(exclude=["test", "test.*"]),
    package_data={"fiber_viewer": ["player/*", "py.typed"]},
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/fiber_viewer"]),
        ("share/fiber_viewer", ["package.xml"]),
    ],
    # package.xml names the ROS packages as well
    install_requires=[
        "fiber_core",
        "fiber_recording",
        "matplotlib",
        "numpy",
    ],
    extras_require={"test": ["pytest", "hypothesis"]},  # colcon looks for pytest here
    zip_safe=False,  # compiled loops are cached in the folder of the package
    entry_points={
        "console_scripts": [
            "figures = fiber_viewer.figures.command:main",
            "player = fiber_viewer.page:main",
            "viewer = fiber_viewer.node:main",
            "snapshot = fiber_viewer.snapshot:main",
        ]
    },
)
