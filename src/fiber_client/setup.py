# SPDX-License-Identifier: Apache-2.0
from setuptools import find_packages, setup

setup(
    name="fiber_client",
    version="0.1.0",
    description="A client of the focal-plane graph, and its commands.",
    maintainer="fiber positioner team",
    maintainer_email="maintainers@example.org",
    license="Apache-2.0",
    packages=find_packages(exclude=["test", "test.*"]),
    package_data={"fiber_client": ["py.typed"]},
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/fiber_client"]),
        ("share/fiber_client", ["package.xml"]),
    ],
    # package.xml names the ROS packages as well
    install_requires=[
        "fiber_core",
        "fiber_formats",
        "fiber_metrology",
        "fiber_msgs_py",
        "fiber_node",
        "numpy",
        "rich",
    ],
    extras_require={"test": ["pytest", "hypothesis"]},  # colcon looks for pytest here
    zip_safe=False,  # compiled loops are cached beside the modules
    entry_points={
        "console_scripts": [
            "reconfigure = fiber_client.reconfigure:main",
            "disable = fiber_client.disable:disable",
            "enable = fiber_client.disable:enable",
            "vouch = fiber_client.vouch:vouch",
            "recover = fiber_client.recover:main",
            "wiring = fiber_client.wiring:main",
            "show = fiber_client.show:main",
            "gateway = fiber_client.gateway:main",
            "robot_model = fiber_client.robot_model:main",
        ]
    },
)
