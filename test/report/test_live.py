# SPDX-License-Identifier: Apache-2.0
"""A run in the browser while it goes on: what the page is told, and what it makes of it."""

from collections.abc import Iterator
import json
from pathlib import Path
from typing import Any

from browser_cases import AXE, chromium, JUDGE, until
from identify_cases import axis, AXIS_FILE, QUICK, ROOT
import numpy as np
import pytest
from report_cases import write_identified

from ros2_ident.cli.main import main
from ros2_ident.errors import ErrorCode, IdentError
from ros2_ident.gap.diagnose import DiagnoseProgress
from ros2_ident.identify.run import identify, read_data
from ros2_ident.identify.settings import IdentifyProgress
from ros2_ident.identify.setup import problem_of
from ros2_ident.report.page import live, LivePage, write_report

BAG = ROOT / 'bags/axis_reversals'


@pytest.fixture(scope='module')
def problem() -> Any:
    return problem_of(axis(), read_data([BAG], axis()))


@pytest.fixture
def at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(live, 'EVERY', 0.0)


def news(folder: Path) -> dict[str, Any]:
    text = (folder / live.NEWS).read_text(encoding='utf-8')
    assert text.startswith('identNews(') and text.endswith(')\n')
    said: dict[str, Any] = json.loads(text[len('identNews(') : -2])
    return said


def step(problem: Any, cost: float, share: float = 0.5, elapsed: float = 3.0) -> IdentifyProgress:
    theta = problem.low + share * (problem.high - problem.low)
    names = tuple(p.name for p in problem.parameters)
    return IdentifyProgress(
        'search', 2, 12, 1100, 1728, cost, 'N', names, theta, 0.1, elapsed, 9.0
    )


def test_a_run_is_told_as_it_goes(problem: Any, tmp_path: Path, at_once: None) -> None:
    told = []
    with LivePage(tmp_path, 'Identifying', 'axis', problem) as page:
        assert news(tmp_path)['state'] == 'preparing'
        assert live.NEWS in (tmp_path / 'report.html').read_text(encoding='utf-8')

        def tell(progress: IdentifyProgress) -> None:
            page.identifying(progress)
            told.append((progress, news(tmp_path)))

        found = identify(axis(), problem.data, settings=QUICK, on_progress=tell)
        write_identified(tmp_path)
        write_report(tmp_path)
    assert not (tmp_path / live.NEWS).exists()
    progress, said = told[-1]
    assert [p['name'] for p in said['parameters']] == [p.name for p in found.parameters]
    assert said['costs'][-1] == [progress.elapsed, progress.best_cost]
    assert all(0.0 <= place <= 1.0 for p in said['parameters'] for place in p['trace'])
    (drive,) = said['efforts']
    # the log's own efforts, and a simulation that is as far from them as the best cost says
    log = problem.data.recordings[0].effort.column('effort', drive['drive'])
    measured, simulated = (np.array(drive[name]) for name in ('measured', 'simulated'))
    assert np.isin(np.round(measured, 2), np.round(log, 2)).mean() > 0.95
    rest = np.sqrt(np.mean((measured - simulated) ** 2))
    assert rest == pytest.approx(progress.best_cost, rel=0.5)


def test_news_are_written_at_most_once_a_second(problem: Any, tmp_path: Path) -> None:
    with LivePage(tmp_path, 'Identifying', 'axis', problem) as page:
        for cost in (3.0, 2.0, 1.0):
            page.identifying(step(problem, cost))
        assert news(tmp_path)['state'] == 'preparing'  # a second has not gone
        write_report_of(tmp_path)


def write_report_of(folder: Path) -> None:
    write_identified(folder)
    write_report(folder)


def test_a_long_run_keeps_its_history_short(
    problem: Any, tmp_path: Path, at_once: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(live, 'POINTS', 40)
    with LivePage(tmp_path, 'Identifying', 'axis', problem) as page:
        for k in range(50):
            page.identifying(step(problem, 50.0 - k, k / 50.0, float(k)))
        costs = news(tmp_path)['costs']
        write_report_of(tmp_path)
    assert 20 < len(costs) <= 40
    assert costs[0] == [0.0, 50.0] and costs[-1] == [49.0, 1.0]
    assert [t for t, _ in costs] == sorted(t for t, _ in costs)


def test_a_run_that_ends_in_an_error_says_so(tmp_path: Path) -> None:
    why = IdentError(ErrorCode.DIVERGED, 'every candidate diverges; check the gains')
    with pytest.raises(IdentError), LivePage(tmp_path, 'Diagnosing', 'axis'):
        raise why
    assert news(tmp_path)['state'] == 'ended' and news(tmp_path)['why'] == why.message
    with pytest.raises(KeyboardInterrupt), LivePage(tmp_path, 'Diagnosing', 'axis'):
        raise KeyboardInterrupt
    assert news(tmp_path)['why'] == 'it was interrupted twice'


def test_a_page_without_its_report_is_told(tmp_path: Path) -> None:
    with LivePage(tmp_path, 'Diagnosing', 'axis'):
        (tmp_path / 'report.html').unlink()
    assert news(tmp_path) | {'written': 0} == {
        'format': 'ros2_ident.news', 'state': 'ended', 'why': 'it could not be written',
        'written': 0,
    }  # fmt: skip


def test_each_better_explanation_of_a_diagnosis_is_a_line(tmp_path: Path) -> None:
    with LivePage(tmp_path, 'Diagnosing', 'axis') as page:
        for best in ('', 'backlash', 'backlash', 'Stribeck friction'):
            page.diagnosing(DiagnoseProgress('looking', 0.4, best, 7.0, 10.5))
        said = news(tmp_path)
        write_report_of(tmp_path)
    assert said['notes'] == [[7.0, 'backlash'], [7.0, 'Stribeck friction']]
    assert (said['share'], said['left']) == (0.4, 10.5)


@pytest.mark.parametrize('command', ['identify', 'diagnose'])
def test_the_command_leaves_the_report(
    command: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Any
) -> None:
    out = tmp_path / 'out'
    seen = []
    name = {'identify': 'identifying', 'diagnose': 'diagnosing'}[command]
    show = getattr(LivePage, name)

    def watched(page: LivePage, progress: Any) -> None:
        show(page, progress)
        there = 'identLive' in (out / 'report.html').read_text(encoding='utf-8')
        seen.append(there and (out / live.NEWS).exists())

    monkeypatch.setattr(LivePage, name, watched)
    words = [command, str(BAG), '--machine', str(AXIS_FILE), '--out', str(out), '--live']
    if command == 'identify':
        words += ['--population', '64', '--generations', '2']
    assert main([*words, '--quiet', '--no-overlay', '--threads', '1']) == 0
    assert seen and all(seen)
    assert not (out / live.NEWS).exists()
    report = (out / 'report.html').read_text(encoding='utf-8')
    assert 'identLive' not in report and 'Provenance' in report
    assert f'live: {(out / "report.html").as_uri()}\n' in capsys.readouterr().err


@pytest.mark.parametrize('more', [['--no-report', '--out', 'x'], []])
def test_a_live_page_needs_a_place(
    more: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Any
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(['diagnose', str(BAG), '--machine', str(AXIS_FILE), '--live', *more]) == 2
    assert 'give --out, and leave out --no-report' in capsys.readouterr().err


@pytest.fixture(scope='module')
def browser() -> Iterator[Any]:
    with chromium() as driver:
        yield driver


HEADLINE = "return document.getElementById('headline').textContent"


def test_the_browser_follows_a_run_and_then_shows_the_report(
    browser: Any, problem: Any, tmp_path: Path, at_once: None
) -> None:
    with LivePage(tmp_path, 'Identifying', 'axis', problem) as page:
        browser.get(page.place)
        until(browser, f"{HEADLINE}.startsWith('Preparing')")
        page.identifying(step(problem, 3.0))
        until(browser, f"{HEADLINE} === 'Generation 2 of 12'")
        page.identifying(step(problem, 2.0, 0.4, 4.0))
        until(browser, "return document.getElementById('times').textContent.includes('best 2 N')")
        drawn = "return document.querySelectorAll('#efforts svg, #costs svg, #values svg').length"
        assert browser.execute_script(drawn) == 1 + 1 + len(problem.parameters)
        width = "return document.querySelector('[role=progressbar]').getAttribute('aria-valuenow')"
        assert browser.execute_script(width) == '31'  # 4 s gone and 9 to go
        if AXE.exists():
            browser.execute_script(AXE.read_text(encoding='utf-8'))
            assert browser.execute_async_script(JUDGE) == []
        write_report_of(tmp_path)
    until(browser, "return document.querySelector('#provenance') !== null")


def test_the_browser_says_why_a_run_ended(browser: Any, tmp_path: Path) -> None:
    with pytest.raises(IdentError), LivePage(tmp_path, 'Diagnosing', 'axis') as page:
        browser.get(page.place)
        until(browser, f"{HEADLINE}.startsWith('Preparing')")
        raise IdentError(ErrorCode.DIVERGED, 'every candidate diverges')
    until(browser, f"{HEADLINE}.endsWith('without a report: every candidate diverges')")
    (tmp_path / live.NEWS).unlink()
    browser.get(page.place)
    until(browser, f"{HEADLINE}.startsWith('There is no progress.js beside this page')")
