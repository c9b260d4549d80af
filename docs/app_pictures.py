"""Draw the pictures of the pages on `termsel app` from the real page.

    python docs/app_pictures.py

Needs chromium, chromedriver and selenium. The points are those of the example's file, one of them
30 px off.
"""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
from selenium import webdriver
from selenium.webdriver.chrome.service import Service

import termsel
from termsel.toolkit.files import write_example

STATIC = Path(__file__).parent / "_static"
POINTS, WRONG = 12, 5
SWITCHES = ("--headless", "--no-sandbox", "--disable-gpu", "--hide-scrollbars",
            "--force-device-scale-factor=1")


def main() -> None:
    """Write app.png and app-warped.png."""
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder, "termsel-example")
        place.mkdir()
        write_example(place / "files")
        write_control(place / "files" / "gcps.csv", place / "some.csv")
        app = subprocess.Popen(
            [sys.executable, "-m", "termsel", "app", "files/scene.tif", "--map", "files/ortho.tif",
             "--dem", "files/dem.tif", "--points", "some.csv", "--out", "session", "--no-browser"],
            cwd=place, stdout=subprocess.PIPE, text=True)
        try:
            assert app.stdout is not None
            address = re.findall(r"http://\S+", app.stdout.readline())[0]
            draw(address)
        finally:
            app.terminate()
            app.wait()


def write_control(source: Path, target: Path) -> None:
    """Write some points of the example, one of them wrong, with names as the page gives them."""
    points = termsel.read(source).points
    chosen = np.random.default_rng(1).choice(len(points), POINTS, replace=False)
    image = points.image[chosen].copy()
    image[WRONG] += [20.0, -22.0]
    names = tuple(f"P{number:02d}" for number in range(1, POINTS + 1))
    termsel.write_points_csv(termsel.Points(names, image, points.ground[chosen]), target,
                             "EPSG:4979")


def draw(address: str) -> None:
    """Save the pictures of a page."""
    options = webdriver.ChromeOptions()
    for switch in SWITCHES:
        options.add_argument(switch)
    browser = webdriver.Chrome(options=options, service=Service(shutil.which("chromedriver")))
    browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", {
        "width": 1280, "height": 760, "deviceScaleFactor": 1, "mobile": False})
    browser.get(address)
    wait(browser, "return window.termselState.answers.uncertainty")
    time.sleep(2.0)  # tiles
    browser.save_screenshot(str(STATIC / "app.png"))
    browser.execute_script("""
        for (const id of ['show-warped', 'show-uncertainty']) document.getElementById(id).click();
        for (const [id, value] of [['swipe', 55], ['opacity', 100]]) {
          const input = document.getElementById(id);
          input.value = value;
          input.dispatchEvent(new Event('input'));
        }""")
    time.sleep(3.0)
    browser.save_screenshot(str(STATIC / "app-warped.png"))
    browser.quit()


def wait(browser: Any, script: str) -> None:
    """Wait until a script returns something."""
    while not browser.execute_script(script):
        time.sleep(0.1)


if __name__ == "__main__":
    main()
