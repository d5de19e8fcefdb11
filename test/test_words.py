# SPDX-License-Identifier: Apache-2.0
"""The prose of the repository keeps to plain English: a subject is a noun.

In short: "robot", "pair", "bus", "node" are said and not
hinted at by "who" or "nobody", and places in the code are packages and modules.
"""

import re
import subprocess
import tokenize
from io import BytesIO
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
FORBIDDEN = re.compile(
    r"\b(who|whom|whoever|nobody|everybody|somebody|anybody|rooms?|house)\b", re.IGNORECASE
)
PROSE = {".md", ".js", ".html", ".css", ".lua", ".sh", ".yaml", ".yml", ".toml", ".xml", ".cff"}
NAMED = {"Makefile", "run", "requirements.in"}


def tracked() -> list[Path]:
    listed = subprocess.run(
        ["git", "ls-files"], cwd=ROOT, capture_output=True, text=True, check=True
    ).stdout.splitlines()
    return [path for name in listed if (path := ROOT / name).is_file()]


def prose_of_python(source: str) -> list[tuple[int, str]]:
    """Line number and text of every comment, string and name; names with spaces for underscores."""
    found = []
    for token in tokenize.tokenize(BytesIO(source.encode()).readline):
        if token.type in (tokenize.COMMENT, tokenize.STRING):
            found += [
                (token.start[0] + k, line) for k, line in enumerate(token.string.splitlines())
            ]
        elif token.type == getattr(tokenize, "FSTRING_MIDDLE", None):
            found.append((token.start[0], token.string))
        elif token.type == tokenize.NAME:
            found.append((token.start[0], token.string.replace("_", " ")))
    return found


def dialect(path: Path) -> list[str]:
    """Every forbidden word in a file, as "file:line: text"."""
    text = path.read_text(errors="replace")
    lines = prose_of_python(text) if path.suffix == ".py" else list(enumerate(text.split("\n"), 1))
    name = path.relative_to(ROOT) if path.is_relative_to(ROOT) else path.name
    return [f"{name}:{at}: {line.strip()[:90]}" for at, line in lines if FORBIDDEN.search(line)]


def test_no_dialect_in_sources_docs_and_messages():
    files = [
        path
        for path in tracked()
        if (path.suffix in PROSE | {".py"} or path.name in NAMED)
        and path.name != Path(__file__).name
    ]
    assert len(files) > 200
    wrong = [line for path in files for line in dialect(path)]
    assert not wrong, f"{len(wrong)} lines, among them\n" + "\n".join(wrong[:40])


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("a.py", "# nobody moves\n"),
        ("a.py", 'def f():\n    """Return whom to ask."""\n'),
        ("a.py", "def test_who_fell_silent():\n    pass\n"),
        ("a.py", "log(f'robot {k}: everybody waits')\n"),
        ("a.md", "Which room is it in?\n"),
        ("a.js", "// whoever comes late\n"),
    ],
)
def test_a_planted_word_is_found(tmp_path, name, text):
    (tmp_path / name).write_text(text)
    assert dialect(tmp_path / name)


def test_plain_prose_is_let_through(tmp_path):
    text = '"""A robot whole of headroom: the housekeeping of unknown robots."""\n'
    (tmp_path / "a.py").write_text(text)
    assert not dialect(tmp_path / "a.py")
