# SPDX-License-Identifier: Apache-2.0
"""The documentation site is built without a warning, and holds every page and module."""

import json
import os
from pathlib import Path
import subprocess
import sys

from browser_cases import chromium
import pytest

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope='module')
def built(
    tmp_path_factory: pytest.TempPathFactory,
) -> tuple[Path, 'subprocess.CompletedProcess[str]']:
    pytest.importorskip('mkdocs', reason='mkdocs is not installed')
    folder = tmp_path_factory.mktemp('site')
    done = subprocess.run(
        ['bash', 'tools/docs.sh', '--site-dir', str(folder)],
        cwd=ROOT,
        env={**os.environ, 'PATH': f'{Path(sys.executable).parent}:{os.environ["PATH"]}'},
        capture_output=True,
        text=True,
        timeout=500,
    )
    return folder, done


def test_the_site_is_built_strictly_and_whole(built) -> None:
    folder, done = built
    assert done.returncode == 0, done.stderr[-3000:]
    assert 'WARNING' not in done.stderr
    for page in ROOT.glob('docs/*.md'):
        assert (folder / f'{page.stem}.html').is_file(), page.name
    api = (folder / 'api/ros2_ident.search.html').read_text(encoding='utf-8')
    assert 'id="ros2_ident.search.refine.refine"' in api
    # words of a docstring, and its sections, and links between pages that lie in two folders
    assert 'Returns:' in api
    text = (folder / 'index.html').read_text(encoding='utf-8')
    assert 'href="readme.html"' in text
    assert 'href="tutorial.html"' in text
    assert '.md"' not in text


def test_the_site_is_searched_without_a_network(built) -> None:
    """Opened from the disk: the search finds a page, and nothing is asked of the network."""
    from selenium.webdriver.support.ui import WebDriverWait

    folder, _ = built
    with chromium() as browser:
        browser.get((folder / 'index.html').as_uri())
        field = browser.find_element('css selector', '[data-md-component=search-query]')
        browser.execute_script('arguments[0].click(); arguments[0].focus()', field)
        wait = WebDriverWait(browser, 240.0)
        wait.until(lambda b: b.execute_script('return typeof __index === "object"'))
        field.send_keys('stribeck')
        found = '.md-search-result__item a'
        wait.until(lambda b: b.find_elements('css selector', found))
        pages = [x.get_attribute('href') for x in browser.find_elements('css selector', found)]
        assert any('effects.html' in page for page in pages)
        events = [json.loads(x['message'])['message'] for x in browser.get_log('performance')]
    asked = {
        x['params']['request']['url'] for x in events if x['method'] == 'Network.requestWillBeSent'
    }
    assert asked and all(url.startswith(('file:', 'data:')) for url in asked), asked
