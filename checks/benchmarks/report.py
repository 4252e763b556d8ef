# SPDX-License-Identifier: Apache-2.0
"""Size of the page, time to its first picture, and what it asks the network for, in Chromium.

Each directory's page is written anew into a scratch folder and opened several times in a headless
Chromium; then that of the first directory once more, its log repeated to 100,000 samples a drive.
Times are the shortest and the median of the rounds.

    python checks/benchmarks/report.py build/tripod build/axis [--rounds 5]

It needs Chromium and its driver (`apt install chromium chromium-driver`).
"""

import argparse
from dataclasses import replace
import json
from pathlib import Path
import shutil
import statistics
import tempfile
import time
from typing import Any

import numpy as np
from selenium import webdriver
from selenium.webdriver.support.ui import WebDriverWait

from ros2_ident.report.files import SIGNALS
from ros2_ident.report.page import write_report
from ros2_ident.report.signals import load_signals, write_signals

LONG = 100_000
MARKS = """
const marks = performance.getEntriesByType('mark').map(m => [m.name, m.startTime])
return Object.fromEntries(marks)
"""


def lengthen(folder: Path) -> None:
    """Repeat the log of a result directory until it has as many samples as `LONG`."""
    signals = load_signals(folder / SIGNALS)
    log = signals.recordings[0]
    count = -(-LONG // log.time.size)
    lasts = float(log.time[-1] + log.time[1] - log.time[0])
    time_of_all = np.concatenate([log.time + lasts * n for n in range(count)])[:LONG]
    long = replace(
        log,
        time=time_of_all,
        measured=np.tile(log.measured, count)[:, :LONG],
        simulated=np.tile(log.simulated, count)[..., :LONG],
        tracking=np.tile(log.tracking, count)[:, :LONG],
    )
    write_signals(folder / SIGNALS, replace(signals, recordings=(long,)))


def open_page(page: Path) -> tuple[dict[str, float], float, int, int]:
    """Return the page's marks [ms], the time of a zoom [ms], requests, and faults in the log."""
    options = webdriver.ChromeOptions()
    for word in ('--headless=new', '--no-sandbox', '--window-size=1120,900'):
        options.add_argument(word)
    options.set_capability('goog:loggingPrefs', {'browser': 'ALL', 'performance': 'ALL'})
    driver = webdriver.ChromeService(shutil.which('chromedriver'))
    with webdriver.Chrome(options, driver) as chrome:
        chrome.get(page.as_uri())
        WebDriverWait(chrome, 120.0).until(
            lambda b: b.execute_script('return document.documentElement.dataset.ready')
        )
        marks: dict[str, float] = chrome.execute_script(MARKS)
        zoom = float(chrome.execute_script(ZOOM))
        faults = [x for x in chrome.get_log('browser') if x['level'] != 'INFO']
        events: list[Any] = [
            json.loads(x['message'])['message'] for x in chrome.get_log('performance')
        ]
    asked = {
        x['params']['request']['url'] for x in events if x['method'] == 'Network.requestWillBeSent'
    }
    return marks, zoom, sum(not x.startswith(('data:', 'file:')) for x in asked), len(faults)


# Ten steps of zoom, each with all samples in view thinned anew and drawn.
ZOOM = """
const [name] = Object.keys(identPage.documents).filter((name) => name.endsWith('effort-plot'))
const [range] = identPage.models(name, 'Range1d').filter((range) => range.name === 'whole')
const start = performance.now(), width = range.end - range.start
for (let n = 1; n <= 10; n++) {
  range.setv({start: 0.01 * n * width, end: range.end})
  await new Promise((done) => requestAnimationFrame(() => setTimeout(done, 0)))
}
return (performance.now() - start) / 10
"""


def both(seconds: list[float]) -> str:
    """Return the shortest and the median time."""
    return f'{min(seconds):.2f}, {statistics.median(seconds):.2f}'


def main() -> None:
    """Measure, and print a table."""
    parser = argparse.ArgumentParser(description=__doc__.partition('\n')[0])
    parser.add_argument('directories', nargs='+', type=Path, metavar='DIR')
    parser.add_argument('--rounds', type=int, default=5)
    args = parser.parse_args()
    print(
        '| page | size | processor time to write it | first picture | all pictures | '
        'a step of zoom | requests | faults |'
    )
    print('| --- | --- | --- | --- | --- | --- | --- | --- |')
    with tempfile.TemporaryDirectory() as scratch:
        long = Path(scratch) / 'long'
        folders = [(folder.name, folder) for folder in args.directories]
        if (args.directories[0] / SIGNALS).exists():
            shutil.copytree(args.directories[0], long)
            lengthen(long)
            folders.append((f'{args.directories[0].name}, {LONG} samples a drive', long))
        for name, folder in folders:
            start = time.process_time()
            page = write_report(folder, Path(scratch) / 'page.html')
            took = time.process_time() - start
            rounds = [open_page(page) for _ in range(args.rounds)]
            first, every = (
                both([1e-3 * r[0][what] for r in rounds])
                for what in ('first picture', 'all pictures')
            )
            print(
                f'| {name} | {page.stat().st_size / 1e6:.2f} MB | {took:.1f} s | {first} s | '
                f'{every} s | {both([1e-3 * r[1] for r in rounds])} s | '
                f'{sum(r[2] for r in rounds)} | {sum(r[3] for r in rounds)} |',
                flush=True,
            )


if __name__ == '__main__':
    main()
