# SPDX-License-Identifier: Apache-2.0
"""The controls of the page: colours, keys, legends, contrast, and damaged or scriptless pages."""

import re
from pathlib import Path

import numpy as np
import pytest
from chromium import By, Keys, color, drawn, needs_browser, open_at, picture, until

import fiber_viewer
from fiber_core import kinematics
from fiber_core.outcomes import Outcome

try:
    from selenium_axe_python import Axe
except ImportError:
    Axe = None

PLAYER = Path(fiber_viewer.__file__).parent / "player"
LEAST_CONTRAST = 4.5  # WCAG 2.2, criterion 1.4.3
pytestmark = needs_browser("the controls of player.html")


def legend(browser):
    drawn(browser)
    return [e.text for e in browser.find_elements(By.CSS_SELECTOR, "#legend span") if e.text]


def test_robots_are_coloured_by_what_is_chosen(opened, recording):
    plane, near = recording.problem.plane, recording.approaches
    opened.execute_script("player.robots = []; player.marked = []; player.seek(9)")
    pictures = {}
    for mode in ("state", "outcome", "bus", "speed", "arrival", "clearance", "error"):
        option = opened.find_element(By.CSS_SELECTOR, f"#coloring option[value={mode}]")
        option.click()
        if mode in ("state", "bus", "arrival", "clearance"):
            pictures[mode] = picture(opened, "plane")[..., :3]
        texts = legend(opened)
        if mode == "outcome":
            reached = int((recording.outcome[plane.enabled] == Outcome.REACHED).sum())
            assert f"{reached} reached" in texts and "1 failed" in texts
        if mode == "bus":
            assert texts == [f"{plane.n} bus 0"]
        if mode == "clearance":
            least = near.gap_mm.min()
            assert texts[0].startswith(f"{least:.2f} to ") and "mm" in texts[0]
            ends = {int(row) for row in near.pairs.ravel() if row < plane.n}
            without = plane.n - len(ends)
            assert texts[1:] == ([f"{without} without"] if without else [])
        if mode == "speed":
            assert texts[1] == f"{plane.n} without"  # at the end no robot moves
    for one, other in (("state", "bus"), ("bus", "arrival"), ("arrival", "clearance")):
        assert np.abs(pictures[one] - pictures[other]).max() > 0.2, (one, other)
    until(opened, "return location.hash.includes('color=error')")
    opened.execute_script("location.hash = '#color=arrival'")
    until(opened, "return player.coloring.key === 'arrival'")


def test_the_colour_of_arrival_follows_the_time_of_arrival(opened, recording):
    ends = recording.executed.durations.max(axis=1)
    groups = opened.execute_script(
        "player.colorBy('arrival');"
        "return Array.from(player.recording.plane.ids, (_, row) => player.coloring.groupOf(row, 0))"
    )
    moves = ends > 0
    order = np.argsort(ends[moves], kind="stable")
    assert (np.diff(np.array(groups)[moves][order]) >= 0).all()
    assert len(set(groups)) > 6 and set(np.array(groups)[~moves]) == {16}


def test_targets_and_a_scale_bar_are_on_the_whole_plane(opened, recording):
    opened.execute_script("player.robots = []; player.marked = []; player.seek(0)")
    opened.execute_script("player.plane.outlinesFrom = Infinity; player.redraw()")
    seen = picture(opened, "plane")[..., :3]
    camera = opened.execute_script("const c = player.plane.camera; return [c.x, c.y, c.scale]")
    height, width = seen.shape[:2]
    dots = color(opened, "target")
    plane = recording.problem.plane
    elbow, tip = kinematics.forward(plane, recording.problem.start)
    targets = recording.problem.targets[recording.problem.asked]
    arms = zip([*plane.centers, *elbow], [*elbow, *tip])
    covered = np.zeros(len(targets), bool)
    for begin, end in arms:
        along = np.linspace(begin, end, 60)
        covered |= np.linalg.norm(targets[:, None] - along, axis=-1).min(axis=1) < 0.35
    assert (~covered).sum() > 5
    for x, y in targets[~covered]:
        px, py = width / 2 + (x - camera[0]) * camera[2], height / 2 - (y - camera[1]) * camera[2]
        near = seen[int(py) - 2 : int(py) + 3, int(px) - 2 : int(px) + 3]
        assert np.abs(near - dots).max(axis=-1).min() < 0.1, f"the target at {x}, {y} is missing"
    bar = np.abs(seen[height - 12, -150:] - color(opened, "soft")).max(axis=-1) < 0.2
    length = bar.sum() / camera[2]
    assert min(abs(length - mm) for mm in (1, 2, 5, 10, 20, 50)) < 0.1 * length
    opened.execute_script("player.watch(7)")
    opened.find_element(By.ID, "zoom-watched").click()
    drawn(opened)
    at = opened.execute_script("const c = player.plane.camera; return [c.x, c.y, c.scale]")
    np.testing.assert_allclose(at[:2], recording.problem.plane.centers[7])
    assert at[2] > 1.5 * camera[2]


def test_a_list_is_one_tab_stop_with_arrow_keys(opened):
    tab = opened.find_element(By.CSS_SELECTOR, "[data-tab=closest]")
    tab.click()
    stops = opened.execute_script(
        "return [...document.querySelectorAll('#list button, #tabs button')]"
        ".filter((b) => b.tabIndex === 0).length"
    )
    assert stops == 2
    tab.send_keys(Keys.TAB)
    for key, place in ((None, 0), (Keys.ARROW_DOWN, 1), (Keys.ARROW_DOWN, 2), (Keys.ARROW_UP, 1)):
        if key:
            opened.switch_to.active_element.send_keys(key)
        at = opened.execute_script(
            "return [...document.querySelectorAll('#list button')].indexOf(document.activeElement)"
        )
        assert at == place
    opened.switch_to.active_element.send_keys(Keys.ENTER)
    assert opened.execute_script("return player.pair === player.recording.pairs[1]"), (
        "the entry in focus is opened"
    )
    opened.switch_to.active_element.send_keys(Keys.TAB)
    inside = "return document.getElementById('list').contains(document.activeElement)"
    assert not opened.execute_script(inside)
    tab.send_keys(Keys.ARROW_RIGHT)
    assert opened.switch_to.active_element.get_attribute("data-tab") == "faults"


def luminance(rgb):
    linear = np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)
    return linear @ [0.2126, 0.7152, 0.0722]


def contrast(one, other):
    light, dark = sorted((luminance(one), luminance(other)), reverse=True)
    return (light + 0.05) / (dark + 0.05)


def test_all_texts_have_contrast_in_both_themes(browser, page):
    texts = set()
    for path in PLAYER.glob("*.js"):
        for call in re.findall(r"\b(?:write|label)\(ctx, .*?colors\.(\w+)", path.read_text()):
            texts.add(call)
    assert texts <= {"ink", "soft"}, "texts on canvases have these colours"
    for theme in ("light", "dark"):
        open_at(browser, page, f"#theme={theme}")
        paints = {name: color(browser, name) for name in ("ground", "card", "faint", "stopped")}
        paints["stopped"] = 0.25 * paints["stopped"] + 0.75 * paints["card"]
        for text in ("ink", "soft", "warn", "bad"):
            for under, paint in paints.items():
                if under == "stopped" and text != "ink":
                    continue
                ratio = contrast(color(browser, text), paint)
                assert ratio >= LEAST_CONTRAST, f"{theme}: {text} on {under} is {ratio:.2f} : 1"


@pytest.mark.skipif(Axe is None, reason="NOT TESTED: accessibility: needs selenium-axe-python")
def test_a_checker_finds_no_fault_of_accessibility(browser, page):
    for theme, options in (("light", {}), ("dark", {"runOnly": ["color-contrast"]})):
        open_at(browser, page, f"#theme={theme}")
        browser.execute_script("player.list.show('missed')")  # a short list: all entries are alike
        axe = Axe(browser)
        axe.inject()
        result = axe.run(options=options)
        assert "color-contrast" in {each["id"] for each in result["passes"]}
        found = result["violations"]
        assert not [(each["id"], [n["html"][:120] for n in each["nodes"]]) for each in found]


@pytest.mark.parametrize(("part", "words"), [(0.5, "its end is missing"), (0.99, "its end")])
def test_a_page_that_is_cut_off_says_so(browser, page, tmp_path, part, words):
    text = page.read_text()
    cut = tmp_path / "cut.html"
    cut.write_text(text[: int(part * len(text))])
    browser.get(cut.as_uri())
    until(browser, "return !document.getElementById('problem').hidden")
    assert words in browser.find_element(By.ID, "problem").text


def test_a_page_with_a_hole_in_its_recording_says_so(browser, page, tmp_path):
    text = page.read_text()
    begin = text.index('id="recording">') + 400
    (tmp_path / "hole.html").write_text(text[:begin] + text[begin + 4000 :])
    browser.get((tmp_path / "hole.html").as_uri())
    until(browser, "return document.getElementById('title').textContent === 'Damaged page'")
    assert "not as long as it was" in browser.find_element(By.ID, "problem").text


def test_a_page_without_scripts_says_so(browser, page):
    browser.execute_cdp_cmd("Emulation.setScriptExecutionDisabled", {"value": True})
    try:
        browser.get(page.as_uri())
        assert "switched off" in browser.find_element(By.TAG_NAME, "noscript").text
    finally:
        browser.execute_cdp_cmd("Emulation.setScriptExecutionDisabled", {"value": False})
