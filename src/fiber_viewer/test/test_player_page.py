# SPDX-License-Identifier: Apache-2.0
"""The page, opened from disk in a browser, and used with mouse and keys."""

import json
import re

import numpy as np
import pytest
from chromium import By, Keys, color, drawn, needs_browser, open_at, picture, size, until, webdriver

from fiber_core import kinematics
from fiber_viewer import write_player

pytestmark = needs_browser("player.html in a browser")


def time_of(browser) -> float:
    return browser.execute_script("return player.t")


def test_it_opens_from_disk_without_a_log_entry_or_a_request(browser, page):
    for kind in ("browser", "performance"):
        browser.get_log(kind)
    open_at(browser, page, "")
    logged = [entry for entry in browser.get_log("browser") if entry["level"] != "INFO"]
    assert not logged
    requested = []
    for entry in browser.get_log("performance"):
        message = json.loads(entry["message"])["message"]
        if message["method"] == "Network.requestWillBeSent":
            requested.append(message["params"]["request"]["url"])
    outside = [url for url in requested if not url.startswith(("data:", "about:", "blob:"))]
    assert set(outside) == {page.as_uri()}
    heading = browser.find_element(By.ID, "title").text
    assert heading == "desi: 33 of 36 robots reached their targets; 1 held, 1 disabled, 1 failed."


def distance(points, a, b) -> np.ndarray:
    """Return the distance of points, shape (..., 2), from the nearest line a to b, shape (k, 2)."""
    least = np.full(points.shape[:-1], np.inf)
    for begin, end in zip(a, b):
        along = end - begin
        part = np.clip((points - begin) @ along / max(along @ along, 1e-12), 0, 1)
        away = np.linalg.norm(points - begin - part[..., None] * along, axis=-1)
        least = np.minimum(least, away)
    return least


@pytest.mark.parametrize("t", [0.0, 0.31, 0.9])
def test_every_pixel_of_an_arm_is_inside_its_outline(opened, recording, t):
    plane, scale = recording.problem.plane, 25.0
    elbow, tip = kinematics.forward(plane, recording.executed(t))
    view = 0.5 * (elbow + tip)[8]
    opened.execute_script(
        """
        player.robots = [];
        const c = player.plane.camera;
        [c.x, c.y, c.scale] = arguments[1];
        player.plane.untouched = false;
        player.seek(arguments[0]);
        """,
        t,
        [*view, scale],
    )
    seen = picture(opened, "plane")[..., :3]
    height, width = seen.shape[:2]
    x, y = np.meshgrid(np.arange(0, width, 3) + 0.5, np.arange(0, height, 3) + 0.5)
    seen = seen[::3, ::3]
    xy = view + np.stack([x - width / 2, height / 2 - y], axis=-1) / scale
    empty = np.abs(seen - color(opened, "card")).max(axis=-1) < 0.02
    free = (x < width - 50) & (y < height - 30)  # of the buttons and the hint over the canvas
    # thin lines along both arms, fibres, centres with their marks, and targets
    spine = np.minimum(distance(xy, elbow, tip), distance(xy, plane.centers, elbow))
    targets = recording.problem.targets[recording.problem.asked]
    spots = np.concatenate([tip, elbow, plane.centers, targets])
    plain = free & (spine > 0.3) & (distance(xy, spots, spots) > 0.5)

    outline = distance(xy, elbow, tip) - plane.phi_radius[0]
    inside, outside = plain & (outline < -0.08), plain & (outline > 0.08)
    assert inside.sum() > 200 and outside.sum() > 10_000
    assert not (inside & empty).any(), "an arm is missing"
    assert not (outside & ~empty).any(), "something is drawn where nothing is"


def test_a_click_on_a_robot_shows_its_curves(opened, recording):
    plane, motion = recording.problem.plane, recording.executed
    row = 16
    opened.execute_script("player.robots = []; player.list.showWatched(); player.seek(0.5)")
    drawn(opened)
    assert "Click a robot" not in opened.find_element(By.ID, "velocity-note").text
    empty = picture(opened, "velocity")
    camera = opened.execute_script("const c = player.plane.camera; return [c.x, c.y, c.scale]")
    elbow, tip = kinematics.forward(plane, motion(0.5))
    at = camera[2] * (0.5 * (elbow + tip)[row] - camera[:2]) * [1, -1]
    canvas = opened.find_element(By.ID, "plane")
    opened.execute_script("arguments[0].scrollIntoView({block: 'center'})", canvas)
    webdriver.ActionChains(opened).move_to_element_with_offset(
        canvas, round(at[0]), round(at[1])
    ).click().perform()
    until(opened, "return player.robots.length === 1")
    robot = plane.ids[row]
    assert opened.find_element(By.ID, "watched").text == str(robot)
    full = picture(opened, "velocity")
    assert np.abs(full - empty).max() > 0.5
    for note in ("velocity-note", "position-note"):
        assert f"robot {robot}" in opened.find_element(By.ID, note).text
    until(opened, f"return location.hash.includes('robots={robot}')")


def test_dragging_the_timeline_changes_the_picture_and_the_address(opened):
    opened.execute_script("player.seek(0)")
    before = picture(opened, "plane")
    timeline = opened.find_element(By.ID, "timeline")
    width = timeline.size["width"]
    webdriver.ActionChains(opened).move_to_element_with_offset(
        timeline, -width // 2 + 20, 12
    ).click_and_hold().move_by_offset(width // 3, 0).release().perform()
    t = time_of(opened)
    assert t > 0.1
    assert np.abs(picture(opened, "plane") - before).max() > 0.3
    assert opened.find_element(By.ID, "clock").text == f"{t:.3f} s"
    until(opened, f"return location.hash.includes('t={t:.4f}')")


def test_a_fault_is_two_clicks_away(opened, recording):
    robot = recording.problem.plane.ids[11]
    opened.find_element(By.CSS_SELECTOR, "[data-tab=faults]").click()
    faults = opened.find_elements(By.CSS_SELECTOR, "#list button")
    assert [fault.text.split("\n")[0] for fault in faults] == ["0.300 s", "0.400 s"]
    faults[1].click()
    assert time_of(opened) == pytest.approx(0.4)
    assert opened.find_element(By.ID, "watched").text == str(robot)


def test_robots_with_a_target_are_counted_as_the_lists_name_them(opened, recording):
    ids, seen = recording.problem.plane.ids, {}
    for tab in ("missed", "disabled"):
        button = opened.find_element(By.CSS_SELECTOR, f"[data-tab={tab}]")
        button.click()
        entries = opened.find_elements(By.CSS_SELECTOR, "#list button")
        seen[tab] = [int(entry.text.split("\n")[0]) for entry in entries]
        assert button.text.endswith(f"({len(entries)})")
    assert seen == {"missed": [ids[5], ids[11]], "disabled": [ids[20]]}
    numbers = [
        int(opened.find_element(By.CSS_SELECTOR, f"[data-name={name}] button").text)
        for name in ("held", "failed", "disabled")
    ]
    assert numbers == [1, 1, 1]


def test_a_stop_of_all_robots_and_resumed_motion_are_two_clicks_away(
    browser, resumed, resumed_file, tmp_path
):
    write_player(tmp_path / "player.html", resumed_file)
    open_at(browser, tmp_path / "player.html", "#theme=light")
    browser.find_element(By.CSS_SELECTOR, "[data-tab=faults]").click()
    (pause,) = resumed.pauses_s
    for words, time_s, shown in (
        ("all robots stopped", pause[0], True),
        ("resumed", pause[1], False),
    ):
        entries = browser.find_elements(By.CSS_SELECTOR, "#list button")
        (entry,) = (e for e in entries if words in e.text)
        entry.click()
        drawn(browser)
        assert time_of(browser) == pytest.approx(time_s)
        stopped = [e.text for e in browser.find_elements(By.CSS_SELECTOR, "#legend span")]
        assert any("stopped" in text for text in stopped) == shown
        arms = picture(browser, "plane")[..., :3]
        violet = np.abs(arms - color(browser, "stopped")).max(axis=-1) < 0.02
        assert (violet.sum() > 100) == shown


def test_the_closest_approach_is_one_click_away(opened, recording):
    opened.find_element(By.CSS_SELECTOR, "[data-name='least clearance'] button").click()
    near = recording.approaches
    assert time_of(opened) == pytest.approx(near.time_s[0], abs=1e-6)
    watched = opened.find_element(By.ID, "watched").text.split()
    ids = recording.problem.plane.ids[near.pairs[0]]
    assert [int(robot) for robot in watched] == ids.tolist()
    assert f"{near.gap_mm[0]:.3f} mm" in opened.find_element(By.ID, "snapshots-note").text


def test_a_click_on_an_approach_shows_it(opened, recording):
    opened.find_elements(By.CSS_SELECTOR, "#list button")[4].click()
    near, ids = recording.approaches, recording.problem.plane.ids
    one, other = ids[near.pairs[4]]
    note = opened.find_element(By.ID, "snapshots-note")
    drawn(opened)
    assert f"robots {one} and {other}: {near.gap_mm[4]:.3f} mm" in note.text
    assert time_of(opened) == pytest.approx(near.time_s[4], abs=1e-6)


def test_a_robot_is_found_by_its_id(opened, recording):
    robot = recording.problem.plane.ids[23]
    body = opened.find_element(By.TAG_NAME, "body")
    body.send_keys("/")
    opened.switch_to.active_element.send_keys(str(robot), Keys.ENTER)
    assert opened.find_element(By.ID, "watched").text == str(robot)
    search = opened.find_element(By.ID, "search")
    search.clear()
    search.send_keys("999", Keys.ENTER)
    assert opened.find_element(By.ID, "watched").text == str(robot)
    assert opened.execute_script("return arguments[0].validationMessage", search) == "no such robot"


def test_play_runs_to_the_end_and_stops(opened):
    opened.execute_script("player.speed = 100; player.seek(0)")
    body = opened.find_element(By.TAG_NAME, "body")
    body.send_keys(" ")
    until(opened, "return !player.playing && player.t === player.recording.end")
    body.send_keys(Keys.HOME)
    assert time_of(opened) == 0.0
    body.send_keys(Keys.ARROW_RIGHT)
    step = time_of(opened)
    assert step > 0
    body.send_keys(Keys.SHIFT, Keys.ARROW_RIGHT)
    assert time_of(opened) > step


def test_number_keys_show_a_panel_alone(opened):
    body = opened.find_element(By.TAG_NAME, "body")
    for number, canvas in enumerate(
        ("plane", "neighbourhood", "snapshots", "velocity", "position", "buses"), 1
    ):
        body.send_keys(str(number))
        drawn(opened)
        box = opened.find_element(By.ID, canvas).rect
        assert box["width"] > 1200 and box["height"] > 700, canvas
        seen = picture(opened, canvas)[..., :3]
        assert np.ptp(seen.reshape(-1, 3), axis=0).max() > 0.4, f"{canvas} is empty"
        body.send_keys(Keys.ESCAPE)
    assert not opened.find_elements(By.CSS_SELECTOR, ".alone")


def test_an_address_shows_the_same_view_again(browser, page, recording):
    ids = recording.problem.plane.ids[[7, 9]]
    open_at(browser, page, f"#t=0.7000&robots={ids[0]},{ids[1]}&panel=5")
    assert time_of(browser) == pytest.approx(0.7)
    watched = browser.execute_script("return Array.from(player.robots)")
    assert watched == [7, 9]
    assert browser.find_element(By.CSS_SELECTOR, ".alone").get_attribute("data-panel") == "5"


def test_light_and_dark_differ_and_states_have_different_colours(opened):
    body = opened.find_element(By.TAG_NAME, "body")
    for _ in range(2):
        states = [color(opened, n) for n in ("moving", "reached", "held", "failed", "card")]
        # held and failed robots have marks, too, so that colour is not needed
        apart = [np.linalg.norm(a - b) for i, a in enumerate(states) for b in states[:i]]
        assert min(apart) > 0.2
        body.send_keys("d")
        drawn(opened)
    light = color(opened, "card").mean()
    body.send_keys("d")
    assert abs(color(opened, "card").mean() - light) > 0.5


def test_a_phone_shows_everything_in_one_column(browser, page):
    size(browser, 390, 844)
    open_at(browser, page, "")
    assert browser.execute_script("return document.documentElement.scrollWidth") <= 390
    shown = browser.find_elements(By.CSS_SELECTOR, "main .panel:not([hidden])")
    lefts = {panel.rect["x"] for panel in shown}
    assert len(lefts) == 1
    play = browser.find_element(By.ID, "play").rect
    assert play["height"] >= 40 and play["y"] + play["height"] <= 844 + browser.execute_script(
        "return scrollY"
    )
    assert np.ptp(picture(browser, "plane")[..., :3]) > 0.4


def test_a_page_without_a_recording_shows_an_error(browser, page, tmp_path):
    broken = tmp_path / "broken.html"
    text = page.read_text()
    begin = text.index('id="recording">') + len('id="recording">')
    text = text[:begin] + "AAAA" + text[text.index("</script>", begin) :]
    broken.write_text(re.sub(r'data-length="\d+"', 'data-length="4"', text))
    browser.get(broken.as_uri())
    until(browser, "return !document.getElementById('problem').hidden")
    assert "not a recording" in browser.find_element(By.ID, "problem").text
