# SPDX-License-Identifier: Apache-2.0
"""The examples of the README run as they stand."""

import re
import shutil
from pathlib import Path

import pytest

README = (Path(__file__).parents[1] / "README.md").read_text()


def example(name):
    found = re.search(rf"<!-- example: {name} -->\n```python\n(.*?)```", README, re.DOTALL)
    assert found, name
    return found.group(1)


@pytest.fixture(autouse=True)
def folder(made_up, tmp_path, monkeypatch):
    shutil.copy(made_up / "desi_state.ecsv", tmp_path)
    (tmp_path / "mine.csv").write_text(
        "Fibre,XFP,YFP,Broken,Colour\n5,0,0,no,red\n6,25,0,YES,blue\n"
    )
    monkeypatch.chdir(tmp_path)


def test_the_example_of_reading_prints_what_the_readme_shows(capsys):
    names = {}
    exec(example("read"), names)
    shown = re.search(r"```\n(desi_state.*?)\.\.\.\n```", README, re.DOTALL).group(1)
    assert capsys.readouterr().out.startswith(shown)
    assert names["starts"].angles.shape == (6, 2)


def test_the_example_of_a_new_format_reads_its_file(capsys):
    names = {}
    exec(example("add"), names)
    out = capsys.readouterr().out
    assert out.startswith("mine.csv: 2 robots, 1 disabled; from preset lamost: arms")
    layout = names["layout_of_mine"]
    assert layout.format_name == "my instrument" and layout.plane.ids.tolist() == [5, 6]
    assert layout.notices == ("columns not used: Colour",)


def test_every_format_stands_in_the_table_of_the_readme():
    modules = {
        p.stem for p in (Path(__file__).parents[1] / "fiber_formats" / "formats").glob("*.py")
    }
    formats = modules - {"__init__", "desi_frame", "desi_keepouts", "numbers"}
    table = README.split("## Formats")[1].split("## Own columns")[0]
    assert table.count("\n|") == len(formats) + 2
