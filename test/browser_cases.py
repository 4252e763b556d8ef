# SPDX-License-Identifier: Apache-2.0
"""A browser for the tests of pages."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
import shutil
from typing import Any

import pytest

AXE = Path(__file__).parents[1] / 'build/axe/node_modules/axe-core/axe.min.js'
JUDGE = """
const done = arguments[arguments.length - 1]
axe.run(document, {runOnly: ['wcag2a', 'wcag2aa', 'wcag21a', 'wcag21aa', 'best-practice']}).then(
  (found) => done(found.violations.flatMap((v) => v.nodes.map((n) => `${v.id}: ${n.html}`))))
"""


@contextmanager
def chromium() -> Iterator[Any]:
    """Open a headless Chromium that notes what it asks for; the test is skipped without one."""
    programs = [
        shutil.which('chromium') or shutil.which('google-chrome'),
        shutil.which('chromedriver'),
    ]
    if None in programs:
        pytest.skip('Chromium is not installed; `apt install chromium chromium-driver` brings it')
    webdriver = pytest.importorskip('selenium.webdriver', reason='`make setup` installs selenium')
    options = webdriver.ChromeOptions()
    options.binary_location = programs[0]
    for word in ('--headless=new', '--no-sandbox', '--window-size=1120,900'):
        options.add_argument(word)
    options.set_capability('goog:loggingPrefs', {'browser': 'ALL', 'performance': 'ALL'})
    driver = webdriver.Chrome(options, webdriver.ChromeService(programs[1]))
    try:
        yield driver
    finally:
        driver.quit()


def until(browser: Any, script: str) -> Any:
    """Wait until a script says yes."""
    from selenium.webdriver.support.ui import WebDriverWait

    return WebDriverWait(browser, 240.0).until(lambda b: b.execute_script(script))
