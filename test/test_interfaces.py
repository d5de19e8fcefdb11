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


LEANING = re.compile(r"(The same|Nor|Of|And|Its?|Their)\b|\w*[_.]\w|\w of the paper")


def test_a_meaning_is_read_without_the_rows_beside_it(pages):
    # as `ros2 param describe` shows it: no words that lean on another one, no name that a capital
    # has changed
    rows = [line.strip("|").split(" | ") for line in pages[1].splitlines() if line[:3] == "| `"]
    meanings = {cells[0]: cells[-1] for cells in rows if len(cells) == 6 and "/" not in cells[0]}
    assert len(meanings) > 100
    leaning = {name: text for name, text in meanings.items() if LEANING.match(text.strip())}
    assert not leaning


def test_every_row_has_a_meaning_and_every_topic_an_end(pages):
    rows = [line.strip("|").split(" | ") for line in pages[1].splitlines() if line[:3] == "| `"]
    assert len(rows) > 100
    for cells in rows:
        if not re.search(r": `(y|success)`$", cells[2].strip()):
            assert cells[-1].strip(), cells
        if "focal_plane/" in cells[0] and len(cells) == 6:
            # their other end is another program, or a command of fiber_client
            from_commands, to_others = ("/turns",), ("/view/", "camera/image", "/lights")
            assert cells[3].strip() or any(name in cells[0] for name in from_commands), cells
            assert cells[4].strip() or any(name in cells[0] for name in to_others), cells
