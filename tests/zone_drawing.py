"""The zone editor in a real browser: opened, its plan clicked."""

from selenium.webdriver.common.action_chains import ActionChains
from selenium.webdriver.common.by import By
from selenium.webdriver.remote.webdriver import WebDriver
from selenium.webdriver.remote.webelement import WebElement
from waiting import wait_until


def open_zones(url: str, browser: WebDriver) -> None:
    browser.get(f"{url}/zones")
    wait_until(lambda: browser.execute_script("return Boolean(window.atriumZones?.ready)"), 20, "the plan")


def on_screen(browser: WebDriver, place: tuple[float, float]) -> tuple[float, float]:
    """A place on the plan, metres, as pixels of the canvas."""
    x, y = browser.execute_script("return atriumZones.toScreen(...arguments)", *place)
    return float(x), float(y)


def move_to(browser: WebDriver, canvas: WebElement, x: float, y: float) -> ActionChains:
    size = canvas.size
    chain = ActionChains(browser, duration=0)
    return chain.move_to_element_with_offset(canvas, round(x - size["width"] / 2), round(y - size["height"] / 2))


def click_plan(browser: WebDriver, *places: tuple[float, float]) -> None:
    canvas = browser.find_element(By.ID, "zones-canvas")
    for place in places:
        move_to(browser, canvas, *on_screen(browser, place)).click().perform()
