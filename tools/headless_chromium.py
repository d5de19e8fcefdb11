# SPDX-License-Identifier: Apache-2.0
"""A headless Chromium for scripts that take pictures and measure pages."""

import os
import shutil
from pathlib import Path

from selenium import webdriver

__all__ = ["FLAGS", "clean_environment", "start_chromium"]

FLAGS = (
    "--headless --no-sandbox --disable-gpu --disable-quic --no-first-run --hide-scrollbars "
    "--disable-background-networking --disable-component-update --disable-sync"
).split()


def clean_environment() -> dict[str, str]:
    """Return the environment without the libraries of the ROS wheels."""
    return {name: value for name, value in os.environ.items() if not name.startswith("LD_")}


def start_chromium(profile: Path, size: tuple[int, int]) -> webdriver.Chrome:
    """Start a browser; the caller ends it with `quit`.

    Args:
        profile: folder of its profile.
        size: width and height of its window [pixels]; one narrower than 600 is that of a phone.
    """
    options = webdriver.ChromeOptions()
    options.binary_location = shutil.which("chromium") or "chromium"
    for flag in (*FLAGS, f"--user-data-dir={profile}"):
        options.add_argument(flag)
    service = webdriver.ChromeService(shutil.which("chromedriver"), env=clean_environment())
    driver = webdriver.Chrome(options, service)
    width, height = size
    metrics = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": width < 600}
    driver.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", metrics)
    return driver
