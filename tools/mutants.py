# SPDX-License-Identifier: Apache-2.0
"""Mutants: the small mistakes that can be planted in a module, one edit of its text each.

The operators are those of PIT (https://pitest.org) as far as Python has them: a comparison shifted
at its boundary or turned round, arithmetic, logic, numbers, extremes, signs, a statement left out.
Texts, annotations, decorators, assertions for the type checker and what a `raise` says are left
alone: no test should depend on them.
"""

import ast
import hashlib
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

__all__ = ["Mutant", "mutants_of"]

_COMPARED = {"<": "<= >=", "<=": "< >", ">": ">= <=", ">=": "> <", "==": "!=", "!=": "=="}
_COMPARED |= {"is": "is not", "is not": "is", "in": "not in", "not in": "in"}
_COMPUTED = {"+": "-", "-": "+", "*": "/", "/": "*", "//": "*", "%": "*", "**": "*"}
_COMPUTED |= {"&": "|", "|": "&", "^": "&", "<<": ">>", ">>": "<<"}
_CALLED = [("min", "max"), ("minimum", "maximum"), ("argmin", "argmax"), ("any", "all")]
_CALLED += [("floor", "ceil")]
_CALLED_INSTEAD = dict(_CALLED) | {b: a for a, b in _CALLED}
_SKIPPED = {"annotation", "returns", "decorator_list", "exc", "cause", "type_params"}
_LEFT_ALONE = (ast.JoinedStr, ast.Import, ast.ImportFrom, ast.Assert)
_LOGGED = {"debug", "info", "warning", "error"}


@dataclass(frozen=True)
class Mutant:
    """One edit of a module.

    Args:
        module: dotted name of the module.
        path: its file.
        text: its text with the mistake.
        line: first line that the mistake changes.
        reached_by: first and last of the lines that run where the mistake runs.
        change: the changed lines before and after, for a reader.
    """

    module: str
    path: Path
    text: str
    line: int
    reached_by: tuple[int, int]
    change: str

    @property
    def key(self) -> str:
        """Digest of the module and of its text with the mistake."""
        return hashlib.sha256(f"{self.module}\n{self.text}".encode()).hexdigest()[:16]


def mutants_of(module: str, path: Path) -> list[Mutant]:
    """Return all mutants of a module that differ from it and from each other.

    Args:
        module: dotted name of the module.
        path: its file.
    """
    source = path.read_bytes()
    whole = _Text(source)
    seen = {ast.dump(ast.parse(source))}
    found = []
    for statement, node, begin, end, new in _edits(whole):
        text = source[:begin] + new.encode() + source[end:]
        tree = ast.dump(ast.parse(text))
        if tree in seen:
            continue
        seen.add(tree)
        line = source.count(b"\n", 0, begin) + 1
        last = whole.starts[source.count(b"\n", 0, end) + 1]
        before = source[whole.starts[line - 1] : last].decode()
        after = text[whole.starts[line - 1] : last + len(text) - len(source)].decode()
        change = f"{' '.join(before.split())} -> {' '.join(after.split())}"
        reached = (statement.lineno, node.end_lineno)
        found.append(Mutant(module, path, text.decode(), line, reached, change))
    return found


class _Text:
    # the source of a module and where its nodes stand in it

    def __init__(self, source: bytes):
        self.source, self.starts = source, [0]
        for line in source.splitlines(keepends=True):
            self.starts.append(self.starts[-1] + len(line))

    def span(self, node) -> tuple[int, int]:
        """First byte of a node and the byte after it."""
        begin = self.starts[node.lineno - 1] + node.col_offset
        return begin, self.starts[node.end_lineno - 1] + node.end_col_offset

    def symbol(self, left: int, right: int, words: str) -> tuple[int, int, str]:
        """The first of some words between two bytes, not in a comment: its span and itself."""
        pattern = rb"(?:#[^\n]*\n|[^#])*?(" + words.encode() + rb")"
        match = re.search(pattern, self.source[left:right])
        assert match, self.source[left:right]
        return left + match.start(1), left + match.end(1), match.group(1).decode()

    def between(self, operands: list, words: str) -> Iterator[tuple[int, int, str]]:
        """Span and text of the operator after each operand but the last."""
        for one, two in zip(operands, operands[1:]):
            yield self.symbol(self.span(one)[1], self.span(two)[0], words)


def _edits(text: _Text) -> Iterator[tuple]:
    # the statement, the node, and what of the source to replace by what
    for statement, node in _nodes(ast.parse(text.source)):
        yield from ((statement, node, *edit) for edit in _of_expression(node, text))
        if node is statement:
            yield from ((node, node, *edit) for edit in _of_statement(node, text.span))


def _of_expression(node: ast.AST, text: _Text) -> Iterator[tuple]:
    if isinstance(node, ast.Compare):
        words = r"is\s+not|not\s+in|is|in|[<>=!]=|<|>"
        for begin, end, old in text.between([node.left, *node.comparators], words):
            new = _COMPARED[" ".join(old.split())]
            yield from ((begin, end, each) for each in (new.split() if new[0] in "<>" else [new]))
    elif isinstance(node, ast.BinOp | ast.AugAssign):
        one, two = (
            (node.left, node.right) if isinstance(node, ast.BinOp) else (node.target, node.value)
        )
        for begin, end, old in text.between([one, two], r"\*\*|//|<<|>>|[-+*/%&|^@]"):
            if old in _COMPUTED:
                yield begin, end, _COMPUTED[old]
    elif isinstance(node, ast.BoolOp):
        for begin, end, old in text.between(node.values, "and|or"):
            yield begin, end, "or" if old == "and" else "and"
    elif isinstance(node, ast.UnaryOp):
        begin, end = text.span(node)[0], text.span(node.operand)[0]
        yield *text.symbol(begin, end, r"not\s|not|[-+~]")[:2], ""
    elif isinstance(node, ast.Constant) and isinstance(node.value, bool | int | float):
        value = node.value
        new = not value if isinstance(value, bool) else value + 1
        yield *text.span(node), repr(new)
    elif isinstance(node, ast.Call):
        begin, end = text.span(node.func)
        old = text.source[begin:end].decode().rpartition(".")[2]
        if old in _CALLED_INSTEAD:
            yield end - len(old), end, _CALLED_INSTEAD[old]


def _of_statement(node: ast.stmt, span) -> Iterator[tuple]:
    # edits of a statement as one
    stored = node.targets if isinstance(node, ast.Assign) else []
    called = isinstance(node, ast.Expr) and isinstance(node.value, ast.Call)
    if (
        called
        or isinstance(node, ast.AugAssign | ast.Raise)
        or any(isinstance(each, ast.Attribute | ast.Subscript) for each in stored)
    ):
        yield *span(node), "pass"
    elif isinstance(node, ast.Continue | ast.Break):
        yield *span(node), "break" if isinstance(node, ast.Continue) else "continue"
    elif isinstance(node, ast.If | ast.While) and isinstance(
        node.test, ast.Name | ast.Attribute | ast.Subscript | ast.Call
    ):
        begin, _ = span(node.test)
        yield begin, begin, "not "


def _nodes(tree: ast.AST, statement: ast.stmt | None = None) -> Iterator[tuple]:
    # every node that may be mutated, with the statement it belongs to
    for name, value in ast.iter_fields(tree):
        for node in value if isinstance(value, list) else [value]:
            if not isinstance(node, ast.AST) or name in _SKIPPED:
                continue
            own = node if isinstance(node, ast.stmt) else statement
            if isinstance(node, _LEFT_ALONE) or _logs(node):
                continue
            if own is not None:
                yield own, node
            yield from _nodes(node, own)


def _logs(node: ast.AST) -> bool:
    call = node.value if isinstance(node, ast.Expr) else None
    called = call.func if isinstance(call, ast.Call) else None
    return isinstance(called, ast.Attribute) and called.attr in _LOGGED
