# SPDX-License-Identifier: Apache-2.0
"""Mutants: what is planted and what is left alone."""

import ast

from mutants import mutants_of

SOURCE = '''
"""A module of 3 lines."""
from numba import njit

LIMIT = 0.5  # < 7


@njit(cache=True)
def f(a: int, b: int = 2) -> "float | None":
    """Return -1 or 1."""
    if not a < b <= 9 and a is not b:
        raise ValueError(f"a is {a + 1}", 5)
    for k in range(b):
        if k in (a,
                 # a < comment - with operators
                 b):
            continue
        a -= max(k * b, 0)
    assert a > 0
    log.info(a + 1)
    return a ** 2 if a else -a
'''


def changes(tmp_path, source=SOURCE):
    path = tmp_path / "sample.py"
    path.write_text(source)
    return [mutant.change for mutant in mutants_of("sample", path)]


def test_each_operator_is_changed_once_and_texts_annotations_and_logs_are_left_alone(tmp_path):
    found = [
        tuple(change.split(" -> ")) for change in changes(tmp_path, SOURCE) if "def f" not in change
    ]
    condition = "if not a < b <= 9 and a is not b:"
    loop = "a -= max(k * b, 0)"
    end = "return a ** 2 if a else -a"
    assert sorted(found) == sorted(
        [
            ("LIMIT = 0.5 # < 7", "LIMIT = 1.5 # < 7"),
            (condition, "if a < b <= 9 and a is not b:"),
            (condition, "if not a <= b <= 9 and a is not b:"),
            (condition, "if not a >= b <= 9 and a is not b:"),
            (condition, "if not a < b < 9 and a is not b:"),
            (condition, "if not a < b > 9 and a is not b:"),
            (condition, "if not a < b <= 10 and a is not b:"),
            (condition, "if not a < b <= 9 or a is not b:"),
            (condition, "if not a < b <= 9 and a is b:"),
            ('raise ValueError(f"a is {a + 1}", 5)', "pass"),
            ("if k in (a,", "if k not in (a,"),
            ("continue", "break"),
            (loop, "pass"),
            (loop, "a += max(k * b, 0)"),
            (loop, "a -= min(k * b, 0)"),
            (loop, "a -= max(k / b, 0)"),
            (loop, "a -= max(k * b, 1)"),
            (end, "return a * 2 if a else -a"),
            (end, "return a ** 3 if a else -a"),
            (end, "return a ** 2 if a else a"),
        ]
    )
    (head,) = [change for change in changes(tmp_path) if "def f" in change]
    assert head.count("b: int = 2") == 1 and head.endswith('b: int = 3) -> "float | None":')


def test_each_mutant_is_a_module_of_its_own_and_knows_its_lines(tmp_path):
    path = tmp_path / "sample.py"
    path.write_text(SOURCE)
    mutants = mutants_of("sample", path)
    trees = {ast.dump(ast.parse(mutant.text)) for mutant in mutants} | {ast.dump(ast.parse(SOURCE))}
    assert len(trees) == len({mutant.key for mutant in mutants}) + 1 == len(mutants) + 1
    lines = SOURCE.split("\n")
    for mutant in mutants:
        first, last = mutant.reached_by
        assert first <= mutant.line <= last
        assert mutant.change.startswith(" ".join(lines[mutant.line - 1].split()))
