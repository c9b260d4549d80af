"""Pages in a real browser: drawn, silent, offline, linked, and safe whatever ids they show.

They are looked at on light and dark screens, narrow and wide ones, and by axe-core, which finds
what keeps people from using a page.
"""

from __future__ import annotations

import importlib
import json
import os
import shutil
import time
from collections.abc import Callable, Iterator
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import termsel

REQUIRED = os.environ.get("TERMSEL_BROWSER") == "required"
"""Whether the browser was installed for these tests, so that none may skip."""
needed: Callable[[str], Any] = importlib.import_module if REQUIRED else pytest.importorskip
needed("altair")
needed("vl_convert")

HOSTILE = ("</script><img src=x onerror=document.title='run'>", "{{7*7}} ${document.title='run'}",
           "\u0627\u0644\u0646\u0642\u0637\u0629 42", "a \"quoted\" & 'single' id", "x" * 200,
           "datum['id'] + toString.constructor('document.title=1')()", "<b>bold</b>")
SWITCHES = ("--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run",
            "--disable-background-networking", "--disable-component-update", "--disable-sync",
            "--force-device-scale-factor=1", "--hide-scrollbars")
LABELS = (Path(__file__).parents[1] / "labels.js").read_text(encoding="utf-8")
THINNED = """
document.querySelectorAll('details').forEach(one => one.open = true);
document.querySelectorAll('g.role-mark, g.role-axis-label, tbody').forEach(
    one => [...one.children].slice(3).forEach(child => child.remove()));"""
"""Leaves three of many marks and rows that are alike, as axe-core looks at each for long."""
AXE = """
const [rules, done] = arguments;
axe.run(document, {resultTypes: ['violations'], selectors: false, preload: false,
                   ...rules && {runOnly: rules}})
    .then(found => done(found.violations.filter(one => ['serious', 'critical'].includes(one.impact))
        .map(one => `${one.id}: ${one.nodes[0].html} ${one.nodes[0].failureSummary}`)));"""


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
    options.set_capability("goog:loggingPrefs", {"browser": "ALL", "performance": "ALL"})
    driver = webdriver.Chrome(options=options, service=service.Service(programs[1]))
    driver.get("about:blank")
    yield driver
    driver.quit()


@pytest.fixture(scope="module")
def opened(browser: Any) -> Callable[[Path, int], Any]:
    """Return a function that opens a page, waits until it is drawn, and refuses any complaint."""

    def open_page(page: Path, width: int = 1400) -> Any:
        for log in ("browser", "performance"):
            browser.get_log(log)
        show(browser, "light", width)
        browser.get(page.as_uri())
        wait(lambda: browser.execute_script("return document.documentElement.dataset.drawn"))
        asked = [message["params"]["request"]["url"] for message in (
            json.loads(entry["message"])["message"] for entry in browser.get_log("performance"))
            if message["method"] == "Network.requestWillBeSent"]
        assert [url for url in asked if not url.startswith(("data:", "chrome"))] == [page.as_uri()]
        silent(browser)
        return browser

    return open_page


def show(browser: Any, theme: str, width: int) -> None:
    """Give the screen a theme and a width."""
    browser.execute_cdp_cmd("Emulation.setEmulatedMedia", {
        "features": [{"name": "prefers-color-scheme", "value": theme}]})
    browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", {
        "width": width, "height": 900, "deviceScaleFactor": 1, "mobile": False})


def fits(browser: Any) -> None:
    """Wait until nothing is wider than the screen."""
    wait(lambda: browser.execute_script(
        "return document.documentElement.scrollWidth <= window.innerWidth && "
        "[...document.querySelectorAll('.chart svg')].every("
        "svg => svg.getBoundingClientRect().right <= window.innerWidth) && "
        # Folded tables too: what lies beyond a narrow screen is not seen.
        "[...document.querySelectorAll('.scroll')].every("
        "table => table.scrollWidth <= table.clientWidth)"))


def labelled(browser: Any, width: int) -> None:
    """Wait until all labels of charts are legible on a screen of a width, light or dark."""
    for theme in ("dark", "light"):
        show(browser, theme, width)
        ground = browser.execute_script("return getComputedStyle(document.body).backgroundColor")
        assert (ground == "rgb(255, 255, 255)") == (theme == "light")
        fits(browser)
        end = time.monotonic() + 20  # charts follow the width of the screen
        while (wrong := browser.execute_script(LABELS)) and time.monotonic() < end:
            time.sleep(0.05)
        assert wrong == []


def accessible(browser: Any) -> None:
    """Refuse a serious finding of axe-core, on light and dark screens; the page is used up."""
    needed("axe_core_python")
    browser.execute_script(THINNED)
    browser.execute_script(files("axe_core_python").joinpath("axe.min.js").read_text("utf-8"))
    assert browser.execute_async_script(AXE, None) == []
    show(browser, "dark", 400)
    assert browser.execute_async_script(AXE, ["color-contrast"]) == []


def silent(browser: Any) -> None:
    """Refuse whatever the console says."""
    assert [entry["message"] for entry in browser.get_log("browser")] == []


def wait(found: Callable[[], Any]) -> Any:
    """Return what a function finds, within a minute."""
    end = time.monotonic() + 60
    while time.monotonic() < end:
        if value := found():
            return value
        time.sleep(0.05)
    return pytest.fail("the page does not come to it within a minute")


def rings(browser: Any, chart: str) -> int:
    """Return how many features of a map have the ring of the choice."""
    return len(browser.find_elements("css selector", f"#{chart} svg path[stroke-width='2.6']"))


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Path]:
    """Return a function that makes the page of a kind of result, once."""
    folder = tmp_path_factory.mktemp("pages")
    results: dict[str, Callable[[], termsel.Result]] = {
        "front": lambda: termsel.run("rfm-terms", solver="nsga2", evaluations=2000),
        "lines": lambda: termsel.run("owdis-lines", solver="ica", evaluations=2000),
        "auto": lambda: termsel.run("poly-terms"),
        "hostile": lambda: termsel.run("poly-terms", features=hostile())}

    @cache
    def made(kind: str) -> Path:
        results[kind]().report(folder / f"{kind}.html")
        return folder / f"{kind}.html"

    return made


def hostile() -> termsel.FeatureSet:
    """Return points without heights, with ids that a page could take for something else."""
    features = termsel.simulate_scene("ikonos-hamedan", n_lines=0)
    points = features.points
    image, ground = points.image.copy(), points.ground.copy()
    ground[:, 2] = np.nan
    image[:len(HOSTILE)] += 30.0  # so that they are among the worst, which the charts name
    return features.with_(points=termsel.Points(
        (*HOSTILE, *points.ids[len(HOSTILE):]), image, ground, points.sigma, points.roles))


@pytest.mark.slow
def test_the_page_of_a_study_is_drawn_offline_and_in_silence(
        opened: Callable[[Path, int], Any], tmp_path: Path) -> None:
    from termsel.studies.outputs import write_outputs

    title = f"{HOSTILE[0]} {HOSTILE[1]} {HOSTILE[2]} {'x' * 10_000}"  # ids end at 200
    features = termsel.simulate_scene("ikonos-hamedan", n_lines=0)
    study = termsel.compare(problems=["poly-terms"], solvers=["random", "swap"], seeds=2,
                            data={HOSTILE[0]: features, " ".join(HOSTILE[1:4]): features},
                            options={"degree": 2}, budget={"evaluations": 200}, title=title)
    write_outputs(study, tmp_path)
    for width in (400, 1400):
        browser = opened(tmp_path / "report.html", width)
        assert browser.find_element("css selector", "h1").text == study.spec.title
        assert browser.title == " ".join(title.split())
        assert not browser.find_elements("css selector", "img, iframe, object")
        labelled(browser, width)
        said = browser.find_element("id", "convergence").text
        assert HOSTILE[0] in said
        for name in ("ecdf-evaluations", "ecdf-cpu-seconds", "convergence"):
            assert browser.find_elements("css selector",
                                         f"#{name} svg .mark-line.role-mark path"), name
    accessible(browser)


@pytest.mark.slow_cases("front", "hostile", "lines")
@pytest.mark.parametrize("kind", ["front", "lines", "auto", "hostile"])
def test_a_page_is_drawn_offline_in_silence_and_for_all(
        opened: Callable[[Path, int], Any], page: Callable[[str], Path], kind: str) -> None:
    browser = opened(page(kind), 400)
    charts = browser.find_elements("css selector", ".chart")
    assert int(browser.execute_script("return document.documentElement.dataset.drawn")) \
        == len(charts) >= 5
    browser.execute_script("document.querySelectorAll('details').forEach(d => d.open = true)")
    for width in (400, 1280):
        labelled(browser, width)
        for chart in charts:
            marks = chart.find_elements(
                "css selector", "svg .mark-symbol.role-mark path, svg .mark-rect.role-mark path")
            curves = chart.find_elements("css selector", "svg .mark-line.role-mark path")
            areas = chart.find_elements("css selector", "svg .mark-area.role-mark path")
            assert len(marks) > 3 or len(curves) == 2 or len(areas) > 3, \
                chart.get_attribute("data-chart")
    silent(browser)
    if kind != "hostile":
        accessible(browser)


@pytest.mark.slow
def test_hostile_ids_appear_as_text_and_run_nothing(
        opened: Callable[..., Any], page: Callable[[str], Path]) -> None:
    browser = opened(page("hostile"))
    title = browser.title
    browser.execute_script("document.querySelectorAll('details').forEach(d => d.open = true)")
    shown = [button.text for button in browser.find_elements(
        "css selector", "table[data-choice=picked] button")]
    assert {" ".join(name.split()) for name in HOSTILE} <= set(shown)
    for button in browser.find_elements("css selector", "table[data-choice=picked] button")[:8]:
        browser.execute_script("arguments[0].click()", button)
        wait(lambda: rings(browser, "residuals") == 1)
    assert browser.title == title != "run"
    assert not browser.find_elements("css selector", "img, b, iframe, object")
    silent(browser)


@pytest.mark.slow
def test_charts_of_a_notebook_are_live_without_a_connection(
        browser: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import altair

    from termsel.results import notebook

    monkeypatch.setattr(notebook, "_sent", False)
    plot = termsel.run("poly-terms", features=hostile()).plot
    assert altair.renderers.active == "default"
    charts = [plot.worst(), plot.residuals().properties(background="#fafafa")]
    outputs = [chart._repr_mimebundle_()["text/html"] for chart in charts]
    assert isinstance(charts[1], altair.LayerChart)
    assert len(outputs[1]) < 400_000 < len(outputs[0])  # the library comes once
    for name, shown, live in (("live", outputs, 2), ("alone", outputs[1:], 0)):
        page = tmp_path / f"{name}.html"
        page.write_text("<!DOCTYPE html><meta charset='utf-8'><title>notebook</title>"
                        "<link rel='icon' href='data:,'>" + "".join(shown))
        for log in ("browser", "performance"):
            browser.get_log(log)
        browser.get(page.as_uri())
        wait(lambda live=live: len(browser.find_elements(
            "css selector", "svg .mark-symbol.role-mark")) >= live)
        assert len(browser.find_elements("css selector", "input[type=range]")) == live
        # Without the library the picture stays.
        assert len(browser.find_elements("css selector", "img[src^='data:image/svg']")) \
            == len(shown) - live
        asked = [message["params"]["request"]["url"] for message in (
            json.loads(entry["message"])["message"] for entry in browser.get_log("performance"))
            if message["method"] == "Network.requestWillBeSent"]
        assert [url for url in asked if not url.startswith(("data:", "chrome"))] == [
            page.as_uri()]
        assert browser.title == "notebook"
        silent(browser)


def test_a_tooltip_shows_a_hostile_id_as_text(
        opened: Callable[..., Any], page: Callable[[str], Path]) -> None:
    browser = opened(page("hostile"))
    from selenium.webdriver import ActionChains

    bar = browser.find_element("css selector", "#worst .mark-rect path[aria-label*='onerror']")
    browser.execute_script("arguments[0].scrollIntoView({block: 'center'})", bar)
    ActionChains(browser).move_to_element(bar).perform()
    tip = wait(lambda: browser.find_elements("css selector", "#vg-tooltip-element.visible"))[0]
    assert HOSTILE[0] in tip.text
    assert not tip.find_elements("css selector", "img, b")
    silent(browser)


def test_a_point_chosen_in_one_chart_is_seen_in_the_others(
        opened: Callable[..., Any], page: Callable[[str], Path]) -> None:
    browser = opened(page("lines"))
    assert rings(browser, "residuals") == rings(browser, "ground") == 0
    bar = browser.find_element("css selector", "#worst .mark-rect path")
    browser.execute_script("arguments[0].scrollIntoView({block: 'center'})", bar)
    bar.click()
    wait(lambda: rings(browser, "residuals") == rings(browser, "ground") == 2)  # both vertices
    row = browser.find_element("css selector", "table[data-choice=picked] tr.chosen")
    name = row.find_element("css selector", "button").get_attribute("textContent")
    assert bar.get_attribute("aria-label") is None or name in bar.get_attribute("aria-label")
    assert browser.find_element("id", "chosen").text.startswith(name)
    # And back: the row chosen again is let go.
    browser.execute_script("arguments[0].querySelector('button').click()", row)
    wait(lambda: rings(browser, "residuals") == 0)
    assert not browser.find_element("id", "chosen").text


@pytest.mark.slow
def test_a_point_on_the_map_can_be_chosen(
        opened: Callable[..., Any], page: Callable[[str], Path]) -> None:
    browser = opened(page("auto"))
    symbol = browser.find_elements(
        "css selector", "#residuals path[aria-label*='residual'][aria-label*='independent']")[0]
    browser.execute_script("arguments[0].scrollIntoView({block: 'center'})", symbol)
    symbol.click()
    wait(lambda: rings(browser, "residuals") == rings(browser, "ground") == 1)
    chosen = browser.find_element("css selector", "table[data-choice=picked] tr.chosen")
    assert "independent" in chosen.get_attribute("textContent")


@pytest.mark.slow
def test_a_baseline_is_chosen_in_chart_and_table(
        opened: Callable[..., Any], page: Callable[[str], Path]) -> None:
    browser = opened(page("auto"))
    large = "return [...document.querySelectorAll('#baselines .mark-symbol path')]" \
            ".filter(p => p.getBBox().width > 11 && p.getBBox().height > 9).length"
    before = browser.execute_script(large)
    button = next(one for one in browser.find_elements(
        "css selector", "table[data-choice=fit] button") if one.text == "cubic *")
    button.click()
    wait(lambda: browser.execute_script(large) == before + 2)
    assert browser.find_element("id", "chosen").text.startswith("cubic *; terms 40; control")
    symbol = browser.find_elements("css selector", "#baselines .mark-symbol path")[0]
    browser.execute_script("arguments[0].scrollIntoView({block: 'center'})", symbol)
    symbol.click()
    wait(lambda: browser.find_element("id", "chosen").text.startswith("this result"))


@pytest.mark.slow
def test_the_page_of_many_images_is_drawn_offline_and_in_silence(
        opened: Callable[[Path, int], Any], tmp_path: Path) -> None:
    from termsel.studies.outputs import write_outputs

    points = termsel.simulate_scene("ikonos-hamedan", n_lines=0).points
    some = termsel.Points(points.ids[:9], points.image[:9], points.ground[:9])
    study = termsel.compare(out=tmp_path, data={
        f"{HOSTILE[0]} {i}": termsel.FeatureSet(some, crs="EPSG:4979") for i in range(2)})
    write_outputs(study, tmp_path)
    for width in (400, 1400):
        browser = opened(tmp_path / "report.html", width)
        assert len(browser.find_elements("css selector", "td.picture svg path")) >= 4
        assert HOSTILE[0] in browser.find_element("css selector", "tbody th").text
        assert not browser.find_elements("css selector", "img, iframe, object")
        fits(browser)
    accessible(browser)


@pytest.mark.slow
def test_a_member_of_the_front_shows_its_residuals_and_terms(
        opened: Callable[..., Any], page: Callable[[str], Path]) -> None:
    browser = opened(page("front"))
    rows = browser.find_elements("css selector", "table[data-choice=member] tbody tr")
    assert [row for row in rows if "chosen" in row.get_attribute("class")]  # the recommended one
    arrows = "return [...document.querySelectorAll('#members .mark-rule line')]" \
             ".map(l => l.getAttribute('x2') + l.getAttribute('transform')).join()"
    before = browser.execute_script(arrows)
    other = next(row for row in rows if "chosen" not in row.get_attribute("class"))
    other.find_element("css selector", "button").click()
    wait(lambda: browser.execute_script(arrows) != before)
    assert "chosen" in other.get_attribute("class")
    point = browser.find_elements(
        "css selector", "#front .role-mark path[aria-label*='points:']")[-1]
    browser.execute_script("arguments[0].scrollIntoView({block: 'center'})", point)
    point.click()
    wait(lambda: "chosen" not in other.get_attribute("class"))
    shown = browser.find_element("css selector", "table[data-choice=member] tr.chosen")
    assert ".num:" in shown.text
    silent(browser)


@pytest.mark.slow
def test_arrows_lengthen_with_the_slider(
        opened: Callable[..., Any], page: Callable[[str], Path]) -> None:
    browser = opened(page("auto"))
    length = "return [...document.querySelectorAll('#residuals .mark-rule line')]" \
             ".reduce((sum, l) => sum + Math.abs(l.x2.baseVal.value), 0)"
    before = browser.execute_script(length)
    browser.execute_script(
        "const s = document.querySelector('#residuals input[type=range]');"
        "s.value = 2 * s.value; s.dispatchEvent(new Event('input'));")
    wait(lambda: browser.execute_script(length) > 1.5 * before)
