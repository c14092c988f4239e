"""A headless Chromium for tests, kept off every network but this machine's; and its pages' buttons."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from selenium import webdriver
from selenium.common.exceptions import (
    ElementClickInterceptedException,
    ElementNotInteractableException,
    StaleElementReferenceException,
)
from selenium.webdriver.chrome.service import Service
from selenium.webdriver.remote.webdriver import WebDriver
from waiting import wait_until


@contextmanager
def open_browser(folder: Path, width: int = 1400, height: int = 900) -> Iterator[webdriver.Chrome]:
    options = webdriver.ChromeOptions()
    options.binary_location = "/usr/bin/chromium"
    for flag in (
        "--headless=new",
        "--no-sandbox",
        "--disable-gpu",
        "--disable-quic",
        "--disable-dev-shm-usage",
        "--no-first-run",
        "--disable-background-networking",
        "--disable-component-update",
        "--disable-sync",
        f"--user-data-dir={folder / 'chromium'}",
        f"--window-size={width},{height}",
    ):
        options.add_argument(flag)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL", "performance": "ALL"})
    browser = webdriver.Chrome(options=options, service=Service("/usr/bin/chromedriver"))
    try:
        yield browser
    finally:
        browser.quit()


@dataclass(frozen=True)
class Button:
    """The first visible button that says ``text``, whom the page may be building anew or moving: it is tried again."""

    browser: WebDriver
    text: str

    def click(self) -> None:
        self._act(lambda found: found.click())

    def send_keys(self, *keys: str) -> None:
        self._act(lambda found: found.send_keys(*keys))

    def is_enabled(self) -> bool:
        return bool(self._act(lambda found: found.is_enabled()))

    def _act(self, act: Callable[[Any], Any]) -> Any:
        def acted() -> list[Any]:
            found = self.browser.execute_script(_BUTTON, self.text)
            try:
                return [] if found is None else [act(found)]
            except _NOT_YET:
                return []

        return wait_until(acted, 20, f"the button {self.text}")[0]


_NOT_YET = (StaleElementReferenceException, ElementNotInteractableException, ElementClickInterceptedException)
_BUTTON = """
const says = (one) => [one.textContent.trim(), one.querySelector("strong")?.textContent].includes(arguments[0]);
return [...document.querySelectorAll("button")].find((one) => one.checkVisibility() && says(one)) ?? null;
"""
