# SPDX-License-Identifier: Apache-2.0
"""The page in a real browser: it draws, it zooms, it asks nobody for anything."""

from collections.abc import Iterator
from contextlib import contextmanager
import json
from pathlib import Path
from typing import Any

from browser_cases import AXE, JUDGE, until
import pytest
from report_cases import long_signals, write_diagnosed, write_identified

from ros2_ident.fleet.summary import write_summary
from ros2_ident.report.page import write_comparison, write_report
from ros2_ident.report.signals import write_signals

PLOTS = 2
# Pixels: a phone, A4 within its margins, a plot in a wide window.
PHONE, PAPER, WHOLE = 400, 703, 1040
INK = 'rgb(28, 39, 51)'
# A picture's figures lie in shadow roots, one within another.
FIND = """
function everything(root, wanted) {
  const out = [...root.querySelectorAll(wanted)]
  for (const one of root.querySelectorAll('*'))
    if (one.shadowRoot) out.push(...everything(one.shadowRoot, wanted))
  return out
}
"""
RANGE = """
const figure = identPage.models('effort-plot', 'Figure')[0]
const curve = figure.renderers[0].data_source.data
return {start: figure.x_range.start, end: figure.x_range.end, points: curve.x.length,
  first: Math.min(...curve.x), last: Math.max(...curve.x), most: Math.max(...curve.y)}
"""
# What lies beyond the right edge, would need a bar to be seen, or is folded up.
CUT_OFF = """
return [...document.querySelectorAll('main *')].filter((one) => !one.closest('svg, .hidden')
  && (one.getBoundingClientRect().right > arguments[0] + 2
    || /auto|scroll/.test(getComputedStyle(one).overflow)
    || one.parentNode.tagName === 'DETAILS' && !one.checkVisibility())).map((one) => one.outerHTML)
"""


@pytest.fixture(scope='module')
def page(browser, tmp_path_factory) -> Any:
    folder = tmp_path_factory.mktemp('run')
    write_identified(folder)
    # So much of one drive is held whole, beside a diagnosis too.
    write_signals(folder / 'signals.npz', long_signals(100_000, drives=1))
    write_diagnosed(folder)
    browser.get(write_report(folder).as_uri())
    until(browser, 'return document.documentElement.dataset.ready')
    return browser


def effort(page: Any) -> Any:
    """Return the surface of the first plot, in the middle of the window."""
    return page.execute_script(
        FIND + "const f = everything(document.getElementById('effort-plot'), '.bk-events')[0]\n"
        "f.scrollIntoView({block: 'center', behavior: 'instant'}); return f"
    )


def ranges(condition: str) -> str:
    """Return a script that says whether a condition on what is `seen` holds."""
    return f'{RANGE.replace("return {", "const seen = {")}\nreturn {condition}'


def test_it_draws_every_picture_and_asks_nobody(page: Any) -> None:
    empty = page.execute_script(
        FIND + "return [...document.querySelectorAll('figure')].filter("
        "f => !everything(f, 'svg path').length).length"
    )
    assert empty == 0
    assert page.execute_script('return Bokeh.documents.length') == PLOTS
    faults = [x for x in page.get_log('browser') if x['level'] != 'INFO']
    assert faults == []
    events = [json.loads(x['message'])['message'] for x in page.get_log('performance')]
    asked = [
        x['params']['request']['url'] for x in events if x['method'] == 'Network.requestWillBeSent'
    ]
    assert [url for url in asked if not url.startswith('data:')] == [page.current_url]


def turn_wheel(page: Any, *keys: str) -> None:
    from selenium.webdriver import ActionChains
    from selenium.webdriver.common.actions.wheel_input import ScrollOrigin

    origin = ScrollOrigin.from_element(effort(page))
    chain = ActionChains(page)
    for key in keys:
        chain.key_down(key)
    chain.scroll_from_origin(origin, 0, -600)
    for key in keys:
        chain.key_up(key)
    chain.perform()


def test_the_wheel_scrolls_the_page_and_zooms_with_control(page: Any) -> None:
    from selenium.webdriver import Keys

    before = page.execute_script(RANGE)
    assert before['start'] == 0.0 and before['end'] > 99.0
    assert before['points'] <= 2000 and before['most'] == pytest.approx(4.0, abs=0.01)
    effort(page)
    place = page.execute_script('return scrollY')
    turn_wheel(page)
    until(page, f'return scrollY < {place} - 100')
    assert page.execute_script(RANGE) == before
    turn_wheel(page, Keys.CONTROL)
    until(page, ranges(f'seen.end - seen.start < {before["end"]} - 1'))
    after = page.execute_script(RANGE)
    # What is drawn is what is in view, and as finely as it can be.
    assert after['first'] >= after['start'] - 0.1 and after['last'] <= after['end'] + 0.1
    assert 1000 < after['points'] <= 2002


def press(page: Any, plot: str, text: str) -> Any:
    return page.execute_script(
        'const b = [...document.querySelectorAll(`button[data-plot=${arguments[0]}]`)]'
        '.find((b) => b.textContent.includes(arguments[1])); b.click(); return b.ariaPressed',
        plot,
        text,
    )


@contextmanager
def width(page: Any, pixels: int) -> Iterator[None]:
    """Show the page as wide as a phone or a sheet of paper."""
    size = {'width': pixels, 'height': 800, 'deviceScaleFactor': 1, 'mobile': True}
    page.execute_cdp_cmd('Emulation.setDeviceMetricsOverride', size)
    try:
        yield
    finally:
        page.execute_cdp_cmd('Emulation.clearDeviceMetricsOverride', {})


def phone_width(page: Any) -> int:
    """Return how wide the page is on a phone."""
    with width(page, PHONE):
        return int(page.execute_script('return document.documentElement.scrollWidth'))


def test_a_phone_shows_all_of_it(page: Any) -> None:
    """Nothing but tables and plots in their own frames is wider than the window."""
    assert phone_width(page) <= PHONE


def test_paper_shows_all_of_it(page: Any) -> None:
    """A plot keeps its width when it is printed, and paper has no scroll bars."""
    plot = "const plot = document.getElementById('effort-plot')\n"
    plot += 'return plot.getBoundingClientRect().width / plot.currentCSSZoom'
    # It takes a frame or two to fill the window again that another test has widened.
    until(page, plot.replace('return ', f'return {WHOLE} === '))
    dark = {'name': 'prefers-color-scheme', 'value': 'dark'}
    page.execute_cdp_cmd('Emulation.setEmulatedMedia', {'media': 'print', 'features': [dark]})
    try:
        with width(page, PAPER):
            assert page.execute_script(plot) >= WHOLE
            assert page.execute_script(CUT_OFF, PAPER) == []
            assert page.execute_script('return getComputedStyle(document.body).color') == INK
    finally:
        page.execute_cdp_cmd('Emulation.setEmulatedMedia', {'media': '', 'features': []})


def test_a_plot_with_the_focus_has_a_ring(page: Any) -> None:
    page.execute_script(
        FIND + "everything(document.getElementById('effort-plot'), '.bk-events')[0].focus()"
    )
    ring = page.execute_script(
        'let at = document.activeElement\nwhile (at.shadowRoot) at = at.shadowRoot.activeElement\n'
        'const seen = getComputedStyle(at)\n'
        'return [at.className, seen.outlineStyle, seen.outlineWidth, seen.outlineColor]'
    )
    assert ring == ['bk-layer bk-events', 'solid', '3px', 'rgb(0, 114, 178)']


@pytest.mark.parametrize('scheme', ['light', 'dark'])
def test_it_is_accessible(page: Any, scheme: str) -> None:
    if not AXE.exists():
        pytest.skip('axe-core is missing; `npm install --prefix build/axe axe-core` brings it')
    wanted = {'features': [{'name': 'prefers-color-scheme', 'value': scheme}]}
    page.execute_cdp_cmd('Emulation.setEmulatedMedia', wanted)
    # Without the hint that Bokeh shows for a while where the wheel was turned.
    page.refresh()
    until(page, 'return document.documentElement.dataset.ready')
    page.execute_script(AXE.read_text(encoding='utf-8'))
    assert page.execute_async_script(JUDGE) == []


def test_of_six_joints_one_is_shown_and_each_has_a_tab(page: Any, tmp_path: Path) -> None:
    here = page.current_url
    write_identified(tmp_path)
    write_signals(tmp_path / 'signals.npz', long_signals(5000, drives=6))
    page.get(write_report(tmp_path).as_uri())
    until(page, 'return document.documentElement.dataset.ready')
    seen = (
        "return [...new Set(identPage.models('effort-plot', 'Figure')"
        '.filter((f) => f.visible).map((f) => f.name))]'
    )
    # The first has a spike that no simulation repeats.
    assert page.execute_script(seen) == ['drive-0']
    height = page.execute_script("return document.getElementById('effort-plot').clientHeight")
    assert press(page, 'effort-plot', 'drive_5') == 'true'
    assert page.execute_script(seen) == ['drive-4']
    until(page, f"return document.getElementById('effort-plot').clientHeight === {height}")
    axis = "return identPage.models('effort-plot', 'Figure').find((f) => f.visible).y_range"
    assert page.execute_script(f'{axis}.start') == pytest.approx(-1.2, abs=0.2)
    assert page.execute_script(f'{axis}.end') == pytest.approx(1.2, abs=0.2)
    assert [x for x in page.get_log('browser') if x['level'] != 'INFO'] == []
    assert phone_width(page) <= PHONE
    # The first screen has the values with their intervals, down to the last sign.
    with width(page, PHONE):
        room = "const of = document.querySelector('.hero'); return of.scrollWidth - of.clientWidth"
        assert page.execute_script(room) == 0
    page.get(here)
    until(page, 'return document.documentElement.dataset.ready')


def test_pages_on_several_runs_are_accessible(page: Any, tmp_path: Path) -> None:
    if not AXE.exists():
        pytest.skip('axe-core is missing; `npm install --prefix build/axe axe-core` brings it')
    here = page.current_url
    folder = tmp_path / 'run'
    folder.mkdir()
    write_identified(folder)
    value = {'value': 2.0, 'low': 1.9, 'high': 2.1, 'unit': 'kg'}
    done = {'state': 'done', 'code': 'OK', 'message': 'ok', 'date': '', 'machine': 'a'}
    write_summary(tmp_path, [{**done, 'name': 'a', 'parameters': {'mass': value}}])
    pages = (write_report(tmp_path), write_comparison([folder, folder], tmp_path / 'both.html'))
    for written in pages:
        page.get(written.as_uri())
        until(page, 'return document.documentElement.dataset.ready')
        page.execute_script(AXE.read_text(encoding='utf-8'))
        assert page.execute_async_script(JUDGE) == []
    page.get(here)
    until(page, 'return document.documentElement.dataset.ready')
