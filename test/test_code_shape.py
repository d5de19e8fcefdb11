# SPDX-License-Identifier: Apache-2.0
"""Functions and modules stay short enough to be read at once."""

import ast
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
MOST_LINES, MOST_MODULE_LINES = 60, 400
SOURCES = [
    path
    for folder in ("src", "bench", "tools", "examples")
    for path in sorted((ROOT / folder).rglob("*.py"))
    if not {"test", "build"} & set(path.relative_to(ROOT).parts)
]


def body_lines(function: ast.FunctionDef | ast.AsyncFunctionDef) -> int:
    """Lines of a function's body without its docstring."""
    body = function.body
    if isinstance(body[0], ast.Expr) and isinstance(body[0].value, ast.Constant):
        body = body[1:]
    return body[-1].end_lineno - body[0].lineno + 1 if body else 0


def long_functions(source: str) -> list[str]:
    """Functions over the limit without a comment `# long: reason` on their first lines."""
    lines, found = source.split("\n"), []
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            length = body_lines(node)
            said = any(
                "# long: " in line for line in lines[node.lineno - 1 : node.body[0].lineno + 2]
            )
            if length > MOST_LINES and not said:
                found.append(f"{node.name}: {length} lines")
    return found


def test_no_function_is_long_without_a_reason():
    assert len(SOURCES) > 150
    wrong = [
        f"{path.relative_to(ROOT)} {found}"
        for path in SOURCES
        for found in long_functions(path.read_text())
    ]
    assert not wrong, "\n".join(wrong)


def test_no_module_is_long():
    sizes = {  # without the line of the license
        path.relative_to(ROOT): len(path.read_text().splitlines()) - 1 for path in SOURCES
    }
    assert not {path: size for path, size in sizes.items() if size > MOST_MODULE_LINES}


@pytest.mark.parametrize(
    ("head", "wrong"),
    [("def f():\n", True), ('def f():\n    """Doc."""\n    # long: one loop\n', False)],
)
def test_a_planted_function_is_found(head, wrong):
    source = head + "".join(f"    x = {k}\n" for k in range(MOST_LINES + 1))
    assert bool(long_functions(source)) is wrong
