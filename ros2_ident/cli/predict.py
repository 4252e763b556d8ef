# SPDX-License-Identifier: Apache-2.0
"""`ident predict`: how far what was found comes from a bag, run freely by its set-points."""

import argparse
from functools import partial
from typing import TYPE_CHECKING

from ros2_ident.cli.arguments import topics_of
from ros2_ident.errors import ErrorCode

if TYPE_CHECKING:
    from collections.abc import Sequence

    from matplotlib.figure import Figure

    from ros2_ident.prediction import Prediction, Run
    from ros2_ident.report.estimate import Estimate

JSON, PICTURE, FORMAT = 'prediction.json', 'prediction.png', 'ros2_ident.prediction'
# Of a log that is only simulated no windows are chosen.
_ALL = 10**12


def run(args: argparse.Namespace) -> int:
    """Simulate, print the table, write it."""
    from dataclasses import asdict

    from ros2_ident.cli.table import columns
    from ros2_ident.effects import add_effect_files
    from ros2_ident.files import make_directory, replacing, require_ours, write_json
    from ros2_ident.prediction import of_description, predicted
    from ros2_ident.report.estimate import read_estimate

    add_effect_files(args.effect)
    folder = make_directory(args.out) if args.out else None
    require_ours([folder / name for name in (JSON, PICTURE)] if folder else [])
    runs = {path: _runs(args, read_estimate(path)) for path in args.earlier}
    stages = [*of_description(runs[args.earlier[0]]), *runs.items()]
    found = predicted(', '.join(args.bag), stages, args.warm_up)
    if found.hindered:
        print(f'no free run: {found.hindered}')
        return 1
    rows = [('drive', 'quantity', 'unit', 'error', *(s.label for s in found.stages))]
    for row in found.rows:
        for name in ('rmse', 'mae'):
            numbers = [f'{getattr(e, name):.4g}' for e in row]
            rows.append((row[0].drive, row[0].quantity, row[0].unit, name.upper(), *numbers))
    columns(rows, '<<<<' + '>' * len(found.stages))
    if folder is not None:
        from matplotlib import rc_context

        content = {'format': FORMAT, 'warm_up': args.warm_up, **asdict(found)}
        write_json(folder / JSON, content)
        # Names and paths are no markup, whatever stands between two $.
        with replacing(folder / PICTURE) as file, rc_context({'text.parse_math': False}):
            _picture(found, stages).savefig(file, format='png', metadata={'format': FORMAT})
        print(f'written: {folder / JSON}, {folder / PICTURE}')
    return 0


def _picture(found: 'Prediction', stages: 'Sequence[tuple[str, Sequence[Run]]]') -> 'Figure':
    """Draw the quantity that shows most on the first recording, measured and simulated."""
    from matplotlib.figure import Figure

    drives = [row[0].drive for row in found.first]
    figure = Figure((8.0, 1.0 + 2.2 * len(drives)), dpi=110, layout='constrained')
    axes = figure.subplots(len(drives), 1, sharex=True, squeeze=False)[:, 0]
    for number, (label, runs) in enumerate(stages):
        model, theta = runs[0]
        free = model.free_run()
        assert free is not None
        simulated, time = free.simulate(theta[None])[0], free.data.time
        for k, output in enumerate(free.outputs):
            if output.quantity == found.quantity:
                place = axes[drives.index(output.place or output.name)]
                if not number:
                    place.plot(time, free.measured[k], '.', ms=2, c='#666666', label='measured')
                place.plot(time, simulated[k], lw=1.0, label=label)
    for place, row in zip(axes, found.first, strict=True):
        place.set_ylabel(f'{row[0].drive}\n{row[0].quantity} [{row[0].unit}]')
        place.grid(lw=0.5)
    names = [str(line.get_label()) for line in axes[0].lines]  # one with _ first would be left out
    axes[0].legend(axes[0].lines, names, loc='lower center', bbox_to_anchor=(0.5, 1.0), ncols=3)
    axes[-1].set_xlabel('time [s]')
    return figure


def _runs(args: argparse.Namespace, estimate: 'Estimate') -> 'list[Run]':
    """Return the machine's models on the bags, each with what was found."""
    import numpy as np

    from ros2_ident.cli.export import machine_behind
    from ros2_ident.identify.data import read_data
    from ros2_ident.identify.problem import at_rest
    from ros2_ident.models import make_model
    from ros2_ident.models.registry import follows, kind_of, scales_of

    machine = machine_behind(args, estimate)
    drives = estimate.drives or None
    # A position is all that a free run has to have beside what drives it.
    pushed = kind_of(machine).follows(machine) and not follows(machine)
    quantities = ('position',) if kind_of(machine).follows(machine) else None
    data = read_data(
        args.bag, machine, drives, topics=topics_of(args), samples=_ALL, quantities=quantities
    ).datasets
    machine, drives = at_rest(machine, data, drives)
    if not pushed and any(d.command_position is None for d in data):
        quantities = None
    make = partial(
        make_model, machine, drives=drives, scales=scales_of(machine, data),
        fixed=estimate.fixed, quantities=quantities,
    )  # fmt: skip
    effects = estimate.effects([p.name for p in make(data[0]).parameters])
    models = [make(d, effects=effects) for d in data]
    missing = [p.name for p in models[0].parameters if p.name not in estimate.values]
    if missing:
        raise ErrorCode.INVALID_GOAL.error(
            f'the result holds no {missing[0]}; give the machine file that it was found with'
        )
    theta = np.array([estimate.values[p.name] for p in models[0].parameters])
    return [(model, theta) for model in models]
