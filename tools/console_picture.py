#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Take docs/images/console.png: the console of a simulated plane, in the middle of a motion.

It runs the command `live`, sends random targets, starts the plan with the button of the page, and
prints the pictures that the page drew each second while robots moved. `make screenshots` runs it.
"""

import argparse
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from headless_chromium import start_chromium
from PIL import Image
from selenium import webdriver
from selenium.webdriver.common.by import By
from selenium.webdriver.support.ui import WebDriverWait

from fiber_bringup.processes import installed
from fiber_client.client import PlaneClient
from fiber_core.fields import random_field
from fiber_node.ros_environment import own_domain, use_loopback

_WAIT_S = 300.0
_SIZE = 1440, 1000


def main() -> int:
    """Take the picture; returns the exit code."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--robots", type=int, default=5000)
    parser.add_argument("-o", "--out", type=Path, default=Path("docs/images/console.png"))
    args = parser.parse_args()
    use_loopback()
    os.environ["ROS_DOMAIN_ID"] = str(own_domain())
    with tempfile.TemporaryDirectory() as folder:
        command = [str(installed("fiber_bringup", "live")), f"--robots={args.robots}", "--port=0"]
        live = subprocess.Popen(
            [*command, f"--out={folder}/live"], stdout=subprocess.PIPE, text=True
        )
        browser = None
        try:
            assert live.stdout is not None
            address = next(line for line in live.stdout if line.startswith("console: "))
            browser = start_chromium(Path(folder) / "profile", _SIZE)
            browser.get(address.removeprefix("console: ").strip())
            with PlaneClient() as client:
                _take(browser, client, args.out)
        finally:
            if browser is not None:
                browser.quit()
            live.terminate()
            live.wait()
    return 0


def _take(browser: webdriver.Chrome, client: PlaneClient, out: Path) -> None:
    client.wait_for_graph(_WAIT_S)
    problem = random_field(client.plane, np.random.default_rng(1), start=client.angles).problem
    stamp = client.send_targets(client.plane.ids[problem.asked], problem.targets[problem.asked])
    client.wait_until_ready(stamp, _WAIT_S)
    _until(browser, f"return player.ready === '{stamp}' && player.frames > 0")
    browser.execute_script("player.watch(arguments[0])", client.plane.n // 3)
    browser.find_element(By.CSS_SELECTOR, "[data-order=start]").click()
    browser.find_element(By.ID, "confirm-yes").click()
    moving = "player.recording.states.filter((state) => state === 0).length"
    _until(browser, f"return {moving} > 0.8 * player.recording.plane.n")
    begin, before = time.monotonic(), browser.execute_script("return player.frames")
    time.sleep(0.5)  # into the motion
    browser.save_screenshot(str(out))
    drawn = browser.execute_script("return player.frames") - before
    print(f"{drawn / (time.monotonic() - begin):.0f} pictures a second while robots move")
    picture = Image.open(out).convert("RGB")
    picture.quantize(256, Image.Quantize.MAXCOVERAGE).save(out)
    print(out)


def _until(browser: webdriver.Chrome, condition: str) -> None:
    WebDriverWait(browser, _WAIT_S, poll_frequency=0.02).until(
        lambda driver: driver.execute_script(condition)
    )


if __name__ == "__main__":
    sys.exit(main())
