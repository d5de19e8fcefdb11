# SPDX-License-Identifier: Apache-2.0
"""The page of `make paper`, made of few robots: every section and picture is there."""

import importlib
import re
from pathlib import Path

import numpy as np
import pytest

_PAGE = Path(__file__).parents[1] / "docs" / "paper.md"


@pytest.fixture(scope="module")
def page(tmp_path_factory):
    folder = tmp_path_factory.mktemp("paper")
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(Path(__file__).parents[1] / "bench")
        command = importlib.import_module("paper")
    out = folder / "docs" / "paper.md"
    assert command.main(["--quick", "--out", str(out), "--images", str(folder / "images")]) == 0
    return out


def _headings(text: str) -> list[str]:
    return re.findall(r"^#+ .*$", text, re.MULTILINE)


def _pictures(page: Path) -> list[str]:
    return re.findall(r"!\[[^]]*\]\(([^)]*)\)", page.read_text(encoding="utf-8"))


def test_the_page_has_the_sections_and_pictures_of_the_one_in_docs(page):
    assert _headings(page.read_text()) == _headings(_PAGE.read_text())
    names = [Path(picture).name for picture in _pictures(page)]
    assert names == [Path(picture).name for picture in _pictures(_PAGE)]
    for picture in _pictures(page):
        assert (page.parent / picture).read_bytes().startswith(b"\x89PNG")


def test_a_table_has_as_many_cells_in_each_row_as_in_its_head(page):
    for table in re.findall(r"(?:^\|.*\|\n)+", page.read_text(), re.MULTILINE):
        assert len({line.count("|") for line in table.splitlines()}) == 1, table


def test_arrivals_are_the_instants_from_which_a_robot_stays_at_its_target(page):
    runs = importlib.import_module("paper_runs")
    problem = runs.problem_of(7, 0)
    planned = runs.make_planner("direct").plan(problem)
    there = runs.arrivals_s(problem, planned)
    assert np.isfinite(there).all()
    assert 0.0 < there.max() <= planned.motion.makespan_s
    late = np.full_like(planned.reason, runs.Reason.NOT_CONVERGED)
    assert np.isinf(runs.arrivals_s(problem, runs.PlannedMotion(
        planned.motion, planned.goal, late))).all()  # fmt: skip
