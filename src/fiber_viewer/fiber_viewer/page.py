# SPDX-License-Identifier: Apache-2.0
"""Write a page that plays a recording in a browser, from disk, without network or libraries."""

import argparse
import base64
import html
import re
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

from fiber_core.errors import FiberError
from fiber_recording.recording_file import load_recording

__all__ = ["CONSOLE_SCRIPTS", "SCRIPTS", "console_page", "main", "write_player"]

_SOURCES = Path(__file__).parent / "player"
# a module may import from the modules before it
SCRIPTS = (
    "npz", "kinematics", "phases", "clearance", "recording", "theme", "coloring", "camera",
    "drawing", "plane", "neighbourhood", "axes", "profiles", "buses", "motors", "images",
    "timeline", "headline", "roving", "lists", "address", "keys", "app",
)  # fmt: skip
# those of the console, which shows a running plane
CONSOLE_SCRIPTS = (
    "npz", "kinematics", "phases", "clearance", "recording", "theme", "coloring", "camera",
    "drawing", "plane", "neighbourhood", "address", "live", "orders", "console",
)  # fmt: skip
_IMPORT = re.compile(r"^import .*;\n", re.MULTILINE)
_EXPORT = re.compile(r"^export (?=const|class|function|async)", re.MULTILINE)


def write_player(page: Path, recording: Path) -> None:
    """Write the page that plays a recording.

    Args:
        page: the .html file to write.
        recording: the .npz file, which is embedded in the page byte for byte.

    Raises:
        RecordingError: the file is not a recording that this software can read.
        OSError: a file cannot be read or written.
    """
    about = load_recording(recording).about  # refuses a file that the page cannot show
    title = about["report"]["plane"] or "Focal plane"
    if about["plan_ns"]:  # a plan made without ROS has no stamp
        title += f", plan {about['plan_ns']}"
    embedded = base64.b64encode(recording.read_bytes()).decode()
    marks = {"RECORDING": embedded, "LENGTH": str(len(embedded))}
    part = page.with_name(page.name + ".part")  # a page that is there is whole
    part.write_text(_filled("page.html", title, SCRIPTS, marks))
    part.replace(page)


def console_page() -> str:
    """Return the page that shows a running plane; it finds its server and token in its address."""
    return _filled("console.html", "Focal plane", CONSOLE_SCRIPTS, {})


def _filled(source: str, title: str, scripts: Sequence[str], more: Mapping[str, str]) -> str:
    text = (_SOURCES / source).read_text()
    marks = {
        "TITLE": html.escape(title),
        "STYLE": (_SOURCES / "style.css").read_text(),
        "SCRIPT": script(scripts),
    }
    for mark, value in {**marks, **more}.items():
        text = text.replace("{{" + mark + "}}", value)
    return text


def script(names: Sequence[str] = SCRIPTS) -> str:
    """Return scripts of a page as one: end to end, without imports and exports.

    Args:
        names: names of the modules, each after those that it imports.
    """
    modules = ((_SOURCES / f"{name}.js").read_text() for name in names)
    return "\n".join(_EXPORT.sub("", _IMPORT.sub("", module)) for module in modules)


def main(argv: list[str] | None = None) -> int:
    """Run the command; return the exit code.

    Args:
        argv: arguments; by default those of the process.
    """
    parser = argparse.ArgumentParser(prog="player", description=__doc__)
    parser.add_argument("recording", type=Path, help="recording to play (.npz)")
    parser.add_argument(
        "-o", "--out", type=Path, help="page to write (.html); by default next to the recording"
    )
    args = parser.parse_args(argv)
    out = args.out or args.recording.with_suffix(".html")
    try:
        write_player(out, args.recording)
    except (FiberError, OSError) as error:
        print(f"player: {error}", file=sys.stderr)
        return 1
    print(out)
    return 0


if __name__ == "__main__":
    sys.exit(main())
