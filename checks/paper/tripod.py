# SPDX-License-Identifier: Apache-2.0
"""Section 4 of the paper: the tripod drive identified with Table 4's settings."""

from collections.abc import Callable
from pathlib import Path

import numpy as np

from checks.paper import tripod_figures as figures
from checks.paper.tripod_page import tripod_text, TripodFindings
from checks.paper.tripod_runs import Bench, Case, LOUD, Plan, tripod_trials

# Enough for a median and a range; each seed takes six identifications of several seconds.
MOST_SEEDS = 10


def tripod_section(
    pictures: Path,
    progress: Callable[[float, str], None],
    *,
    seeds: int = MOST_SEEDS,
    plan: Plan | None = None,
) -> str:
    """Run section 4 and return its part of the page.

    Args:
        pictures: Folder for the pictures of Figs. 11 to 13; exists.
        progress: Takes the part of this section that is done, 0 to 1, and a short text.
        seeds: Draws of noise, each with a search of its own; more than `MOST_SEEDS` are not run.

    Returns:
        Markdown from its `##` heading on; pictures are referred to as `paper/NAME.png`.
    """
    return tripod_text(
        tripod_findings(pictures, progress, seeds=min(seeds, MOST_SEEDS), plan=plan)
    )


def tripod_findings(
    pictures: Path,
    progress: Callable[[float, str], None],
    *,
    seeds: int = MOST_SEEDS,
    plan: Plan | None = None,
) -> TripodFindings:
    """Rerun section 4: the trials and Figs. 11 to 13.

    Args:
        progress: Takes the part of this section that is done, 0 to 1, and what is being done.
        seeds: Draws of noise, each with a search of its own.
    """
    progress(0.0, 'tripod: the log')
    bench = Bench(plan or Plan())
    trials = tripod_trials(bench, seeds, progress)
    near, far = (trials[Case(LOUD, False, distance)][0] for distance in (0.0, 0.5))
    figures.candidates(pictures / 'figure_11.png', far, LOUD)
    dataset = bench.data(LOUD, 0).datasets[0]
    assert dataset.effort is not None
    simulated = bench.simulated(dataset, np.array([near.ga, far.ga]))
    found = {'d_min,0 = 0': simulated[0], 'd_min,0 = 0.5': simulated[1]}
    measured = dataset.effort[dataset.names.index('drive_1')]
    for number, window in ((12, (0.0, bench.plan.seconds)), (13, bench.plan.close)):
        path = pictures / f'figure_{number}.png'
        figures.torque(path, dataset.time, measured, found, window)
    log = bench.log.torque
    return TripodFindings(
        plan=bench.plan,
        spans=np.stack([log.min(axis=1), log.max(axis=1)], axis=1),
        speeds=np.abs(bench.motion.velocity).max(axis=1),
        trials=trials,
        influence=bench.influence(),
    )
