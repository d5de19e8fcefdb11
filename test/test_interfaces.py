# SPDX-License-Identifier: Apache-2.0
"""The page of interfaces is what the nodes declare."""

import re

import interfaces
import pytest

pytestmark = pytest.mark.timeout(300)


@pytest.fixture(scope="module")
def pages(new_domain):
    """The page as it is, and as the nodes would have it."""
    text = interfaces.PAGE.read_text()
    return text, interfaces.fresh(text, new_domain())


def test_the_page_of_interfaces_is_up_to_date(pages):
    page, fresh = (text.splitlines() for text in pages)
    stale = sorted(set(fresh) ^ set(page))
    assert page == fresh, f"run tools/interfaces.py: {stale[:5]}"


def test_every_row_has_a_meaning_and_every_topic_an_end(pages):
    rows = [line.strip("|").split(" | ") for line in pages[1].splitlines() if line[:3] == "| `"]
    assert len(rows) > 100
    for cells in rows:
        if not re.search(r": `(y|success)`$", cells[2].strip()):
            assert cells[-1].strip(), cells
        if "focal_plane/" in cells[0] and len(cells) == 6:
            assert cells[3].strip() and (
                cells[4].strip() or "/view/" in cells[0] or "camera/image" in cells[0]
            ), cells
