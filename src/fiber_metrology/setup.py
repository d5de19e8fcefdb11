# SPDX-License-Identifier: Apache-2.0
from setuptools import find_packages, setup

setup(
    name="fiber_metrology",
    version="0.1.0",
    description="Camera metrology: spots to robots, joint angles, corrections and calibration.",
    maintainer="fiber positioner team",
    maintainer_email="maintainers@example.org",
    license="Apache-2.0",
    packages=find_packages(exclude=["test", "test.*"]),
    package_data={"fiber_metrology": ["py.typed"]},
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/fiber_metrology"]),
        ("share/fiber_metrology", ["package.xml"]),
    ],
    # package.xml names the ROS packages as well
    install_requires=["fiber_core", "numba", "numpy", "scipy"],
    extras_require={"test": ["pytest", "hypothesis"]},  # colcon looks for pytest here
    zip_safe=False,  # compiled loops are cached in the folder of the package
    entry_points={
        "console_scripts": [
            "metrology = fiber_metrology.node.metrology:main",
            "camera = fiber_metrology.camera.node:main",
        ]
    },
)
