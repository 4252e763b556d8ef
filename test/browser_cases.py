# SPDX-License-Identifier: Apache-2.0
"""A browser for the tests of pages."""

from collections.abc import Iterator
from contextlib import contextmanager
import shutil
from typing import Any

import pytest


@contextmanager
def chromium() -> Iterator[Any]:
    """Open a headless Chromium that notes what it asks for; the test is skipped without one."""
    programs = [shutil.which('chromium') or shutil.which('google-chrome'),
                shutil.which('chromedriver')]
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
