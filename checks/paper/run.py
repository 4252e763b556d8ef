# SPDX-License-Identifier: Apache-2.0
"""Run the paper's experiments again and write the page that compares them."""

from collections.abc import Callable
from pathlib import Path

from checks.paper import figures
from checks.paper.belt import (
    belt_machine,
    eigenfrequencies,
    identify,
    local_minima,
    OURS,
    PAPER_SETTINGS,
    step_reference,
    Trial,
    trials,
    TRUTH,
)
from checks.paper.page import belt_section, BeltFindings
from checks.paper.tripod import tripod_section
from ros2_ident.files import write_text
from ros2_ident.models.belt_drive.model import BeltDrive

HEAD = (
    '# The paper, run again\n\n'
    'What `python -m checks.paper` found; what it means: docs/paper.md.\n\n'
)


def nothing(fraction: float, text: str) -> None:
    """Ignore progress."""


def run(
    out_dir: str | Path,
    progress: Callable[[float, str], None] = nothing,
    *,
    seeds: int = 100,
) -> Path:
    """Rerun the paper's experiments.

    Args:
        out_dir: Folder for `paper.md` and, in `paper/`, its pictures; made where absent.
        progress: Takes the part that is done, 0 to 1, and what is being done.
        seeds: Repetitions behind every success rate.
    """
    folder = Path(out_dir)
    pictures = folder / 'paper'
    pictures.mkdir(parents=True, exist_ok=True)
    belt = belt_findings(pictures, lambda part, text: progress(0.5 * part, text), seeds=seeds)
    tripod = tripod_section(
        pictures, lambda part, text: progress(0.5 + 0.5 * part, text), seeds=seeds
    )
    page = folder / 'paper.md'
    write_text(page, HEAD + belt_section(belt) + '\n' + tripod, replace=True)
    progress(1.0, f'{page} is written')
    return page


def belt_findings(
    pictures: Path, progress: Callable[[float, str], None], *, seeds: int = 100
) -> BeltFindings:
    """Rerun section 3: Figs. 4 to 9 and the success rates behind them.

    Args:
        progress: Takes the part of this section that is done, 0 to 1, and what is being done.
        seeds: Repetitions behind every success rate.
    """
    belt = BeltDrive(belt_machine(), *step_reference())
    progress(0.0, 'belt drive: figures 4 to 7')
    frequencies = figures.eigenfrequency(pictures / 'figure_4.png')
    figures.angle(pictures / 'figure_5.png', belt)
    largest = figures.torque(pictures / 'figure_6.png', belt, (0.0, 1.0))
    close = figures.torque(pictures / 'figure_7.png', belt, (0.2, 0.26))
    jobs = [(key, settings) for key, settings in PAPER_SETTINGS.items()] + [(None, OURS)]
    rates: dict[tuple[int, float] | None, tuple[list[Trial], list[Trial]]] = {}
    total = 2 * len(jobs) * seeds
    for number, (key, settings) in enumerate(jobs):
        what = (
            'belt drive: our settings'
            if key is None
            else (f'belt drive: {key[0]} survivors, distance {key[1]}')
        )

        def middle(done: int, base: int = 2 * number * seeds, what: str = what) -> None:
            progress((base + done) / total, what)

        def anywhere(done: int, base: int = (2 * number + 1) * seeds, what: str = what) -> None:
            progress((base + done) / total, what + ', truths anywhere')

        rates[key] = (
            trials(belt, settings, seeds, middle),
            trials(belt, settings, seeds, anywhere, anywhere=True),
        )
    trapped = next((i for i, t in enumerate(rates[8, 0.5][0]) if not t.success), None)
    found = next((i for i, t in enumerate(rates[20, 0.5][0]) if t.success), None)
    for number, survivors, seed in ((8, 8, trapped or 0), (9, 20, found or 0)):
        trial = identify(belt, TRUTH, PAPER_SETTINGS[survivors, 0.5], seed, record=True)
        title = f'{trial.evaluations} candidates, {survivors} survivors, distance 0.5, seed {seed}'
        figures.cloud(pictures / f'figure_{number}.png', belt, trial, title)
    return BeltFindings(
        frequencies=frequencies,
        modes=tuple(eigenfrequencies(belt, TRUTH[None, :])[0].tolist()),
        minima=local_minima(belt),
        largest_torque=largest,
        close_torque=close,
        rates=rates,
        trapped_seed=trapped,
        found_seed=found,
    )
