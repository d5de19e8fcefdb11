# SPDX-License-Identifier: Apache-2.0
"""The console: a running plane in a browser, its orders, and what it refuses."""

import asyncio
import http.client
import os
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from tornado.httpclient import HTTPClientError, HTTPRequest
from tornado.websocket import websocket_connect

from fiber_bringup.graph import Graph
from fiber_client.client import PlaneClient
from fiber_core import kinematics
from fiber_core.fields import random_field
from fiber_core.outcomes import Outcome

sys.path.append(str(Path(__file__).parents[1] / "src/fiber_viewer/test"))
from chromium import By, color, drawn, needs_browser, picture, start_browser, until

try:
    from selenium_axe_python import Axe
except ImportError:
    Axe = None

pytestmark = pytest.mark.timeout(300)
WAIT_S = 60.0
COMPILE_S = 600.0
PROGRAM = "from fiber_console.node import main; raise SystemExit(main())"


class ConsoleProcess:
    """A console in a process of its own, as it is in a launch."""

    def __init__(self, domain, folder, port=0):
        self.domain, self.folder, self.port = domain, folder, port
        self.start()

    def start(self):
        parameters = {"port": self.port, "folder": self.folder, "token_file": self.folder / "token"}
        self.process = subprocess.Popen(
            [sys.executable, "-c", PROGRAM, "--ros-args"]
            + [part for name, value in parameters.items() for part in ("-p", f"{name}:={value}")],
            env=os.environ | {"ROS_DOMAIN_ID": str(self.domain)},
            stdout=subprocess.PIPE,
            text=True,
        )
        for line in self.process.stdout:
            if "the console is at " in line:
                self.address = line.split("the console is at ")[1].strip()
                break
        else:
            raise RuntimeError("the console has not started")
        self.port = int(self.address.split(":")[2].split("/")[0])
        self.token = self.address.partition("token=")[2]

    def kill(self):
        self.process.send_signal(signal.SIGKILL)
        self.process.wait()

    def get(self, path, host=None):
        """Return the status and the text of an answer."""
        asked = http.client.HTTPConnection("127.0.0.1", self.port, timeout=10)
        asked.request("GET", path, headers={} if host is None else {"Host": host})
        answer = asked.getresponse()
        return answer.status, answer.read()


@pytest.fixture(scope="module")
def plane(problem_file, new_domain):
    """A graph whose motions take some seconds, and a client."""
    domain = new_domain()
    bridge = {"problem": problem_file, "time_scale": 0.4}
    with Graph(bridge=bridge, domain=domain), PlaneClient(domain) as client:
        client.wait_for_graph(COMPILE_S)
        client.domain = domain
        yield client


@pytest.fixture(scope="module")
def console(plane, tmp_path_factory):
    started = ConsoleProcess(plane.domain, tmp_path_factory.mktemp("console"))
    yield started
    started.process.send_signal(signal.SIGINT)
    assert started.process.wait(20) == 0


@pytest.fixture(scope="module")
def browser(tmp_path_factory):
    driver = start_browser(tmp_path_factory.mktemp("profile"))
    yield driver
    driver.quit()


@pytest.fixture
def opened(browser, console):
    browser.get("about:blank")
    browser.get(console.address)
    until(browser, "return Boolean(globalThis.player?.newest) && player.frames > 0")
    return browser


def press(browser, order):
    """Press the button of an order and confirm; return the newest answer."""
    before = len(browser.find_elements(By.CSS_SELECTOR, "#answers li"))
    browser.find_element(By.CSS_SELECTOR, f"[data-order={order}]").click()
    if order != "stop":
        browser.find_element(By.ID, "confirm-yes").click()
    until(browser, f"return document.querySelectorAll('#answers li').length > {before}")
    return browser.find_element(By.CSS_SELECTOR, "#answers li").text


def check_pixels(browser, plane, angles):
    """Check that arms of robots are where angles of the encoders say."""
    scale = 30.0
    elbow, tip = kinematics.forward(plane, angles)
    browser.execute_script("player.robots = [];")
    for row in (10, 30):
        middle = 0.5 * (elbow + tip)[row]
        browser.execute_script(
            "const c = player.plane.camera; [c.x, c.y, c.scale] = arguments[0];"
            "player.plane.fitted = true; player.plane.untouched = false; player.redraw();",
            [*middle, scale],
        )
        seen = picture(browser, "plane")[..., :3]
        height, width = seen.shape[:2]
        card = color(browser, "card")
        along = (tip - elbow)[row] / np.linalg.norm((tip - elbow)[row])
        across = np.array([-along[1], along[0]])

        def paint(off_mm, height=height, width=width, seen=seen, across=across):
            x, y = scale * off_mm * across
            return seen[int(height / 2 - y), int(width / 2 + x)]

        radius = plane.phi_radius[row]
        for side in (-1, 1):  # in the outline; the arm itself is drawn as a line in its middle
            assert np.abs(paint(side * 0.6 * radius) - card).max() > 0.1, f"row {row} is missing"
            assert np.abs(paint(side * (radius + 0.15)) - card).max() < 0.05, f"row {row} is off"


def newest_angles(client):
    client.wait_for(lambda: not client.moving, WAIT_S, "rest")
    return client.angles


def send_random_targets(client, seed):
    drawn_field = random_field(client.plane, np.random.default_rng(seed), start=client.angles)
    problem = drawn_field.problem
    stamp = client.send_targets(client.plane.ids[problem.asked], problem.targets[problem.asked])
    client.wait_until_ready(stamp, COMPILE_S)
    return stamp


@needs_browser("the console in a browser")
def test_a_plan_is_started_seen_and_stopped(opened, plane):
    check_pixels(opened, plane.plane, newest_angles(plane))
    stamp = send_random_targets(plane, 1)
    until(opened, f"return player.ready === '{stamp}'")
    assert opened.find_element(By.ID, "title").text == f"Plan {stamp} can be started"
    waiting = "player.recording.states.filter((state) => state === 7).length"
    assert opened.execute_script(f"return {waiting}") == 58  # all that are enabled
    opened.find_element(By.CSS_SELECTOR, "[data-order=start]").click()
    assert str(stamp) in opened.find_element(By.ID, "confirm-text").text
    opened.find_element(By.CSS_SELECTOR, "#confirm [value=cancel]").click()
    answer = press(opened, "start")
    assert answer.startswith(f"start, plan {stamp}:") and "refused" not in answer
    until(opened, "return player.recording.states.filter((state) => state === 0).length > 10")
    frames = opened.execute_script("return player.frames")
    answer = press(opened, "stop")
    assert answer.startswith("stop:") and answer.endswith(" ms")
    ended = plane.wait_for_outcome(stamp, WAIT_S)
    assert (ended.outcome == Outcome.HELD).sum() > 10  # in the middle of their motion
    until(opened, "return !player.recording.states.some((state) => state === 0)")
    assert opened.execute_script("return player.frames") > frames
    until(
        opened, f"return document.getElementById('title').textContent.startsWith('Plan {stamp}:')"
    )
    check_pixels(opened, plane.plane, newest_angles(plane))
    states = opened.execute_script("return Array.from(player.recording.states)")
    held, disabled = 2, 5
    assert [row for row, state in enumerate(states) if state == disabled] == [3, 17, 40]
    assert "refused" not in press(opened, "clear")
    assert states.count(held) == (ended.of(plane.plane.ids[plane.plane.enabled]).outcome == 1).sum()


@needs_browser("the console in a browser")
def test_while_a_stop_waits_for_its_answer_no_picture_delays_it(opened):
    waited = opened.execute_async_script("""
        const done = arguments[0], {orders} = player, send = orders.send, now = performance.now();
        const after = (frames, act) => frames
            ? requestAnimationFrame(() => after(frames - 1, act))
            : act();
        const seen = [];
        performance.now = () => now;
        orders.send = () => -7;
        after(3, () => {
          orders.ask("stop");
          const began = player.frames;
          player.move(...player.newest);
          after(5, () => {
            seen.push(player.frames - began);
            performance.now = () => now + 501;  // a console that hangs stops no picture for long
            player.move(...player.newest);
            after(5, () => {
              seen.push(player.frames - began);
              delete performance.now;
              orders.send = send;
              orders.lost();
              done([...seen, document.querySelector("#answers li").textContent]);
            });
          });
        });
    """)
    assert waited[0] == 0 < waited[1]
    assert waited[2].startswith("stop: no answer, the connection was lost")


@needs_browser("the console in a browser")
def test_watched_robots_are_disabled_and_enabled(opened, plane):
    opened.execute_script("player.watch(8)")
    answer = press(opened, "disable")
    assert "disabled: 8" in answer
    until(opened, "return player.recording.plane.enabled[8] === 0")
    opened.find_element(By.CSS_SELECTOR, "[data-order=enable]").click()
    box = opened.find_element(By.ID, "robots")
    box.clear()
    box.send_keys("8 x")
    opened.find_element(By.ID, "confirm-yes").click()
    until(opened, "return document.querySelector('#answers li').textContent.includes('x is not')")
    opened.execute_script("player.watch(8)")
    assert "no robot is disabled" in press(opened, "enable")
    assert "refused" in press(opened, "enable")  # the robot is not on the list


@needs_browser("the console in a browser")
def test_the_plane_goes_on_without_the_console_and_the_page_with_the_next(opened, plane, console):
    opened.execute_script("player.orders.sent.set(0, {order: 'home', began: performance.now()})")
    console.kill()
    until(opened, "return !document.getElementById('problem').hidden")
    first = opened.find_element(By.CSS_SELECTOR, "#answers li")
    assert first.text.startswith("home: no answer, the connection was lost")
    assert "do not depend" in opened.find_element(By.ID, "problem").text
    opened.find_element(By.CSS_SELECTOR, "[data-order=stop]").click()
    until(opened, "return document.querySelector('#answers li')?.textContent.includes('not sent')")
    stamp = send_random_targets(plane, 2)
    plane.start(WAIT_S)
    plane.wait_for(lambda: plane.moving, WAIT_S, "motion")
    console.start()
    until(opened, "return player.isConnected && document.getElementById('problem').hidden")
    ended = plane.wait_for_outcome(stamp, WAIT_S)
    assert (ended.of(plane.plane.ids[plane.plane.enabled]).outcome == Outcome.REACHED).all()
    until(opened, "return player.recording.states.filter((state) => state === 1).length > 50")
    check_pixels(opened, plane.plane, newest_angles(plane))


@needs_browser("the console in a browser")
@pytest.mark.skipif(Axe is None, reason="NOT TESTED: accessibility: needs selenium-axe-python")
def test_a_checker_finds_no_fault_of_accessibility(opened):
    for theme in ("light", "dark"):
        if opened.execute_script("return document.documentElement.dataset.theme") != theme:
            opened.find_element(By.ID, "theme").click()
            drawn(opened)
        axe = Axe(opened)
        axe.inject()
        found = axe.run()["violations"]
        assert not [(each["id"], [n["html"][:120] for n in each["nodes"]]) for each in found]


def connect(console, origin, token=None):
    """Open a WebSocket as a page of an origin does; return its first message."""

    async def run():
        address = f"ws://127.0.0.1:{console.port}/live?token={token or console.token}"
        request = HTTPRequest(address, headers={"Origin": origin})
        socket = await websocket_connect(request)
        first = await socket.read_message()
        socket.close()
        return first

    return asyncio.run(run())


def test_only_pages_of_the_console_with_its_token_are_served(console):
    own = f"http://127.0.0.1:{console.port}"
    assert connect(console, own)
    for origin, token in (
        ("http://example.org", None),
        (f"http://127.0.0.1:{console.port + 1}", None),
        ("null", None),
        (own, "guessed"),
    ):
        with pytest.raises(HTTPClientError, match="403"):
            connect(console, origin, token)
    for path in ("/", "/plane.npz", "/plans/plan-1.0.html"):
        assert console.get(path)[0] == 403
        assert console.get(f"{path}?token=guessed")[0] == 403
        # a name of another site that was bound to this address
        assert console.get(f"{path}?token={console.token}", host="example.org")[0] == 403
    assert console.get(f"/?token={console.token}")[0] == 200
    assert console.get(f"/plans/plan-1.0.html?token={console.token}")[0] == 404
    assert (console.folder / "token").stat().st_mode & 0o077 == 0


def test_orders_that_make_no_sense_are_refused_with_a_reason(console, plane):
    async def ask(*messages):
        address = f"ws://127.0.0.1:{console.port}/live?token={console.token}"
        origin = {"Origin": f"http://127.0.0.1:{console.port}"}
        socket = await websocket_connect(HTTPRequest(address, headers=origin))
        answers = []
        for message in messages:
            await socket.write_message(message)
            while True:
                received = await socket.read_message()
                if isinstance(received, str) and '"answer"' in received:
                    answers.append(received)
                    break
        socket.close()
        return answers

    answers = asyncio.run(
        ask(
            '{"number": 1, "order": "explode"}',
            '{"number": 2, "order": "start"}',
            '{"number": 3, "order": "enable", "ids": ["a"]}',
            '{"number": 4, "order": "start", "plan": "1.000000001"}',
            "nonsense",
            '{"number": 5, "order": "stop"}',
        )
    )
    for answer, words in zip(
        answers, ("is no order", "needs the plan", "invalid literal", "bridge:", "Expecting value")
    ):
        assert '"ok": false' in answer and words in answer, answer
    assert '"ok": true' in answers[-1] and '"number": 5' in answers[-1]
