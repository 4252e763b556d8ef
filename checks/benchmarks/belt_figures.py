# SPDX-License-Identifier: Apache-2.0
r"""Figures 4 and 9 of the paper from a bag: what `ident identify`, or the node, found in it.

Figure 9 shows every candidate of the search with its cost on the bag; the line beneath is the cost
along EA of the same set-points without noise. Figure 4 is drawn with the EA and P that were found.

    ident simulate build/belt --machine config/belt_drive.yaml --motion steps --seconds 1 \
        --clean --set axial_stiffness=2e5 --set position_gain=45
    ident identify build/belt --machine config/belt_drive.yaml --population 1000 \
        --survivors 20 --min-distance 0.5 --no-refine --out build/belt_result
    python checks/benchmarks/belt_figures.py build/belt build/belt_result --out build
"""

import argparse
from pathlib import Path

import numpy as np

from checks.paper import figures
from checks.paper.belt import belt_machine, Trial, TRUTH
from ros2_ident.identify.data import read_data
from ros2_ident.models.belt_drive.model import RecordedBelt
from ros2_ident.report.files import load_result


def main():
    """Draw both and say what was found."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('bag')
    parser.add_argument('result', type=Path)
    parser.add_argument('--out', type=Path, default=Path('.'))
    parser.add_argument('--name', default='bag', help='in the names of the pictures')
    args = parser.parse_args()
    machine = belt_machine()
    model = RecordedBelt(machine, read_data([args.bag], machine).datasets[0])
    result = load_result(args.result)
    tried = result.history.candidates
    costs = model.costs(tried)  # eq. 2; the search itself gives up who cannot survive
    best = int(np.argmin(costs))
    trial = Trial(TRUTH, tried[best], float(costs[best]), len(costs), tried, costs)
    title = f'{trial.evaluations} candidates of {Path(args.bag).name}, from its topics'
    figures.cloud(args.out / f'figure_9_{args.name}.png', model.belt, trial, title)
    ends = figures.eigenfrequency(args.out / f'figure_4_{args.name}.png', trial.found)
    errors = ', '.join(f'{100.0 * e:.3f} %' for e in trial.error)
    print(f'EA = {trial.found[0]:.0f} N, P = {trial.found[1]:.4f} Nm/rad, off by {errors}')
    print(f'{trial.evaluations} candidates; first mode {ends[0]:.1f} to {ends[1]:.1f} Hz')


if __name__ == '__main__':
    main()
