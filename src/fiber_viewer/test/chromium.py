# SPDX-License-Identifier: Apache-2.0
"""A headless Chromium, driven by selenium, and what tests of pages do with it."""

import io
import os
import shutil

import matplotlib.image
import numpy as np
import pytest

try:
    from selenium import webdriver
    from selenium.webdriver.common.by import By
    from selenium.webdriver.common.keys import Keys
    from selenium.webdriver.support.ui import WebDriverWait
except ImportError:
    webdriver = By = Keys = None

BROWSER, DRIVER = shutil.which("chromium"), shutil.which("chromedriver")
FLAGS = (
    "--headless --no-sandbox --disable-gpu --disable-quic --no-first-run --hide-scrollbars "
    "--disable-background-networking --disable-component-update --disable-sync"
).split()
WAIT_S = 20


def needs_browser(what):
    """Return the mark that skips tests, loudly, where there is no browser."""
    return pytest.mark.skipif(
        not (BROWSER and DRIVER and webdriver),
        reason=f"NOT TESTED: {what}: needs chromium, chromedriver and selenium",
    )


def start_browser(profile):
    """Return a browser with a profile of its own, 1440 x 1000."""
    options = webdriver.ChromeOptions()
    options.binary_location = BROWSER
    for flag in (*FLAGS, f"--user-data-dir={profile}"):
        options.add_argument(flag)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL", "performance": "ALL"})
    # without the libraries of the ROS wheels
    clean = {name: value for name, value in os.environ.items() if not name.startswith("LD_")}
    driver = webdriver.Chrome(options, webdriver.ChromeService(DRIVER, env=clean))
    size(driver, 1440, 1000)
    return driver


def size(driver, width, height):
    metrics = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": width < 600}
    driver.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", metrics)


def open_at(browser, page, address):
    browser.get("about:blank")
    browser.get(page.as_uri() + address)
    until(browser, "return Boolean(globalThis.player?.angles) && !player.waiting")


def until(browser, condition):
    WebDriverWait(browser, WAIT_S, poll_frequency=0.02).until(
        lambda driver: driver.execute_script(condition)
    )


def drawn(browser):
    """Wait until all requested frames are on the canvases."""
    browser.execute_async_script(
        "const done = arguments[0];"
        "requestAnimationFrame(() => requestAnimationFrame(() => setTimeout(done)));"
    )


def picture(browser, canvas) -> np.ndarray:
    """Return the picture on a canvas, shape (height, width, 4), 0..1."""
    drawn(browser)
    png = browser.find_element(By.ID, canvas).screenshot_as_png
    return matplotlib.image.imread(io.BytesIO(png))


def color(browser, name) -> np.ndarray:
    text = browser.execute_script(
        "return getComputedStyle(document.documentElement).getPropertyValue(arguments[0])",
        f"--{name}",
    ).strip()
    return np.array([int(text[i : i + 2], 16) for i in (1, 3, 5)]) / 255
