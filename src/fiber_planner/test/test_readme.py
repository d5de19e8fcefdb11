# SPDX-License-Identifier: Apache-2.0
"""The examples of the README run as they are printed."""

import re
from pathlib import Path

import pytest

EXAMPLES = re.findall(
    r"```python\n(.*?)```", (Path(__file__).parents[1] / "README.md").read_text(), re.DOTALL
)


@pytest.mark.parametrize("number", range(len(EXAMPLES)))
def test_an_example_of_the_readme_runs(number, capsys):
    exec(EXAMPLES[number], {"__name__": "example"})
    assert re.search(r"\d\.\d\d s", capsys.readouterr().out)


def test_the_readme_has_two_examples():
    assert len(EXAMPLES) == 2
