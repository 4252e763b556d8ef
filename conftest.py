# SPDX-License-Identifier: Apache-2.0
"""What holds for every test.

Those marked `ros` need ROS, and none talks beyond this machine. Those that test/slow.txt lists are
marked `slow`; one that it does not list and that takes long is told. With CI=true nothing
may be skipped: what a test needs is there, or the machine that runs it is not set up.
"""

from collections.abc import Generator
import importlib
import os
from pathlib import Path

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


@pytest.hookimpl(tryfirst=True)  # before `-m` chooses
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    slow = set(listed())
    for item in items:
        whole = item.nodeid.removeprefix('checks/').removeprefix('test/')
        names = {whole, whole.partition('[')[0], whole.partition('::')[0]}
        if names & slow:
            item.add_marker(pytest.mark.slow)
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


_amiss: list[str] = []
# What is only told: how long a test takes is also a matter of what else the machine does.
_late: list[str] = []


def _reason(report: pytest.TestReport | pytest.CollectReport) -> str:
    return str(report.longrepr[2] if isinstance(report.longrepr, tuple) else report.longrepr)


@pytest.hookimpl(wrapper=True)
def pytest_make_collect_report() -> Generator[None, pytest.CollectReport, pytest.CollectReport]:
    report = yield
    if CI and report.skipped:
        # As a failure it would keep all other tests from being run.
        _amiss.append(f'{report.nodeid} is skipped with CI=true: {_reason(report)}')
    return report


def _refused(report: pytest.TestReport) -> None:
    """Turn a skip into a failure."""
    if CI and report.skipped and not hasattr(report, 'wasxfail'):
        reason = _reason(report)
        report.outcome = 'failed'
        report.longrepr = f'With CI=true nothing may be skipped. {reason}'


# ---------------------------------------------------------------- the marks hold


def _compiled_since(moment: float) -> bool:
    """Whether numba has filled its cache since, here or in another process: that is done once."""
    place = Path(config.CACHE_DIR) if config.CACHE_DIR else HERE
    return any(path.stat().st_mtime >= moment for path in place.rglob('*.nbc'))


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(
    item: pytest.Item,
) -> Generator[None, pytest.TestReport, pytest.TestReport]:
    report = yield
    _refused(report)
    slow = item.get_closest_marker('slow') is not None
    late = report.when == 'call' and report.duration > LIMIT and not slow
    if late and not _compiled_since(report.start):
        _late.append(
            f'{item.nodeid} took {report.duration:.0f} s and is not marked slow; list it in '
            'test/slow.txt'
        )
    return report


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
