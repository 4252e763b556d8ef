# SPDX-License-Identifier: Apache-2.0
"""`ident simulate`: a bag of a machine whose parameters are known."""

import argparse
from collections.abc import Sequence
import json
import re
import shlex
from typing import TYPE_CHECKING

from ros2_ident.cli.arguments import once
from ros2_ident.errors import ErrorCode

if TYPE_CHECKING:
    from ros2_ident.models import Machine

QUARTER = 0.25


def run(args: argparse.Namespace) -> int:
    """Simulate, write, print the truth."""
    from dataclasses import replace

    from ros2_ident.effects import add_effect_files

    # Before the simulations are composed of the effects there are.
    names = [re.split('[@:]', text)[0] for text in args.effect]
    add_effect_files([name for name in names if name.endswith('.py')])
    from ros2_ident.cli.table import columns
    from ros2_ident.models import load_machine
    from ros2_ident.models.registry import kind_of, planned_model
    from ros2_ident.recording.write import require_room, write_bag
    from ros2_ident.simulate.bag import CLEAN, nuisance_of, read_effect, simulate_bag
    from ros2_ident.simulate.motions import draw_motion

    require_room(args.bag)
    machine = load_machine(args.machine)
    motion = draw_motion(args.motion, machine, args.seconds, args.seed)
    model = planned_model(machine, motion.position, motion.velocity)
    truth = _truth(machine, once(args.set, '--set'), model.described)
    effects = [read_effect(text) for text in args.effect]
    nuisance = CLEAN if args.clean else nuisance_of(machine)
    if args.noise is not None:
        nuisance = replace(nuisance, effort_noise=args.noise, effort_step=0.2 * args.noise)
    bag = simulate_bag(machine, truth, motion, args.seed, nuisance, effects)
    notes = {
        'command': shlex.join(['ident', *args.words]),
        'parameters': json.dumps({**truth, **bag.log.effects}),
    }
    path = write_bag(args.bag, bag.streams, custom=notes)
    units = {key.name: key.unit for key in kind_of(machine).keys}
    units |= {name: unit for name, (_, _, unit) in machine.bounds.items()}
    rows = [(name, f'{value:.6g}', _unit(units, name)) for name, value in truth.items()]
    rows += [(name, f'{value:.6g}', '') for name, value in bag.log.effects.items()]
    columns(rows, '<><')
    print(f'written: {path}, {motion.seconds:.4g} s of the motion {args.motion}')
    return 0


def _unit(units: dict[str, str], name: str) -> str:
    """Return the unit of a parameter; `elbow.link_moment_x` has that of `link_moment`."""
    tail = name.rpartition('.')[2]
    return units.get(tail) or units[tail.rpartition('_')[0]]


def _truth(
    machine: 'Machine', given: dict[str, float], described: Sequence[str]
) -> dict[str, float]:
    """Return the true parameters by name; per drive where one drive differs.

    What is `described` is so unless it is given, as elbow.link_mass or elbow.link_moment_x.
    """
    from ros2_ident.models.drives.candidates import SLOTS
    from ros2_ident.models.registry import kind_of
    from ros2_ident.recording.limits import listed

    truth = {name: value for name, value in given.items() if name in described}
    left = {name: value for name, value in given.items() if name not in truth}
    free = [name for name in machine.bounds if name not in kind_of(machine).described]
    for name in free:
        low, high, _ = machine.bounds[name]
        value = left.pop(name, low + QUARTER * (high - low))
        slot = SLOTS.get(name)
        own = {d: left.pop(f'{d}.{name}') for d in machine.drives if f'{d}.{name}' in left}
        if own and slot is not None and not slot.shared:
            truth |= {f'{drive}.{name}': own.get(drive, value) for drive in machine.drives}
        elif not own:
            truth[name] = value
        else:
            left |= {f'{drive}.{name}': value for drive in own}
    if left:
        raise ErrorCode.UNKNOWN_PARAMETER.error(
            f'{next(iter(left))!r} cannot be set: no such parameter; '
            f'choose from {listed([*free, *described])}'
        )
    return truth
