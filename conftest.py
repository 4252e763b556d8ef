# SPDX-License-Identifier: Apache-2.0
"""What holds for every test.

Those marked `ros` need ROS, and none talks beyond this machine. Those that test/slow.txt lists are
marked `slow`; one that it does not list and that takes long is told. With CI=true nothing
may be skipped: what a test needs is there, or the machine that runs it is not set up.
"""

from collections.abc import Generator, Iterator
import importlib
import os
from pathlib import Path
from typing import Any

from browser_cases import chromium
from docs_cases import fill_clone
from hypothesis import HealthCheck, settings
from numba import config
import pytest

HERE = Path(__file__).parent
SLOW = HERE / 'test/slow.txt'
# s; a test that is not listed took less than half of one when it was measured. The rest is for
# slower machines, and for the neighbours of this one.
LIMIT = 15.0
CI = os.environ.get('CI') == 'true'

# The same examples in every run: what they find is to be mended when a test is written, not when
# somebody else's change is tested. HYPOTHESIS_RANDOM=1 looks for new ones. How long it takes to
# draw them is the machine's matter.
settings.register_profile(
    'fixed',
    derandomize=not os.environ.get('HYPOTHESIS_RANDOM'),
    suppress_health_check=[HealthCheck.too_slow],
)
settings.load_profile('fixed')

os.environ.setdefault('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')


def listed() -> list[str]:
    """Return what test/slow.txt lists: files, tests, or tests with their parameters."""
    lines = SLOW.read_text(encoding='utf-8').splitlines()
    return [line for line in lines if line and not line.startswith('#')]


def _names(nodeid: str) -> set[str]:
    """Return how test/slow.txt may name a test: as it is, without its parameters, by its file."""
    whole = nodeid.removeprefix('checks/').removeprefix('test/')
    return {whole, whole.partition('[')[0], whole.partition('::')[0]}


@pytest.hookimpl(tryfirst=True)  # before `-m` chooses
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    slow = listed()
    for item in items:
        if _names(item.nodeid) & set(slow):
            item.add_marker(pytest.mark.slow)
    # Where several processes take the files one by one, the longest is not the last.
    files = list(dict.fromkeys(line.partition('::')[0] for line in slow))
    place = {file: number for number, file in enumerate(files)}
    items.sort(key=lambda item: min(place.get(name, len(files)) for name in _names(item.nodeid)))
    _skip_without_ros([item for item in items if item.get_closest_marker('ros')])


def _skip_without_ros(marked: list[pytest.Item]) -> None:
    if not marked:
        return
    try:
        importlib.import_module('rclpy')
        importlib.import_module('ros2_ident_msgs.msg')
    except ImportError as error:
        skip = pytest.mark.skip(reason=f'{error}; run `make test`, or source env.sh first')
        for item in marked:
            item.add_marker(skip)


# ---------------------------------------------------------------- nothing is skipped in CI


# Of this process, which hears of every test: with pytest-xdist others run them.
_amiss: list[str] = []
# What is only told: how long a test takes is also a matter of what else the machine does.
_late: list[str] = []


def _reason(report: pytest.TestReport | pytest.CollectReport) -> str:
    return str(report.longrepr[2] if isinstance(report.longrepr, tuple) else report.longrepr)


def pytest_collectreport(report: pytest.CollectReport) -> None:
    sentence = f'{report.nodeid} is skipped with CI=true: {_reason(report)}'
    # As a failure it would keep all other tests from being run; each process may tell of it.
    if CI and report.skipped and sentence not in _amiss:
        _amiss.append(sentence)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport() -> Generator[None, pytest.TestReport, pytest.TestReport]:
    """Turn a skip into a failure."""
    report = yield
    if CI and report.skipped and not hasattr(report, 'wasxfail'):
        reason = _reason(report)
        report.outcome = 'failed'
        report.longrepr = f'With CI=true nothing may be skipped. {reason}'
    return report


# ---------------------------------------------------------------- the marks hold


def _compiled_since(moment: float) -> bool:
    """Whether numba has filled its cache since, here or in another process: that is done once."""
    place = Path(config.CACHE_DIR) if config.CACHE_DIR else HERE
    return any(path.stat().st_mtime >= moment for path in place.rglob('*.nbc'))


def pytest_runtest_logreport(report: pytest.TestReport) -> None:
    late = report.when == 'call' and report.duration > LIMIT
    if late and not _names(report.nodeid) & set(listed()) and not _compiled_since(report.start):
        _late.append(
            f'{report.nodeid} took {report.duration:.0f} s and is not marked slow; list it in '
            'test/slow.txt'
        )


def pytest_sessionfinish(session: pytest.Session) -> None:
    if _amiss and session.exitstatus == pytest.ExitCode.OK:
        session.exitstatus = pytest.ExitCode.TESTS_FAILED


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    for sentence in (*_amiss, *_late):
        terminalreporter.write_line(f'AMISS {sentence}')


@pytest.fixture(scope='session')
def clone(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder that looks like a clone, for the commands of the documentation."""
    return fill_clone(tmp_path_factory.mktemp('clone'))


@pytest.fixture(scope='module')
def browser() -> Iterator[Any]:
    """A browser whose log begins with the first test of a file."""
    with chromium() as driver:
        yield driver
