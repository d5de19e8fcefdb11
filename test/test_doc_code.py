# SPDX-License-Identifier: Apache-2.0
"""The code in the docs: every Python block runs, every command in a block exists.

A block that is no program of its own has the info string ``python fragment`` and is only
compiled. A block with a PlaneClient and no Graph of its own runs beside a graph of 37 robots.
"""

import os
import re
import shlex
import shutil
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree

import pytest

from fiber_positioners.command.main import parsers

ROOT = Path(__file__).parents[1]
PAGES = sorted(
    [ROOT / "README.md", ROOT / "CONTRIBUTING.md"]
    + [*(ROOT / "docs").rglob("*.md"), *(ROOT / "src").glob("*/README.md")]
)
FENCE = re.compile(r"^```([^\n]*)\n(.*?)^```", re.MULTILINE | re.DOTALL)
MOST_FRAGMENTS = 4
OF_ROS = {"robot_state_publisher"}  # packages of ROS whose commands the docs use
RUN = "import sys; sys.path.insert(0, ''); import block"
RUN_IN_GRAPH = """
import sys
sys.path.insert(0, '')
from fiber_bringup import Graph
with Graph(bridge={"preset": "desi", "robots": 37, "time_scale": 0.0}):
    import block
"""


@dataclass(frozen=True)
class Block:
    """A fenced block of a page."""

    page: str
    line: int
    info: str
    text: str

    def __str__(self) -> str:
        return f"{self.page}:{self.line}"


def blocks_of(page: str, text: str) -> list[Block]:
    return [
        Block(page, text.count("\n", 0, match.start()) + 1, match[1].strip(), match[2])
        for match in FENCE.finditer(text)
    ]


BLOCKS = [block for p in PAGES for block in blocks_of(str(p.relative_to(ROOT)), p.read_text())]
PYTHON = [block for block in BLOCKS if block.info == "python"]
FRAGMENTS = [block for block in BLOCKS if block.info == "python fragment"]
SHELL = [block for block in BLOCKS if block.info in ("", "sh", "bash")]


@pytest.fixture(scope="session")
def folder(tmp_path_factory) -> Path:
    """The folder that blocks run in, with the files that they read."""
    folder = tmp_path_factory.mktemp("docs")
    (folder / "out" / "demo").mkdir(parents=True)
    make_recording = (
        "from pathlib import Path; from fiber_recording import save_recording; "
        "from fiber_recording.examples import random_recording; "
        "save_recording(Path('out/demo/recording.npz'), random_recording(seed=1))"
    )
    subprocess.run([sys.executable, "-c", make_recording], cwd=folder, check=True, timeout=300)
    shutil.copy(ROOT / "src/fiber_formats/test/data/desi_state.ecsv", folder)
    (folder / "mine.csv").write_text("Fibre,XFP,YFP,Broken\n5,0,0,no\n6,25,0,YES\n")
    return folder


@pytest.mark.timeout(600)
@pytest.mark.parametrize("block", PYTHON, ids=str)
def test_the_python_block_runs(block, folder):
    (folder / "block.py").write_text(block.text)
    beside_graph = "PlaneClient()" in block.text and "Graph(" not in block.text
    done = subprocess.run(
        [sys.executable, "-B", "-c", RUN_IN_GRAPH if beside_graph else RUN],
        cwd=folder,
        env=os.environ | {"MPLBACKEND": "agg"},
        capture_output=True,
        text=True,
        timeout=500,
    )
    assert done.returncode == 0, f"{block}\n{done.stderr}"


def test_fragments_are_few_and_compile():
    assert len(PYTHON) >= 10
    assert len(FRAGMENTS) <= MOST_FRAGMENTS
    for block in FRAGMENTS:
        compile(block.text, str(block), "exec")
    for block in BLOCKS:
        if block.info == "xml":
            ElementTree.fromstring(f"<fragment>{block.text}</fragment>")
    known = {"", "sh", "bash", "python", "python fragment", "mermaid", "xml"}
    assert {b.info for b in BLOCKS} <= known


def make_targets() -> set[str]:
    return set(re.findall(r"^([a-z][a-z-]*):", (ROOT / "Makefile").read_text(), re.MULTILINE))


def executables(package: str) -> set[str]:
    setup = ROOT / "src" / package / "setup.py"
    if not setup.exists():
        return set()
    return set(re.findall(r"\"([\w-]+) = [\w.]+:\w+\"", setup.read_text()))


def commands(block: Block) -> list[str]:
    """The commands of a block: lines without prompt and comment, joined where they go on."""
    text = re.sub(r"\\\n\s*", " ", block.text)
    found = []
    for line in text.splitlines():
        line = re.sub(r"(^|\s)#.*$", "", line).strip().removeprefix("$ ")
        found += [part.strip() for part in line.split("&&") if part.strip()]
    return found


def wrong(command: str) -> str:
    """What is wrong with a command; empty for commands that are right or not ours."""
    command = re.sub(r"^([A-Z_]+=\S*\s+)+", "", command)
    try:
        words = shlex.split(command)
    except ValueError:
        return ""  # a drawing
    match words:
        case ["make", *rest]:
            targets = [word for word in rest if "=" not in word and not word.startswith("-")]
            missing = [word for word in targets if word not in make_targets()]
            return f"no make target {missing[0]}" if missing else ""
        case ["ros2", "run", package, executable, *_] if package not in OF_ROS:
            known = executable in executables(package)
            return "" if known else f"{package} has no executable {executable}"
        case ["ros2", "launch", package, launch_file, *_] if package.startswith("fiber_"):
            path = ROOT / "src" / package / "launch" / launch_file
            return "" if path.exists() else f"{package} has no launch file {launch_file}"
        case ["fiber-positioners", *arguments]:
            return wrong_arguments(arguments)
        case ["python" | "python3", "-m", "fiber_positioners", *arguments]:
            return wrong_arguments(arguments)
        case ["python" | "python3", script, *_] if script.endswith(".py"):
            known = (ROOT / script).exists() or any(ROOT.glob(f"src/*/{script}"))
            return "" if known else f"no script {script}"
    return ""


def wrong_arguments(arguments: list[str]) -> str:
    parser, subcommands = parsers()
    try:
        args, rest = parser.parse_known_args(arguments)
        subcommands[args.command].refuse_unknown(rest)
    except SystemExit as leave:
        return f"fiber-positioners {' '.join(arguments)} is refused" if leave.code else ""
    return ""


def test_every_command_in_a_block_exists():
    found = [(block, command) for block in SHELL for command in commands(block)]
    assert sum(command.startswith(("make ", "ros2 ", "fiber-")) for _, command in found) > 20
    mistakes = [f"{block}: {what}" for block, command in found if (what := wrong(command))]
    assert not mistakes, "\n".join(mistakes)


@pytest.mark.parametrize(
    ("command", "said"),
    [
        ("make demos", "no make target demos"),
        ("make demo PRESET=pfs", ""),
        ("ros2 run fiber_client reconfigured x", "no executable reconfigured"),
        ("ros2 run fiber_client reconfigure x", ""),
        ("ros2 launch fiber_bringup plane.launch.py", "no launch file"),
        ("fiber-positioners plan --robts 3", "is refused"),
        ("fiber-positioners plan --robots 3", ""),
        ("python3 tools/compile.py", "no script"),
        ("python examples/three_robots.py", ""),
    ],
)
def test_a_planted_mistake_is_found(command, said, capsys):
    assert said in wrong(command) if said else wrong(command) == ""


def test_blocks_know_their_page_and_line():
    text = "a\n\n```python\nx = 1\n```\n\n```\nmake test\n```\n"
    assert blocks_of("p.md", text) == [
        Block("p.md", 3, "python", "x = 1\n"),
        Block("p.md", 7, "", "make test\n"),
    ]
