"""The page in a real browser: whole sessions by clicks and keys, as people have them."""

from __future__ import annotations

import importlib
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from importlib.resources import files
from pathlib import Path
from threading import Thread
from typing import Any, ClassVar

import numpy as np
import pytest
import rasterio

import termsel
from termsel.toolkit import charts
from termsel_app.iiif import parse_image_info
from termsel_app.quality import first_accuracy
from termsel_app.rasters import encode_png

REQUIRED = os.environ.get("TERMSEL_BROWSER") == "required"
"""Whether the browser was installed for these tests, so that none may skip."""
needed: Callable[[str], Any] = importlib.import_module if REQUIRED else pytest.importorskip
SWITCHES = ("--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run",
            "--disable-background-networking", "--disable-component-update", "--disable-sync",
            "--force-device-scale-factor=1", "--hide-scrollbars")
AXE = """
const [rules, done] = arguments;
axe.run(document, {resultTypes: ['violations'], ...rules && {runOnly: rules}})
    .then(found => done(found.violations
        .filter(rule => ['serious', 'critical'].includes(rule.impact))
        .map(rule => `${rule.id}: ${rule.nodes[0].html} ${rule.nodes[0].failureSummary}`)));"""
PREDICTED_PLACE_SHOWN = """
const {predicted, view} = window.termselPanes.map;
const [place] = predicted.getFeatures().map(feature => feature.getGeometry())
    .filter(geometry => geometry.getType() === 'Point').map(point => point.getCoordinates());
const [x, y] = view.getCenter();
return place && !view.getAnimating()
    && Math.hypot(place[0] - x, place[1] - y) < 3 * view.getResolution();"""
"""Whether the map has gone to where the second place of a point is predicted."""
KNOWN = ("willReadFrequently",)
"""What the console may say: a hint of Chromium's for the map library."""
SECONDS = 2.0
"""Within which a blunder is named after the click, on a machine that does nothing else."""


def patience() -> float:
    """Return by how much this machine is slower, as it does other work as well."""
    if not hasattr(os, "getloadavg"):
        return 5.0
    return max(1.0, os.getloadavg()[0] / (os.cpu_count() or 1))


class App:
    """A running `termsel app`."""

    started: ClassVar[list[subprocess.Popen[str]]] = []

    def __init__(self, *arguments: str, cwd: Path) -> None:
        self.process = subprocess.Popen(
            [sys.executable, "-m", "termsel", "app", *arguments, "--no-browser"], cwd=cwd,
            stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        App.started.append(self.process)
        assert self.process.stdout is not None
        line = self.process.stdout.readline()
        found = re.search(r"http://127\.0\.0\.1:\d+/[\w-]+/", line)
        if found is None:
            raise AssertionError(self.process.communicate())
        self.address = found[0]

    def end(self) -> str:
        """End it, and return what it said."""
        if self.process.poll() is None:
            self.process.send_signal(signal.SIGINT)
        return self.process.communicate(timeout=30)[1]


class Screen:
    """A page in the browser, and what a person does with it."""

    def __init__(self, driver: Any, address: str) -> None:
        self.driver = driver
        driver.get_log("browser")
        driver.get(address)
        self.wait(lambda: self.run("return document.documentElement.dataset.ready"))

    def run(self, script: str, *given: Any) -> Any:
        """Return what a script says."""
        return self.driver.execute_script(script, *given)

    def wait(self, found: Callable[[], Any], seconds: float = 180) -> Any:
        """Return what a function finds, within a time."""
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            if value := found():
                return value
            time.sleep(0.02)
        return pytest.fail(f"the page does not come to it within {seconds} s: "
                           f"{self.text('accuracy')} {self.text('alert')}")

    def text(self, name: str) -> str:
        """Return what an element shows."""
        return str(self.run("return document.getElementById(arguments[0]).innerText", name))

    def find(self, selector: str) -> Any:
        """Return elements."""
        return self.driver.find_elements("css selector", selector)

    def push(self, selector: str) -> None:
        """Click an element of the page."""
        self.run("document.querySelector(arguments[0]).click()", selector)

    def at(self, side: str, place: Any) -> tuple[Any, float, float]:
        """Return a pane, and where a place is in it from its middle [px of the screen]."""
        x, y = self.run("const pane = window.termselPanes[arguments[0]]; pane.map.renderSync();"
                        "return pane.map.getPixelFromCoordinate(arguments[1])", side,
                        [float(value) for value in place])
        pane = self.find(f"#{side} .ol-viewport")[0]
        return pane, x - pane.size["width"] / 2, y - pane.size["height"] / 2

    def click(self, side: str, place: Any, zoom: bool = True) -> None:
        """Click a place of a pane, by its coordinates there."""
        def aim() -> tuple[Any, float, float] | None:
            if zoom:  # as a person does who wants to hit it
                self.run("const {view} = window.termselPanes[arguments[0]];"
                         "view.cancelAnimations();"
                         "view.setCenter(arguments[1]); view.setResolution(arguments[2])", side,
                         [float(value) for value in place], 0.25 if side == "image" else 2.5)
            pane, x, y = self.at(side, place)
            # A prediction that arrives meanwhile moves the map on.
            is_inside = abs(x) < pane.size["width"] / 2 and abs(y) < pane.size["height"] / 2
            return (pane, x, y) if is_inside else None

        pane, x, y = self.wait(aim)
        self.actions().move_to_element_with_offset(pane, x, y).click().perform()

    def drag(self, side: str, start: Any, end: Any) -> None:
        """Drag what is at one place to another."""
        pane, x, y = self.at(side, start)
        _, to_x, to_y = self.at(side, end)
        self.actions().move_to_element_with_offset(pane, x, y).click_and_hold().move_by_offset(
            (to_x - x) / 2, (to_y - y) / 2).move_to_element_with_offset(
            pane, to_x, to_y).release().perform()

    def actions(self) -> Any:
        """Return actions of mouse and keys."""
        return importlib.import_module("selenium.webdriver").ActionChains(self.driver, duration=5)

    def keys(self, *keys: str) -> None:
        """Press keys."""
        self.actions().send_keys(*keys).perform()

    def records(self) -> dict[str, Any]:
        """Return the features as the page has them."""
        return {record["id"]: record for record in self.run("return window.termselState.records")}

    def count(self, number: int) -> None:
        """Wait until there are so many features."""
        self.wait(lambda: len(self.records()) == number)

    def measured(self, name: str) -> None:
        """Wait until a point has ground coordinates."""
        self.wait(lambda: self.records()[name]["ground"])

    def answered(self) -> None:
        """Wait until the last change is judged."""
        self.wait(lambda: self.run("const {asked, answered} = document.documentElement.dataset;"
                                   "return asked === answered"))

    def save(self, label: str) -> None:
        """Save what the button of a label saves."""
        self.push("#open-save")
        self.wait(lambda: "termsel run" in self.text("command"))
        self.run("[...document.querySelectorAll('#outputs button')]"
                 ".find(button => button.innerText === arguments[0]).click()", label)
        self.wait(lambda: self.text("save-said").startswith(("Saved:", "Error")))
        assert self.text("save-said").startswith("Saved:")
        self.run("document.getElementById('save').close()")

    def silent(self) -> None:
        """Refuse whatever else the console says."""
        assert [entry["message"] for entry in self.driver.get_log("browser")
                if not any(known in entry["message"] for known in KNOWN)] == []

    def show(self, theme: str, width: int, height: int = 800) -> None:
        """Give the screen a theme and a size."""
        self.driver.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": [
            {"name": "prefers-color-scheme", "value": theme},
            {"name": "prefers-reduced-motion", "value": "reduce"}]})
        self.driver.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", {
            "width": width, "height": height, "deviceScaleFactor": 1, "mobile": False})

    def accessible(self) -> None:
        """Refuse serious findings of axe-core."""
        needed("axe_core_python")
        self.run(files("axe_core_python").joinpath("axe.min.js").read_text("utf-8"))
        assert self.driver.execute_async_script(AXE, None) == []


@pytest.fixture(scope="module")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Any]:
    """Return headless Chromium, driven by its driver."""
    programs = [shutil.which(name) for name in ("chromium", "chromedriver")]
    if not all(programs):
        (pytest.fail if REQUIRED else pytest.skip)("chromium and chromedriver are not installed")
    webdriver = needed("selenium.webdriver")
    service = needed("selenium.webdriver.chrome.service")
    options = webdriver.ChromeOptions()
    options.binary_location = programs[0]
    for switch in (*SWITCHES, f"--user-data-dir={tmp_path_factory.mktemp('profile')}"):
        options.add_argument(switch)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
    driver = webdriver.Chrome(options=options, service=service.Service(programs[1]))
    driver.set_script_timeout(60)
    yield driver
    driver.quit()


@pytest.fixture(autouse=True, scope="module")
def ended() -> Iterator[None]:
    """End whatever a test that failed has left running."""
    yield
    for process in App.started:
        if process.poll() is None:
            process.kill()
            process.communicate()


@pytest.fixture(scope="module")
def example(example_files: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the files of the tutorial."""
    folder = tmp_path_factory.mktemp("example")
    shutil.copytree(example_files, folder / "files")
    return folder


def open_page(browser: Any, address: str, width: int = 1280) -> Screen:
    """Open a page on a light screen."""
    screen = Screen.__new__(Screen)
    screen.driver = browser
    screen.show("light", width)
    return Screen(browser, address)


def corners(example: Path, count: int) -> list[tuple[list[float], list[float]]]:
    """Return corners of the board: where they are in the pane of the image, and on the map."""
    from pyproj import Transformer

    points = termsel.read(example / "files" / "gcps.csv").points
    chosen = np.random.default_rng(1).choice(len(points), count, replace=False)
    turn = Transformer.from_crs(4326, 32639, always_xy=True)
    return [([float(sample), -float(line)], list(turn.transform(x, y)))
            for (line, sample), (x, y, _) in zip(points.image[chosen].tolist(),
                                                 points.ground[chosen].tolist(), strict=True)]


def test_a_whole_session_by_clicks(browser: Any, example: Path) -> None:
    files_of_scene = ("files/scene.tif", "--map", "files/ortho.tif", "--dem", "files/dem.tif",
                      "--out", "session")
    app = App(*files_of_scene, cwd=example)
    screen = open_page(browser, app.address)
    assert "Click a feature in the image" in screen.text("empty")
    assert screen.text("image-name") == "scene.tif, 600 × 500 px"
    places = corners(example, 12)
    for number, (image, ground) in enumerate(places, 1):
        wrong = number == 12
        if number > 3:
            # There is a model from now on. One that arrives while the map is on its way to where
            # the last one predicts the point moves that place, and not the map.
            screen.answered()
        screen.click("image", image)
        screen.count(number)
        if number > 3:
            screen.wait(lambda: screen.run(PREDICTED_PLACE_SHOWN))
        if number == 4:  # three points predict the fourth, with a ring around it
            _, ring = screen.wait(lambda: screen.run(
                "return window.termselPanes.map.predicted.getFeatures()"
                ".map(feature => feature.getGeometry().getExtent())"))
            assert ring[0] < ground[0] < ring[2]
            assert ring[1] < ground[1] < ring[3]
        if wrong:
            screen.answered()
            assert not screen.text("blunders"), screen.text("blunders")
            ground = [ground[0] + 240.0, ground[1] - 180.0]  # 30 px of 10 m
        begun = time.monotonic()
        screen.click("map", ground)
        name = f"P{number:02d}"
        screen.measured(name)
    screen.wait(lambda: screen.find("#blunders .card"))
    assert time.monotonic() - begun < SECONDS * patience()
    assert "P12 is off by" in screen.text("blunders")
    assert 25 < float(re.search(r"by ([\d.]+) px", screen.text("blunders"))[1]) < 35  # type: ignore[index]
    assert re.search(r"[\d.]+ px\s+≈ [\d.]+ m", screen.text("accuracy"))
    assert "90 % interval" in screen.text("accuracy")

    # Undo and redo by keys; left out by its button.
    keys = importlib.import_module("selenium.webdriver.common.keys").Keys
    screen.keys(keys.ESCAPE)
    screen.actions().key_down(keys.CONTROL).send_keys("z").key_up(keys.CONTROL).perform()
    screen.wait(lambda: screen.records()["P12"]["ground"] is None)
    screen.actions().key_down(keys.CONTROL).send_keys("y").key_up(keys.CONTROL).perform()
    screen.wait(lambda: screen.records()["P12"]["ground"])
    screen.wait(lambda: screen.find("#blunders .card"))
    screen.run("document.querySelectorAll('#blunders button')[1].click()")
    screen.wait(lambda: screen.records()["P12"]["role"] == "off")
    screen.wait(lambda: not screen.find("#blunders .card"))

    # The point is dragged to where it belongs, by the place that is shown of it.
    screen.push("#fit-map")
    before = screen.records()["P12"]["map"]
    screen.drag("map", before, places[11][1])
    screen.wait(lambda: screen.records()["P12"]["map"] != before)
    assert np.hypot(*np.subtract(screen.records()["P12"]["map"], places[11][1])) < 15

    # Keys move the point by a tenth of a pixel, and take it back into use.
    line = screen.records()["P12"]["image"][0]
    screen.actions().move_to_element(screen.find("#image .ol-viewport")[0]).perform()
    screen.keys(keys.ARROW_DOWN)
    screen.wait(lambda: abs(screen.records()["P12"]["image"][0] - line - 0.1) < 1e-9)
    screen.keys("o")
    screen.wait(lambda: screen.records()["P12"]["role"] == "")
    screen.answered()

    # Its role, and coordinates that are typed.
    screen.run("const role = document.getElementById('field-role'); role.value = 'independent';"
               "role.dispatchEvent(new Event('change'))")
    screen.wait(lambda: screen.records()["P12"]["role"] == "independent")
    screen.run("const field = document.getElementById('field-line'); field.value = '123.25';"
               "field.dispatchEvent(new Event('change'))")
    screen.wait(lambda: screen.records()["P12"]["image"][0] == 123.25)
    screen.push("#undo")
    screen.wait(lambda: screen.records()["P12"]["image"][0] != 123.25)

    # The page is loaded again, the program killed and started again: all is there.
    kept = screen.records()
    screen.driver.refresh()
    screen.wait(lambda: screen.run("return document.documentElement.dataset.ready"))
    assert screen.records() == kept
    screen.silent()
    app.process.kill()
    app.process.communicate()
    app = App(*files_of_scene, cwd=example)
    screen = open_page(browser, app.address)
    assert screen.records() == kept
    screen.answered()
    screen.wait(lambda: "One more point" in screen.text("next"))
    assert len(screen.find("#next li")) == 3

    # The points are saved; test_outputs.py compares the folder of a result, file by file.
    screen.save("Points (CSV)")
    saved = termsel.read(example / "session" / "points.csv").points
    assert saved.ids == tuple(kept)
    np.testing.assert_array_equal(saved.image, [record["image"] for record in kept.values()])
    screen.silent()
    assert "Traceback" not in app.end()


@pytest.fixture(scope="module")
def measured(browser: Any, example: Path) -> Iterator[Screen]:
    """Return a page with the points of the tutorial."""
    app = App("files/scene.tif", "--map", "files/ortho.tif", "--dem", "files/dem.tif", "--points",
              "files/gcps.csv", "--out", "measured", cwd=example)
    screen = open_page(browser, app.address)
    screen.answered()
    yield screen
    app.end()


@pytest.mark.slow
def test_the_page_is_usable_by_all(measured: Screen) -> None:
    measured.wait(lambda: measured.run("return window.termselState.answers.uncertainty"))
    measured.push("#rows tr")
    for box in ("#show-uncertainty", "#show-lines", "#show-warped", "#show-graticule"):
        measured.push(box)
    for theme in ("light", "dark"):
        measured.show(theme, 1024)
        time.sleep(0.5)
        assert measured.run("return document.documentElement.scrollWidth <= window.innerWidth")
        measured.accessible()
        for name in ("save", "paste", "help"):
            measured.push(f"#open-{name}")
            measured.accessible()
            measured.run("document.getElementById(arguments[0]).close()", name)
    measured.silent()


@pytest.mark.slow
def test_the_result_that_is_saved_has_the_figures_of_the_page(
        measured: Screen, example: Path) -> None:
    shown = measured.text("accuracy")
    measured.save("Result folder")
    result = termsel.read_result(example / "measured" / "result")
    figure = first_accuracy(result)
    assert figure is not None
    assert shown.split()[0] == charts.rounded_size_text(figure["px"][0])
    measured.silent()


@pytest.mark.slow
def test_five_hundred_points_leave_the_page_usable(browser: Any, tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    image = rng.uniform(0, 4000, (500, 2))
    x = 500000 + image[:, 1] * 2 + rng.normal(0, 1, 500)
    y = 5200000 - image[:, 0] * 2 + rng.normal(0, 1, 500)
    rows = [f"Q{i},,{line:.2f},{sample:.2f},{east:.2f},{north:.2f}," for i, ((line, sample), east,
            north) in enumerate(zip(image, x, y, strict=True))]
    (tmp_path / "points.csv").write_text(
        "# crs: EPSG:25832\nid,role,line,sample,x,y,z\n" + "\n".join(rows) + "\n")
    shape = {"driver": "GTiff", "count": 1, "height": 4000, "width": 4000, "dtype": "uint8"}
    with rasterio.open(tmp_path / "scan.tif", "w", tiled=True, sparse_ok=True, **shape):
        pass
    app = App("scan.tif", "--points", "points.csv", cwd=tmp_path)
    screen = open_page(browser, app.address)
    assert len(screen.find("#rows tr")) == 500
    screen.answered()
    begun = time.monotonic()
    screen.click("image", [2000.0, -2000.0])
    screen.wait(lambda: len(screen.records()) == 501)
    assert time.monotonic() - begun < 5 * patience()
    screen.silent()
    app.end()


@pytest.mark.slow
@pytest.mark.parametrize("side", [30_000, 100_000])
def test_an_image_of_any_size_is_shown(side: int, browser: Any, tmp_path: Path) -> None:
    shape = {"driver": "GTiff", "count": 1, "height": side, "width": side, "dtype": "uint8"}
    corner = side // 1024 * 512  # of a block in the middle, the only one that has pixels
    with rasterio.open(tmp_path / "large.tif", "w", tiled=True, blockxsize=512, blockysize=512,
                       sparse_ok=True, compress="deflate", **shape) as raster:
        raster.write(np.full((1, 512, 512), 200, dtype=np.uint8),
                     window=rasterio.windows.Window(corner, corner, 512, 512))
    begun = time.monotonic()
    app = App("large.tif", "--crs", "EPSG:25832", cwd=tmp_path)
    screen = open_page(browser, app.address)
    assert time.monotonic() - begun < 15 * patience()
    middle = corner + 240.0
    screen.run("const {view} = window.termselPanes.image; view.setCenter([arguments[0], "
               "-arguments[0]]); view.setResolution(2)", middle)
    bright = """
        const canvas = document.querySelector('#image canvas');
        const {width, height} = canvas;
        return canvas.getContext('2d').getImageData(width / 2, height / 2, 1, 1).data[0]"""
    screen.wait(lambda: screen.run(bright) == 200)
    screen.click("image", [middle, -middle])
    screen.wait(lambda: len(screen.records()) == 1)
    assert screen.records()["P01"]["image"] == pytest.approx([middle, middle], abs=1)
    screen.silent()
    app.end()


@pytest.mark.slow
def test_lines_are_control_and_snap_to_the_map(browser: Any, example: Path) -> None:
    from pyproj import Transformer

    vectors = example / "files" / "roads.geojson"
    app = App("files/scene.tif", "--map", "files/ortho.tif", "--map", str(vectors), "--out",
              "lines", cwd=example)
    screen = open_page(browser, app.address)
    turn = Transformer.from_crs(4326, 32639, always_xy=True)
    ends = [turn.transform(48.49484256497141, 34.80448358710258),
            turn.transform(48.49861729473041, 34.80420998094489)]
    screen.push("#tool-line")
    for place in ([100.0, -100.0], [200.0, -110.0]):
        screen.click("image", place)
        time.sleep(0.3)
    for x, y in ends:
        screen.click("map", [x + 8.0, y + 6.0])
        time.sleep(0.3)
    record = screen.wait(lambda: next((
        record for record in screen.records().values()
        if record["kind"] == "line" and len(record["map"] or []) == 2), None))
    assert np.hypot(*(np.array(record["map"]) - ends).T).max() < 0.01
    screen.silent()
    app.end()


@pytest.mark.slow
def test_of_many_lines_the_choice_of_owdis_is_shown(browser: Any, example: Path) -> None:
    lines = termsel.read(lines=example / "files" / "lines.csv")
    termsel.write_lines_csv(lines.lines.take(np.arange(12)), example / "twelve.csv", lines.crs)
    app = App("files/scene.tif", "--map", "files/ortho.tif", "--lines", "twelve.csv", "--out",
              "of-lines", cwd=example)
    screen = open_page(browser, app.address)
    chosen = screen.wait(lambda: screen.run(
        "return window.termselState.answers.lines?.chosen"))
    assert 3 < len(chosen) < 12
    assert f"OWDIS uses {len(chosen)} of 12 lines" in screen.text("model")
    rows = screen.text("rows")
    assert rows.count("line, not used by OWDIS") == 12 - len(chosen)
    assert rows.count("line, used by OWDIS") == len(chosen)
    for side in ("image", "map"):  # both panes draw it: dashed where it is not used
        unused = screen.run("return window.termselPanes[arguments[0]].control.getFeatures()"
                            ".filter(line => line.get('unused')).map(line => line.getId())", side)
        assert sorted([*unused, *chosen]) == sorted(screen.records())
    screen.silent()
    app.end()


@pytest.mark.slow
def test_hostile_names_appear_as_text(browser: Any, example: Path) -> None:
    name = "</td><img src=x onerror=document.title='run'>"
    app = App("files/scene.tif", "--map", "files/ortho.tif", "--out", "hostile", cwd=example)
    screen = open_page(browser, app.address)
    screen.push("#open-paste")
    screen.run("document.getElementById('pasted').value = arguments[0]",
               f"{name}\t270000\t3853000")
    screen.push("#do-paste")
    screen.wait(lambda: name in screen.records())
    screen.push("#rows tr")
    assert name in screen.text("rows")
    assert not screen.find("img")
    assert screen.driver.title != "run"
    screen.silent()
    app.end()


@pytest.mark.slow
def test_what_is_refused_is_said_and_nothing_is_lost(browser: Any, example: Path) -> None:
    app = App("files/scene.tif", "--map", "files/ortho.tif", "--out", "refused", cwd=example)
    screen = open_page(browser, app.address)
    screen.click("image", [100.0, -100.0])
    screen.wait(lambda: len(screen.records()) == 1)
    screen.run("const field = document.getElementById('field-line'); field.value = 'twelve';"
               "field.dispatchEvent(new Event('change'))")
    screen.wait(lambda: "no coordinate" in screen.text("alert"))
    assert screen.records()["P01"]["image"] == pytest.approx([100, 100], abs=0.5)
    app.end()
    screen.push("#undo")
    screen.wait(lambda: "does not answer" in screen.text("alert"))
    assert len(screen.records()) == 1


@contextmanager
def pictures(asked: list[str]) -> Iterator[str]:
    """Yield the address of a server of pictures, which keeps what is asked of it."""

    class Pictures(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            asked.append(self.path)
            info = self.path.endswith("/info.json")
            assert isinstance(self.server, ThreadingHTTPServer)
            place = f"http://127.0.0.1:{self.server.server_port}/iiif/map1"
            self.send_response(200)
            self.send_header("Content-Type", "application/json" if info else "image/png")
            self.end_headers()
            self.wfile.write(json.dumps({
                "@context": "http://iiif.io/api/image/2/context.json", "@id": place,
                "protocol": "http://iiif.io/api/image", "width": 2000, "height": 1000,
                "profile": ["http://iiif.io/api/image/2/level2.json"],
                "tiles": [{"width": 256, "scaleFactors": [1, 2, 4, 8]}]}).encode() if info
                else encode_png(np.full((256, 256, 4), 200, dtype=np.uint8)))

        def log_message(self, *_: Any) -> None:
            """Say nothing."""

    with ThreadingHTTPServer(("127.0.0.1", 0), Pictures) as server:
        Thread(target=server.serve_forever, daemon=True).start()
        yield f"http://127.0.0.1:{server.server_address[1]}"
        server.shutdown()


@pytest.mark.slow
def test_tiles_without_a_height_are_square() -> None:
    """As the Image API 3.0 has it in section 5.4; the page would draw lines at other places."""
    description = {"id": "https://images.example/map1", "width": 4000, "height": 3000,
                   "tiles": [{"width": 512, "scaleFactors": [1, 2]}, {"width": 256, "height": 128}]}
    image = parse_image_info(json.dumps(description).encode(), "info.json")
    assert [tile["height"] for tile in image.info["tiles"]] == [512, 128]


@pytest.mark.slow
def test_an_iiif_image_is_shown_where_servers_may_be_asked(browser: Any, example: Path) -> None:
    pytest.importorskip("termsel_iiif")
    asked: list[str] = []
    with pictures(asked) as address:
        name = f"{address}/iiif/map1/info.json"
        with pytest.raises(AssertionError, match="allow-remote"):
            App(name, "--map", "files/ortho.tif", cwd=example)
        assert not asked
        app = App(name, "--map", "files/ortho.tif", "--allow-remote", cwd=example)
        screen = open_page(browser, app.address)
        screen.wait(lambda: [path for path in asked if path.endswith("default.jpg")])
        screen.click("image", [1000.0, -500.0])
        screen.count(1)
        assert screen.records()["P01"]["image"] == pytest.approx([500, 1000], abs=0.5)
        screen.silent()
        app.end()


@pytest.mark.slow
def test_tiles_of_a_server_are_fetched_where_they_are_asked_for(
        browser: Any, example: Path) -> None:
    asked: list[str] = []

    with pictures(asked) as address:
        app = App("files/scene.tif", "--map", f"{address}/{{z}}/{{x}}/{{y}}.png", "--map",
                  "files/ortho.tif", "--out", "tiles", cwd=example)
        screen = open_page(browser, app.address)
        screen.wait(lambda: asked)
        assert address.removeprefix("http://") in screen.text("attribution")
        app.end()
        # The session that others open asks nobody.
        again = App("tiles", cwd=example)
        count = len(asked)
        screen = open_page(browser, again.address)
        time.sleep(1.0)
        assert len(asked) == count
        assert not screen.text("attribution")
        again.end()


@pytest.mark.slow
def test_a_folder_with_a_result_is_shown(browser: Any, example: Path) -> None:
    features = termsel.read(example / "files" / "gcps.csv", image=example / "files" / "scene.tif")
    termsel.run(features=features, out=example / "found")
    app = App("found", cwd=example)
    screen = open_page(browser, app.address)
    assert len(screen.records()) == len(features.points)
    screen.answered()
    assert "no image given" in screen.text("image-name")
    assert "px" in screen.text("accuracy")
    screen.silent()
    app.end()
