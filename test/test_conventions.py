# SPDX-License-Identifier: Apache-2.0
"""What ROS tools look for in a package: changelog, maintainer, license, groups of diagnostics."""

import re
from pathlib import Path
from xml.etree import ElementTree

import pytest
import yaml

ROOT = Path(__file__).parents[1]
PACKAGES = sorted(path.parent for path in (ROOT / "src").glob("*/package.xml"))
STATUSES = ("planner", "discretizer", "bridge", "bridge: bus 3", "bridge: left out")
STATUSES += ("recorder", "viewer", "north/bridge: bus 3")


@pytest.mark.parametrize("package", PACKAGES, ids=lambda package: package.name)
def test_a_package_has_a_changelog_a_maintainer_and_the_license(package):
    root = ElementTree.parse(package / "package.xml").getroot()
    assert root.findtext("license") == "Apache-2.0" and root.findtext("description")
    assert "@" in root.find("maintainer").get("email")
    lines = (package / "CHANGELOG.rst").read_text().splitlines()
    assert lines[1] == f"Changelog for package {package.name}"
    assert lines[0] == lines[2] == "^" * len(lines[1])
    assert lines[4] == "Forthcoming" or re.match(r"\d+\.\d+\.\d+ \(", lines[4])
    assert any(line.startswith("* ") for line in lines)


def test_every_diagnostic_status_is_in_one_group():
    path = ROOT / "src/fiber_bringup/config/diagnostics_aggregator.yaml"
    (parameters,) = (node["ros__parameters"] for node in yaml.safe_load(path.read_text()).values())
    groups = [value for value in parameters.values() if isinstance(value, dict)]
    assert {group["type"] for group in groups} == {"diagnostic_aggregator/GenericAnalyzer"}
    for status in STATUSES:
        assert sum(any(part in status for part in group["contains"]) for group in groups) == 1
