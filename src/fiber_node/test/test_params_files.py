# SPDX-License-Identifier: Apache-2.0
"""Sections of parameter files that do not apply are named."""

import pytest

from fiber_node.params_files import section_warnings

SECTION = "  ros__parameters: {a: 1}\n"


@pytest.mark.parametrize(
    ("section", "node", "word"),
    [
        ("bridge", "/bridge", None),
        ("/bridge", "/bridge", None),
        ("/**", "/north/bridge", None),
        ("/**/bridge", "/north/bridge", None),
        ("/*/bridge", "/north/bridge", None),
        ("planner", "/bridge", None),  # of another node
        ("/**/metrology", "/bridge", None),
        ("camera", "/bridge", None),
        ("robot_model", "/bridge", None),
        ("/sector_0/sector", "/bridge", None),
        ("bridge", "/north/bridge", "bridge of {file} does not apply to /north/bridge: write /nor"),
        (
            "/south/bridge",
            "/north/bridge",
            "south/bridge of {file} does not apply to /north/bridge",
        ),
        ("/*/bridge", "/bridge", "*/bridge of {file} does not apply to /bridge"),
        ("brigde", "/bridge", "brigde of {file} names no node of the graph"),
    ],
)
def test_a_section_that_does_not_apply_is_named(tmp_path, section, node, word):
    file = tmp_path / "given.yaml"
    file.write_text(f"{section}:\n{SECTION}")
    found = section_warnings(["x", "--ros-args", "--params-file", str(file)], node)
    assert len(found) == (word is not None)
    if word is not None:
        assert word.format(file=file) in found[0]


def test_nested_names_are_one_name(tmp_path):
    file = tmp_path / "given.yaml"
    file.write_text("north:\n  bridge:\n    ros__parameters: {a: 1}\n")
    given = ["--params-file", str(file)]
    assert section_warnings(given, "/north/bridge") == []
    assert len(section_warnings(given, "/bridge")) == 1
    assert section_warnings(["--params-file", str(tmp_path / "none.yaml")], "/bridge") == []
