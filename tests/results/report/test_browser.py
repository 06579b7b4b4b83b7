"""The page in a real browser, without a network: it loads, slides, sorts and answers."""

import shutil

import numpy as np
import pytest

from geoevs import layout
from geoevs.protocol.reference import References
from geoevs.protocol.targets import read_targets

selenium = pytest.importorskip("selenium", reason="install selenium to test the page in a browser")

from selenium import webdriver  # noqa: E402
from selenium.webdriver.common.by import By  # noqa: E402
from selenium.webdriver.common.keys import Keys  # noqa: E402
from selenium.webdriver.support.ui import Select, WebDriverWait  # noqa: E402

SECONDS = 30


@pytest.fixture(scope="module")
def browser():
    """Headless Chromium that reaches no host."""
    driver, chromium = shutil.which("chromedriver"), shutil.which("chromium")
    if not (driver and chromium):
        pytest.skip("install chromium and chromium-driver to test the page in a browser")
    options = webdriver.ChromeOptions()
    options.binary_location = chromium
    for argument in (
        *("--headless=new", "--no-sandbox", "--disable-dev-shm-usage", "--disable-gpu"),
        *("--window-size=1200,900", "--host-resolver-rules=MAP * ~NOTFOUND"),
    ):
        options.add_argument(argument)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL", "performance": "ALL"})
    started = webdriver.Chrome(options=options, service=webdriver.ChromeService(driver))
    yield started
    started.quit()


@pytest.fixture
def page(browser, reported):
    """The page, loaded anew, with its pictures drawn."""
    browser.get(reported[1].as_uri())
    wait(browser, lambda: browser.find_element(By.ID, "caption").text)
    return browser


def wait(browser, condition):
    return WebDriverWait(browser, SECONDS).until(lambda _: condition())


def canvas(browser, name):
    return browser.execute_script(f"return document.getElementById('{name}').toDataURL()")


def scroll(browser, element):
    browser.execute_script("arguments[0].scrollIntoView({block: 'center'})", element)


def choose(browser, name, value):
    Select(browser.find_element(By.NAME, name)).select_by_value(value)


def test_it_loads_without_network_or_error(page):
    page.execute_script("document.querySelectorAll('details').forEach((d) => { d.open = true })")
    scroll(page, page.find_element(By.CSS_SELECTOR, ".chart"))
    wait(page, lambda: page.find_elements(By.CSS_SELECTOR, ".chart svg"))
    requests = [
        line["message"]
        for line in page.get_log("performance")
        if '"Network.requestWillBeSent"' in line["message"]
    ]
    assert requests
    assert not any('"url":"http' in request for request in requests)
    assert [line for line in page.get_log("browser") if line["level"] == "SEVERE"] == []


def test_the_slider_moves_by_keyboard_and_pointer(page):
    slider = page.find_element(By.ID, "slider")

    def exposure():
        return page.execute_script("return arguments[0].value", slider)

    assert exposure() == pytest.approx(50)
    scroll(page, slider)
    page.execute_script("arguments[0].focus()", slider)
    held = webdriver.ActionChains(page).key_down(Keys.ARROW_RIGHT).pause(0.5)
    held.key_up(Keys.ARROW_RIGHT).perform()
    wait(page, lambda: exposure() > 50)
    moved = webdriver.ActionChains(page).move_to_element_with_offset(slider, -200, 0)
    moved.click().perform()
    wait(page, lambda: exposure() < 45)


def test_a_table_sorts_by_a_click_and_by_enter(page):
    head = "#tables th:nth-child({})"
    names = [cell.text for cell in page.find_elements(By.CSS_SELECTOR, "#tables thead th")]
    position = names.index("sparse psnr") + 1

    def column():
        cells = page.find_elements(By.CSS_SELECTOR, f"#tables td:nth-child({position})")
        return [float(value) for cell in cells if (value := cell.get_attribute("data-sort"))]

    header = page.find_element(By.CSS_SELECTOR, head.format(position))
    header.click()
    wait(page, lambda: column() == sorted(column(), reverse=True))
    assert header.get_attribute("aria-sort") == "descending"
    header.send_keys(Keys.ENTER)
    wait(page, lambda: column() == sorted(column()))


def test_a_chart_shows_its_tooltip(page):
    scroll(page, page.find_element(By.CSS_SELECTOR, ".chart"))
    mark = ".chart svg path[aria-label*='entrant: Geo-EVS']"
    point = wait(page, lambda: page.find_elements(By.CSS_SELECTOR, mark))[0]
    scroll(page, point)
    webdriver.ActionChains(page).move_to_element(point).perform()
    shown = wait(page, lambda: page.find_element(By.ID, "vg-tooltip-element").text)
    assert "Geo-EVS" in shown
    assert "22.5" in shown


def test_pictures_errors_and_validity_are_drawn(page):
    choose(page, "left", "sparse reference")
    choose(page, "right", "grey")
    wait(page, lambda: "Right: grey (sparse_psnr 9 dB, psnr 9 dB)" in caption(page))
    plain = canvas(page, "second")
    assert plain != canvas(page, "first")
    page.find_element(By.NAME, "error").click()
    errors = wait(page, lambda: (now := canvas(page, "second")) != plain and now)
    page.find_element(By.NAME, "error").click()
    page.find_element(By.NAME, "overlay").click()
    wait(page, lambda: canvas(page, "second") not in (plain, errors))
    choose(page, "split", "observed")
    wait(page, lambda: not page.find_element(By.NAME, "overlay").is_enabled())


def shown_pixels(browser, name):
    """(H, W, 4) uint8 of a canvas."""
    height, width, data = browser.execute_script(
        f"const canvas = document.getElementById('{name}');"
        "const [width, height] = [canvas.width, canvas.height];"
        "const { data } = canvas.getContext('2d').getImageData(0, 0, width, height);"
        "return [height, width, Array.from(data)]"
    )
    return np.array(data, np.uint8).reshape(height, width, 4)


def test_black_reference_pixels_are_known_and_have_an_error(page, reported):
    run, _ = reported
    place = {"dataset": "d", "scene": "s"}
    targets = read_targets(run / layout.TARGETS.format(**place))
    target = next(target for target in targets if target.split == "extrapolation")
    reference = References(run / layout.REFERENCES.format(**place))[target.key]
    valid = reference.mask()
    black = valid & (reference.image() == 0).all(axis=2)
    assert black.any()
    assert (valid & ~black).any()
    choose(page, "view", target.camera.name)
    choose(page, "left", "sparse reference")
    choose(page, "right", "grey")
    page.find_element(By.NAME, "error").click()
    # Of 99 everywhere: white where the answer is black, black where there is none.
    wait(page, lambda: (shown_pixels(page, "second")[black] == 255).all())
    assert not shown_pixels(page, "second")[~valid][:, :3].any()
    page.find_element(By.NAME, "error").click()
    page.find_element(By.NAME, "overlay").click()
    wait(page, lambda: (shown_pixels(page, "first")[..., 3] == 255).all())


def caption(browser):
    return browser.find_element(By.ID, "caption").text


def test_flicker_shows_one_side_then_the_other(page):
    button = page.find_element(By.NAME, "flicker")
    button.send_keys(Keys.SPACE)
    exposures = set()

    def both():
        exposures.add(page.execute_script("return document.getElementById('slider').value"))
        return {0, 100} <= exposures

    wait(page, both)
    button.send_keys(Keys.SPACE)
    assert button.get_attribute("aria-pressed") == "false"


def test_it_fits_a_phone(page):
    page.set_window_size(400, 800)
    try:
        scroll(page, page.find_element(By.CSS_SELECTOR, ".chart"))
        wait(page, lambda: page.find_elements(By.CSS_SELECTOR, ".chart svg"))
        wide = "return document.documentElement.scrollWidth - document.documentElement.clientWidth"
        assert page.execute_script(wide) <= 0
    finally:
        page.set_window_size(1200, 900)
