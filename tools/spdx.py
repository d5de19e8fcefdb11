# SPDX-License-Identifier: Apache-2.0
"""Add the line that names the license to source files that lack it: spdx.py [--check]."""

import subprocess
import sys
from pathlib import Path

__all__ = ["LICENSE_LINE", "missing"]

ROOT = Path(__file__).parents[1]
LICENSE_LINE = "SPDX-License-Identifier: Apache-2.0"

_COMMENTS = {  # beginning and end of a comment, by the end of the name of a file
    ".action": ("# ", ""),
    ".cmake": ("# ", ""),
    ".css": ("/* ", " */"),
    ".js": ("// ", ""),
    ".lua": ("-- ", ""),
    ".py": ("# ", ""),
    ".pyi": ("# ", ""),
    ".sh": ("# ", ""),
    ".srv": ("# ", ""),
    "CMakeLists.txt": ("# ", ""),
    "Makefile": ("# ", ""),
    ".ci/run": ("# ", ""),
}


def _comment_of(path: str) -> tuple[str, str] | None:
    return next((marks for end, marks in _COMMENTS.items() if path.endswith(end)), None)


def missing() -> list[str]:
    """Return the source files of the repository without the line; empty files need none."""
    listed = ["git", "ls-files", "--cached", "--others", "--exclude-standard"]
    names = subprocess.run(listed, cwd=ROOT, capture_output=True, text=True, check=True).stdout
    found = []
    for name in names.splitlines():
        path = ROOT / name
        if _comment_of(name) is None or not path.is_file():
            continue
        text = path.read_text()
        if text and LICENSE_LINE not in "\n".join(text.splitlines()[:3]):
            found.append(name)
    return found


def _add(name: str) -> None:
    path, marks = ROOT / name, _comment_of(name)
    assert marks is not None
    lines = path.read_text().splitlines(keepends=True)
    at = 1 if lines[0].startswith("#!") else 0
    lines.insert(at, f"{marks[0]}{LICENSE_LINE}{marks[1]}\n")
    path.write_text("".join(lines))


def main() -> int:
    """Name the files without the line, and add it unless they are only to be named."""
    names = missing()
    for name in names:
        print(name)
        if "--check" not in sys.argv:
            _add(name)
    return int(bool(names) and "--check" in sys.argv)


if __name__ == "__main__":
    sys.exit(main())
