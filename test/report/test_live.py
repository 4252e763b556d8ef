# SPDX-License-Identifier: Apache-2.0
"""Page of a run in progress: its content, and its end."""

from pathlib import Path
from typing import Any

from browser_cases import AXE, JUDGE, until
from identify_cases import axis, AXIS_FILE, ROOT
import pytest
from report_cases import write_identified

from ros2_ident import jobs
from ros2_ident.cli.main import main
from ros2_ident.errors import ErrorCode, IdentError
from ros2_ident.gap.diagnose import DiagnoseProgress
from ros2_ident.identify.problem import problem_of
from ros2_ident.identify.run import read_data
from ros2_ident.identify.settings import IdentifyProgress
from ros2_ident.report.page import live, LivePage, write_report

BAG = ROOT / 'bags/axis_reversals'
RELOADS = '<meta http-equiv="refresh"'


@pytest.fixture(scope='module')
def problem() -> Any:
    return problem_of(axis(), read_data([BAG], axis()))


@pytest.fixture
def at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(live, 'EVERY', 0.0)


def text(folder: Path) -> str:
    return (folder / 'report.html').read_text(encoding='utf-8')


def step(problem: Any, cost: float, share: float = 0.5, elapsed: float = 3.0) -> IdentifyProgress:
    theta = problem.low + share * (problem.high - problem.low)
    names = tuple(p.name for p in problem.parameters)
    return IdentifyProgress(
        'search', 2, 12, 1100, 1728, cost, theta, 0.1, elapsed, 9.0, unit='N', names=names
    )


def write_report_of(folder: Path) -> None:
    write_identified(folder)
    write_report(folder)


def test_the_reason_of_an_end_without_report_is_on_the_page(tmp_path: Path) -> None:
    why = IdentError(ErrorCode.DIVERGED, 'every candidate diverges; check the gains')
    for error, words in ((why, why.message), (KeyboardInterrupt(), 'it was interrupted twice')):
        with pytest.raises(type(error)), LivePage(tmp_path, 'Diagnosing', 'axis'):
            raise error
        assert f'ended without a report: {words}' in text(tmp_path)
        assert RELOADS not in text(tmp_path)
    with LivePage(tmp_path, 'Diagnosing', 'axis'):
        (tmp_path / 'report.html').unlink()
    assert 'it could not be written' in text(tmp_path)


def test_each_better_explanation_of_a_diagnosis_is_a_line(tmp_path: Path) -> None:
    with LivePage(tmp_path, 'Diagnosing', 'axis') as page:
        for best in ('', 'backlash', 'backlash', 'Stribeck friction'):
            page.show(DiagnoseProgress('looking', 0.4, best, 7.0, 10.5))
        assert '<li>7 s: backlash</li><li>7 s: Stribeck friction</li>' in text(tmp_path)
        assert '7 s gone, about 10 s to go' in text(tmp_path)
        write_report_of(tmp_path)


@pytest.mark.parametrize('command', ['identify', 'diagnose'])
def test_the_command_leaves_the_report(
    command: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Any
) -> None:
    out = tmp_path / 'out'
    seen = []
    show = LivePage.show

    def watched(page: LivePage, progress: Any) -> None:
        show(page, progress)
        seen.append(RELOADS in text(out))

    def saved(*done: Any, **how: Any) -> Any:
        # A browser that reloads while results are written finds a page.
        files = save(*done, **how)
        seen.append(RELOADS in text(out))
        return files

    save = jobs.save
    monkeypatch.setattr(jobs, 'save', saved)
    monkeypatch.setattr(LivePage, 'show', watched)
    words = [command, str(BAG), '--machine', str(AXIS_FILE), '--out', str(out), '--live']
    if command == 'identify':
        words += ['--population', '64', '--generations', '2']
    assert main([*words, '--quiet', '--no-overlay', '--threads', '1']) == 0
    assert seen and all(seen)
    assert RELOADS not in text(out) and 'Provenance' in text(out)
    assert f'live: {(out / "report.html").as_uri()}\n' in capsys.readouterr().err


@pytest.mark.parametrize('more', [['--no-report', '--out', 'x'], []])
def test_a_live_page_needs_a_place(
    more: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Any
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(['diagnose', str(BAG), '--machine', str(AXIS_FILE), '--live', *more]) == 2
    assert 'give --out, and leave out --no-report' in capsys.readouterr().err


def test_the_browser_follows_a_run_and_then_shows_the_report(
    browser: Any, problem: Any, tmp_path: Path, at_once: None
) -> None:
    with LivePage(tmp_path, 'Identifying', 'axis', problem) as page:
        browser.get(page.place)
        page.show(step(problem, 3.0))
        page.show(step(problem, 2.0, 0.4, 4.0))
        # in one script, for the page reloads between two
        until(
            browser,
            "return document.documentElement.dataset.ready === 'yes'"
            " && document.getElementById('headline').textContent === 'Generation 2 of 12'"
            " && document.getElementById('times').textContent.includes('best 2 N')"
            " && document.querySelector('[role=progressbar]').ariaValueNow === '31'"
            " && document.querySelectorAll('.drawn').length === 1"
            f" && document.querySelectorAll('#values .box').length === {len(problem.parameters)}",
        )
        write_report_of(tmp_path)
    until(browser, "return document.querySelector('#provenance') !== null")
    if AXE.exists():
        browser.execute_script(AXE.read_text(encoding='utf-8'))
        assert browser.execute_async_script(JUDGE) == []
