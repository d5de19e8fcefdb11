# SPDX-License-Identifier: Apache-2.0
"""The wheel: the packages that need no ROS, installed alone, plan a field where ROS is missing."""

import ast
import hashlib
import importlib.util
import json
import os
import re
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path
from xml.etree import ElementTree

import pytest

ROOT = Path(__file__).parents[1]
ROS = {
    "ament_index_python", "builtin_interfaces", "diagnostic_msgs", "fiber_bringup", "fiber_client",
    "fiber_console",
    "fiber_msgs_py", "fiber_node", "geometry_msgs", "launch", "launch_ros", "rcl_interfaces",
    "rclpy", "sensor_msgs", "std_msgs", "std_srvs", "trajectory_msgs", "visualization_msgs",
}  # fmt: skip
PURE = {
    "fiber_bus_bridge", "fiber_core", "fiber_discretizer", "fiber_formats", "fiber_metrology",
    "fiber_planner", "fiber_positioners", "fiber_recording", "fiber_viewer",
}  # fmt: skip
SIX_LINES = """
from fiber_positioners import hexagonal, random_problem, reconfigure
plane = hexagonal(robots=19, pitch_mm=10.0, arms_mm=(3.0, 3.0))
problem = random_problem(plane, seed=1)
result = reconfigure(problem, planner="direct")
print(result.report["reached"], result.report["certified"])
result.save("out/field"); result.player("out/player.html")
"""


def pip(*arguments: str) -> None:
    command = [sys.executable, "-m", "pip", "--disable-pip-version-check", *arguments]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr


@pytest.fixture(scope="session")
def wheel(tmp_path_factory) -> Path:
    pytest.importorskip("hatchling")
    folder = tmp_path_factory.mktemp("dist")
    pip("wheel", "--no-build-isolation", "--no-deps", "-w", str(folder), ".")
    (path,) = folder.glob("*.whl")
    return path


@pytest.fixture(scope="session")
def installed(wheel) -> Path:
    """The folder that the wheel is installed in; kept, with its compiled loops, for its bytes."""
    folder = ROOT / "build" / "test_install"
    own = folder / hashlib.sha256(wheel.read_bytes()).hexdigest()[:16]
    if not own.exists():
        shutil.rmtree(folder, ignore_errors=True)
        pip("install", "--no-deps", "--quiet", "--target", str(own), str(wheel))
        take_compiled_loops(own)
    return own


def take_compiled_loops(own: Path) -> None:
    """Take over the loops that the workspace has compiled from the same sources, in minutes."""
    for package in PURE:
        spec = importlib.util.find_spec(package)
        assert spec is not None and spec.origin is not None
        theirs = Path(spec.origin).parent
        for source in theirs.rglob("*.py"):
            copy = own / package / source.relative_to(theirs)
            if not copy.exists() or copy.read_bytes() != source.read_bytes():
                continue
            found = source.stat()  # a compiled loop is known by size and time of its source
            os.utime(copy, ns=(found.st_atime_ns, found.st_mtime_ns))
            for loop in source.parent.glob(f"__pycache__/{source.stem}.*.nb[ic]"):
                (copy.parent / "__pycache__").mkdir(exist_ok=True)
                shutil.copy2(loop, copy.parent / "__pycache__" / loop.name)


@pytest.fixture
def run(installed, tmp_path):
    """Runs Python with the installed wheel, in an empty folder, where nothing of ROS imports."""
    missing = tmp_path / "missing"
    for name in ROS:
        (missing / name).mkdir(parents=True)
        (missing / name / "__init__.py").write_text(f"raise ImportError('no {name} here')\n")
    inherited = {name: os.environ[name] for name in ("PATH", "HOME") if name in os.environ}
    environment = inherited | {"PYTHONPATH": f"{missing}{os.pathsep}{installed}"}

    def run_python(*arguments: str) -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            [sys.executable, *arguments],
            cwd=tmp_path,
            env=environment,
            capture_output=True,
            text=True,
            timeout=900,
        )

    return run_python


def test_the_wheel_holds_the_packages_without_ros_and_the_files_of_the_player(wheel):
    names = set(zipfile.ZipFile(wheel).namelist())
    assert {name.split("/")[0] for name in names if ".dist-info/" not in name} == PURE
    assert {f"{package}/py.typed" for package in PURE} <= names
    player = ROOT / "src/fiber_viewer/fiber_viewer/player"
    assert {f"fiber_viewer/player/{path.name}" for path in player.iterdir()} <= names
    assert not [name for name in names if "/test" in name or name.endswith((".nbi", ".nbc"))]


def test_no_module_in_the_wheel_imports_ros(wheel):
    archive, found = zipfile.ZipFile(wheel), []
    for name in archive.namelist():
        if not name.endswith(".py"):
            continue
        for node in ast.walk(ast.parse(archive.read(name))):
            targets = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            if isinstance(node, ast.ImportFrom) and node.module and not node.level:
                targets = [node.module]
            found += [f"{name} imports {each}" for each in targets if each.split(".")[0] in ROS]
            found += [f"{name} imports {e}" for e in targets if re.match(r"fiber_\w+\.node\b", e)]
    assert not found, "\n".join(found)


def test_every_module_without_ros_is_in_the_wheel(wheel):
    names = set(zipfile.ZipFile(wheel).namelist())
    left_out = sorted(
        str(path.relative_to(ROOT / "src" / package))
        for package in PURE
        for path in (ROOT / "src" / package / package).rglob("*.py")
        if str(path.relative_to(ROOT / "src" / package)) not in names
    )
    assert [name for name in left_out if "/node/" not in name] == [
        "fiber_discretizer/node.py",
        "fiber_metrology/camera/node.py",
        "fiber_planner/node.py",
        "fiber_recording/bag.py",
        "fiber_recording/measured_images.py",
        "fiber_recording/node.py",
        "fiber_recording/received_plans.py",
        "fiber_recording/settled_replay.py",
        "fiber_viewer/node.py",
    ]


def test_the_version_is_that_of_the_packages(wheel):
    versions = {
        ElementTree.parse(path).getroot().findtext("version")
        for path in ROOT.glob("src/*/package.xml")
    }
    assert wheel.name == f"fiber_positioners-{versions.pop()}-py3-none-any.whl" and not versions
    citation = re.search(r"^version: (\S+)$", (ROOT / "CITATION.cff").read_text(), re.MULTILINE)
    assert citation is not None and f"-{citation.group(1)}-" in wheel.name


def test_what_is_imported_is_declared(wheel):
    archive = zipfile.ZipFile(wheel)
    (metadata,) = (name for name in archive.namelist() if name.endswith("METADATA"))
    lines = archive.read(metadata).decode().splitlines()
    declared = {
        re.match(r"Requires-Dist: ([\w-]+)", line).group(1)
        for line in lines
        if line.startswith("Requires-Dist:")
    }
    imported = set()
    for name in archive.namelist():
        if name.endswith(".py"):
            for node in ast.walk(ast.parse(archive.read(name))):
                if isinstance(node, ast.Import):
                    imported |= {alias.name.split(".")[0] for alias in node.names}
                elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
                    imported.add(node.module.split(".")[0])
    distributions = {"yaml": "pyyaml", "vcd": "pyvcd"}
    foreign = imported - PURE - set(sys.stdlib_module_names)
    assert {distributions.get(name, name) for name in foreign} == declared


def test_the_root_is_no_ros_package():
    assert not [name for name in ("setup.py", "setup.cfg", "package.xml") if (ROOT / name).exists()]


@pytest.mark.timeout(900)
def test_six_lines_plan_an_instrument_where_ros_is_missing(run, tmp_path):
    done = run("-c", SIX_LINES)
    assert done.returncode == 0, done.stderr
    assert done.stdout.split() == ["19", "True"]
    for name in ("problem.npz", "plan.npz", "report.json", "recording.npz"):
        assert (tmp_path / "out" / "field" / name).exists()
    assert (tmp_path / "out" / "player.html").stat().st_size > 50_000


@pytest.mark.timeout(900)
def test_the_installed_command_plans_where_ros_is_missing(run, installed):
    done = run(str(installed / "bin" / "fiber-positioners"), "plan", "--robots", "37")
    assert done.returncode == 0, done.stderr
    report = json.loads(done.stdout)
    assert report["reached"] == 37 and report["certified"]


def test_ros_is_missing_there(run):
    done = run("-c", "import rclpy")
    assert done.returncode != 0 and "no rclpy here" in done.stderr
