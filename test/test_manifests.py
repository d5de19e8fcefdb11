# SPDX-License-Identifier: Apache-2.0
"""What every package ships: its package.xml, setup.py, executables, launch files, tests."""

import ast
import configparser
import re
import sys
from pathlib import Path
from xml.etree import ElementTree

import pytest
from import_graph import imports
from packages import MODULES, PACKAGES, ROOT, SOURCE, imports_of, starts

INTERFACES = {"fiber_interfaces"}  # the package without Python code of its own
# import name -> rosdep key or package name, where they differ
KEYS = {
    name: f"python3-{name}"
    for name in ("numpy", "numba", "scipy", "astropy", "matplotlib", "rich", "tornado")
} | {
    "pytest": "python3-pytest",
    "hypothesis": "python3-hypothesis",
    "yaml": "python3-yaml",
    "gi": "python3-gi",
    "smbus2": "python3-smbus2",
}
# Without a rosdep key: fastcrc, selenium and its axe are for tests, rosbags for the command `bag`
# alone, which says what to install.
UNDECLARED = {"fastcrc", "selenium", "selenium_axe_python", "rosbags"}
OPTIONAL = {"vcd"}  # without a rosdep key; imported where it is used, if installed


def manifest(package: str) -> ElementTree.Element:
    return ElementTree.parse(SOURCE / package / "package.xml").getroot()


def depends(package: str, *kinds: str) -> set[str]:
    return {element.text for kind in kinds for element in manifest(package).iter(kind)}


def key_of(target: str) -> str:
    return KEYS.get(target.split(".")[0], target.split(".")[0])


def outside(targets, package: str) -> set[str]:
    own = {package, *sys.stdlib_module_names}
    return {t.split(".")[0] for t in targets} - own


@pytest.mark.parametrize("package", PACKAGES)
def test_package_xml_names_what_is_imported_and_nothing_else(package):
    used = set()
    for module in MODULES:
        if starts(module, package):
            used |= outside(imports_of(module), package)
    for path in (SOURCE / package).glob("launch/*.launch.py"):
        used |= outside(imports(path.read_text(), "launch", False, set(MODULES)), package)
        used |= {each for each, _ in launched(path.read_text())} - {package}
    wanted = {key_of(name) for name in used - UNDECLARED - OPTIONAL}
    declared = depends(package, "depend", "exec_depend")
    assert wanted - declared == set(), "imported, not in package.xml"
    assert declared - wanted == set(), "in package.xml, not imported"


@pytest.mark.parametrize("package", PACKAGES)
def test_package_xml_names_what_tests_import(package):
    used = set()
    for path in (SOURCE / package / "test").rglob("*.py"):
        used |= outside(imports(path.read_text(), "test", False, set(MODULES)), package)
    declared = depends(package, "depend", "exec_depend", "test_depend")
    siblings = {path.stem for path in (SOURCE / package / "test").rglob("*.py")}
    assert {key_of(name) for name in used - UNDECLARED - OPTIONAL - siblings} - declared == set()


@pytest.mark.parametrize("package", PACKAGES)
def test_a_package_ships_what_ros_looks_for(package):
    folder, root = SOURCE / package, manifest(package)
    assert root.get("format") == "3" and root.findtext("name") == package
    assert root.findtext("export/build_type") == "ament_python"
    assert (folder / "resource" / package).is_file() and (folder / "README.md").is_file()
    config = configparser.ConfigParser()
    config.read(folder / "setup.cfg")
    assert config["install"]["install_scripts"] == f"$base/lib/{package}"
    setup = setup_arguments(package)
    assert setup["name"] == package and setup["version"] == root.findtext("version")
    # with tests_require colcon finds no tests and says nothing
    assert "pytest" in setup["extras_require"]["test"] and "tests_require" not in setup


def test_every_interface_file_is_built():
    for package in INTERFACES:
        folder = SOURCE / package
        assert manifest(package).findtext("export/build_type") == "ament_cmake"
        assert (folder / "README.md").is_file()
        built = re.findall(r'"(\w+/\w+\.\w+)"', (folder / "CMakeLists.txt").read_text())
        files = [
            f"{p.parent.name}/{p.name}"
            for kind in ("action", "srv", "msg")
            for p in folder.glob(f"{kind}/*")
        ]
        assert sorted(files) == sorted(built)
    assert set(PACKAGES) | INTERFACES == {p.parent.name for p in SOURCE.glob("*/package.xml")}


def setup_arguments(package: str) -> dict:
    """Keyword arguments of setup(), where they are plain values."""
    tree = ast.parse((SOURCE / package / "setup.py").read_text())
    call = next(
        node
        for node in ast.walk(tree)
        if isinstance(node, ast.Call) and ast.unparse(node.func) == "setup"
    )
    found = {}
    for keyword in call.keywords:
        try:
            found[keyword.arg] = ast.literal_eval(keyword.value)
        except ValueError:
            found[keyword.arg] = None
    return found


def executables(package: str) -> dict[str, str]:
    scripts = (setup_arguments(package).get("entry_points") or {}).get("console_scripts", [])
    return dict(re.split(r"\s*=\s*", script) for script in scripts)


@pytest.mark.parametrize("package", PACKAGES)
def test_every_executable_has_a_function_behind_it(package):
    for name, target in executables(package).items():
        module, function = target.split(":")
        assert module in MODULES, f"{name} = {target}"
        body = ast.parse(MODULES[module].read_text()).body
        assert any(getattr(node, "name", None) == function for node in body), f"{name} = {target}"


def launch_files() -> list[Path]:
    return sorted(SOURCE.glob("*/launch/*.launch.py"))


def launched(source: str) -> list[tuple[str, str]]:
    """Package and executable of every node that a launch file starts by `Node` or `_node`."""
    found = []
    for node in ast.walk(ast.parse(source)):
        if not isinstance(node, ast.Call):
            continue
        named = {k.arg: k.value for k in node.keywords}
        given = {"Node": [named.get("package"), named.get("executable")], "_node": node.args[:2]}
        pair = given.get(ast.unparse(node.func).split(".")[-1], [])
        if pair and all(isinstance(each, ast.Constant) for each in pair):
            found.append(tuple(each.value for each in pair))
    return found


def test_launch_files_start_executables_that_exist():
    files = launch_files()
    assert files and all(launched(path.read_text()) for path in files)
    for path in files:
        source = path.read_text()
        functions = [n.name for n in ast.parse(source).body if isinstance(n, ast.FunctionDef)]
        assert "generate_launch_description" in functions, path.name
        for package, executable in launched(source):
            if package in PACKAGES:
                assert executable in executables(package), f"{path.name}: {package} {executable}"


def test_the_launch_check_sees_packages_and_executables():
    source = 'LaunchDescription([Node(package="fiber_planner", executable="plan", name="x")])'
    assert launched(source) == [("fiber_planner", "plan")]
    assert launched('[_node("fiber_planner", "plan", {"a": str})]') == [("fiber_planner", "plan")]
    assert "plan" not in executables("fiber_planner") and "planner" in executables("fiber_planner")


def test_every_suite_is_counted():
    text = (ROOT / "test" / "minimum_tests.toml").read_text()
    counted = set(re.findall(r"^(\w+) = [1-9]\d*$", text, re.MULTILINE))
    assert counted == {*PACKAGES, "test"}
    for package in PACKAGES:
        assert any((SOURCE / package / "test").glob("test_*.py")), f"{package} has no tests"
