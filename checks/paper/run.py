# SPDX-License-Identifier: Apache-2.0
"""Run the paper's experiments again and write the page that compares them."""

from collections.abc import Callable
from pathlib import Path

import numpy as np

from checks.paper import figures, tripod_figures
from checks.paper.belt import (
    belt_machine,
    eigenfrequencies,
    identify,
    local_minima,
    OURS,
    PAPER_SETTINGS,
    step_reference,
    Trial,
    trial,
    TRUTH,
)
from checks.paper.page import belt_section, BeltFindings
from checks.paper.tripod_page import tripod_text, TripodFindings
from checks.paper.tripod_runs import Bench, Case, LOUD, Plan, tripod_trials
from ros2_ident.files import write_text
from ros2_ident.models.belt_drive.model import BeltDrive

HEAD = (
    '# The paper, run again\n\n'
    'What `python -m checks.paper` found; what it means: docs/paper.md.\n\n'
)


Progress = Callable[[float, str], None]
# Of the tripod, enough for a median and a range: each takes six identifications.
MOST_SEEDS = 10


def run(
    out_dir: str | Path, progress: Progress, *, seeds: int = 100, plan: Plan | None = None
) -> Path:
    """Rerun the paper's experiments; return the page on them.

    Args:
        out_dir: Folder for `paper.md` and, in `paper/`, its pictures; made where absent.
        progress: Takes the part that is done, 0 to 1, and what is being done.
        seeds: Repetitions behind every success rate; of the tripod at most `MOST_SEEDS`.
        plan: The tripod's log and settings; the paper's by default.
    """
    folder = Path(out_dir)
    pictures = folder / 'paper'
    pictures.mkdir(parents=True, exist_ok=True)
    belt = belt_findings(pictures, lambda part, text: progress(0.5 * part, text), seeds)
    tripod = tripod_findings(
        pictures,
        lambda part, text: progress(0.5 + 0.5 * part, text),
        min(seeds, MOST_SEEDS),
        plan or Plan(),
    )
    page = folder / 'paper.md'
    write_text(page, HEAD + belt_section(belt) + '\n' + tripod_text(tripod), replace=True)
    progress(1.0, f'{page} is written')
    return page


def belt_findings(pictures: Path, progress: Progress, seeds: int) -> BeltFindings:
    """Rerun section 3: Figs. 4 to 9 and the success rates behind them."""
    belt = BeltDrive(belt_machine(), *step_reference())
    progress(0.0, 'belt drive: figures 4 to 7')
    frequencies = figures.eigenfrequency(pictures / 'figure_4.png')
    figures.angle(pictures / 'figure_5.png', belt)
    largest = figures.torque(pictures / 'figure_6.png', belt, (0.0, 1.0))
    close = figures.torque(pictures / 'figure_7.png', belt, (0.2, 0.26))
    jobs = [*PAPER_SETTINGS.items(), (None, OURS)]
    rates: dict[tuple[int, float] | None, tuple[list[Trial], list[Trial]]] = {}
    done = 0
    for key, settings in jobs:
        what = f'{key[0]} survivors, distance {key[1]}' if key else 'our settings'
        both: tuple[list[Trial], list[Trial]] = [], []
        for anywhere, found in enumerate(both):
            for seed in range(seeds):
                found.append(trial(belt, settings, seed, anywhere=bool(anywhere)))
                done += 1
                text = f'belt drive: {what}' + (', truths anywhere' if anywhere else '')
                progress(done / (2 * len(jobs) * seeds), text)
        rates[key] = both
    # Fig. 8 is of a search that was trapped, Fig. 9 of one that was not.
    for number, survivors, success in ((8, 8, False), (9, 20, True)):
        runs = rates[survivors, 0.5][0]
        seed = next((i for i, t in enumerate(runs) if t.success == success), 0)
        one = identify(belt, TRUTH, PAPER_SETTINGS[survivors, 0.5], seed, record=True)
        title = f'{one.evaluations} candidates, {survivors} survivors, distance 0.5, seed {seed}'
        figures.cloud(pictures / f'figure_{number}.png', belt, one, title)
    return BeltFindings(
        frequencies=frequencies,
        modes=tuple(eigenfrequencies(belt, TRUTH[None, :])[0].tolist()),
        minima=local_minima(belt),
        largest_torque=largest,
        close_torque=close,
        rates=rates,
    )


def tripod_findings(pictures: Path, progress: Progress, seeds: int, plan: Plan) -> TripodFindings:
    """Rerun section 4: the trials and Figs. 11 to 13."""
    progress(0.0, 'tripod: the log')
    bench = Bench(plan)
    trials = tripod_trials(bench, seeds, progress)
    near, far = (trials[Case(LOUD, False, distance)][0] for distance in (0.0, 0.5))
    tripod_figures.candidates(pictures / 'figure_11.png', far, LOUD)
    dataset = bench.data(LOUD, 0).datasets[0]
    assert dataset.effort is not None
    simulated = bench.simulated(dataset, np.array([near.ga, far.ga]))
    found = {'d_min,0 = 0': simulated[0], 'd_min,0 = 0.5': simulated[1]}
    measured = dataset.effort[dataset.names.index('drive_1')]
    for number, window in ((12, (0.0, plan.seconds)), (13, plan.close)):
        path = pictures / f'figure_{number}.png'
        tripod_figures.torque(path, dataset.time, measured, found, window)
    log = bench.log.torque
    return TripodFindings(
        plan=plan,
        spans=np.stack([log.min(axis=1), log.max(axis=1)], axis=1),
        speeds=np.abs(bench.motion.velocity).max(axis=1),
        trials=trials,
        influence=bench.influence(),
    )
