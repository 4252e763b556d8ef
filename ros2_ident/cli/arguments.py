# SPDX-License-Identifier: Apache-2.0
"""Arguments of the commands: from their table, `commands.yaml`, to parsers and to requests."""

import argparse
from collections.abc import Callable, Mapping
from dataclasses import fields, replace
from importlib import import_module
import math
from pathlib import Path
from typing import Any

import yaml

from ros2_ident.errors import ErrorCode

_TABLE = yaml.load(
    Path(__file__).with_name('commands.yaml').read_text(encoding='utf-8'),
    getattr(yaml, 'CSafeLoader', yaml.SafeLoader),  # noqa: S506 - both are safe
)
# Commands by name. The module of that name has run(args), which imports what is slow.
COMMANDS: Mapping[str, Mapping[str, Any]] = _TABLE['commands']


def _read(text: str) -> float:
    """Return a number; NaN where the text is none."""
    try:
        return float(text)
    except ValueError:
        return math.nan


def _kind(fits: Callable[[float], bool], what: str, *, integer: bool = False) -> Any:
    """Return a type of arguments: numbers that fit, and what is said of others."""

    def read(text: str) -> float:
        value = _read(text)
        if not (math.isfinite(value) and fits(value)) or (integer and not text.strip().isdigit()):
            raise argparse.ArgumentTypeError(f'{text!r} has to be {what}')
        return int(text) if integer else value

    return read


positive = _kind(lambda x: x > 0.0, 'a number above 0')
not_negative = _kind(lambda x: x >= 0.0, 'a number of at least 0')
number = _kind(lambda x: x != 0.0, 'a number other than 0')
count = _kind(lambda x: x >= 1, 'a whole number of at least 1', integer=True)
whole = _kind(lambda x: x >= 0, 'a whole number of at least 0', integer=True)


def names(text: str) -> tuple[str, ...]:
    """Return the names of a list with commas."""
    found = tuple(part.strip() for part in text.split(','))
    if not all(found):
        raise argparse.ArgumentTypeError(
            f'{text!r} holds an empty name; write them as drive_1,drive_2'
        )
    return found


def _named(text: str, count: int, form: str) -> tuple[str, list[float]]:
    name, _, given = text.partition('=')
    numbers = [_read(x) for x in given.split(':')]
    if not name or len(numbers) != count or not all(map(math.isfinite, numbers)):
        raise argparse.ArgumentTypeError(f'{text!r} has to be {form}')
    return name, numbers


def assignment(text: str) -> tuple[str, float]:
    """Return name and value of `tool_mass=1.4`."""
    name, (value,) = _named(text, 1, 'NAME=VALUE, as tool_mass=1.4')
    return name, value


def interval(text: str) -> tuple[str, tuple[float, float]]:
    """Return name and bounds of `tool_mass=1:2`."""
    name, (low, high) = _named(text, 2, 'NAME=LOW:HIGH, as tool_mass=1:2')
    return name, (low, high)


def once(pairs: list[tuple[str, Any]], option: str) -> dict[str, Any]:
    """Return pairs as a dictionary.

    Raises:
        IdentError: INVALID_GOAL where a name comes twice.
    """
    found: dict[str, Any] = {}
    for name, value in pairs:
        if name in found:
            raise ErrorCode.INVALID_GOAL.error(f'{option} names {name} twice; give it one value')
        found[name] = value
    return found


def add_arguments(parser: argparse.ArgumentParser, own: Mapping[str, Any]) -> None:
    """Add the arguments of a command, as `commands.yaml` has it."""
    parser.set_defaults(**own.get('without', {}))
    groups: list[tuple[Any, Mapping[str, Any]]] = [(parser, own['arguments'])]
    for title, arguments in own.get('groups', {}).items():
        groups.append((parser.add_argument_group(title), arguments or _TABLE['groups'][title]))
    for group, arguments in groups:
        one_of: Any = None
        for flag, said in arguments.items():
            options = {**_TABLE['shared'].get(flag, {}), **(said or {})}
            place = group
            if options.pop('exclusive', False):
                place = one_of = one_of or group.add_mutually_exclusive_group()
            if 'type' in options:
                options['type'] = globals()[options['type']]
            if isinstance(options.get('choices'), str):
                module, _, name = options['choices'].rpartition('.')
                options['choices'] = tuple(getattr(import_module(module), name))
            if options.get('action') == 'append':
                options['default'] = []
            elif isinstance(options.get('default'), list):
                options['default'] = tuple(options['default'])
            place.add_argument(flag, **options)


def topics_of(args: argparse.Namespace) -> Any:
    """Return the topics of parsed arguments."""
    from ros2_ident.recording import Topics

    topics = args.state_topic, args.effort_topic, args.command_topic
    return Topics(*topics, args.columns, args.joint_names, position_unit=args.position_unit)


def effort_of(args: argparse.Namespace) -> dict[str, Any]:
    """Return the effort unit of parsed arguments, as fields of a machine; none where not given.

    Raises:
        IdentError: WRONG_UNITS for a unit that lacks its constant.
    """
    from ros2_ident.machine.units import effort_factors

    unit, constants = args.effort_unit, (args.torque_constant, args.rated_torque)
    if unit is not None:
        return {'effort_unit': unit, 'effort_scale': effort_factors(unit, *constants)}
    if any(constants):
        raise ErrorCode.WRONG_UNITS.error(
            'a torque constant or rated torque is given without its unit; add `--effort-unit A` '
            'or `--effort-unit percent`'
        )
    return {}


def with_effort(machine: Any, args: argparse.Namespace) -> Any:
    """Return a machine with the effort unit of parsed arguments; raises as `effort_of`."""
    return replace(machine, **effort_of(args))


def wished(args: argparse.Namespace) -> dict[str, Any]:
    """Return what the bags of a fleet are asked alike, as fields of a `jobs.Request`."""
    from ros2_ident.identify.layout import read_conditions

    return {
        'topics': topics_of(args),
        'conditions': read_conditions(args.each, args.differences),
        'fixed': once(args.fix, '--fix'),
        'seed': args.seed,
    }


def searched(args: argparse.Namespace) -> dict[str, Any]:
    """Return how an identification searches and compares, as fields of a `jobs.Request`."""
    from ros2_ident.identify.outputs import read_outputs
    from ros2_ident.identify.settings import IdentifySettings
    from ros2_ident.search import Budget, GeneticSettings

    given = {name: value for name, value in vars(args).items() if value is not None}

    def of(kind: Any) -> dict[str, Any]:
        return {x.name: given[x.name] for x in fields(kind) if x.name in given}

    settings = IdentifySettings(
        **of(IdentifySettings),
        genetic=GeneticSettings(**of(GeneticSettings)),
        budget=Budget(evaluations=args.evaluations, seconds=args.seconds),
        refine=not args.no_refine,
    )
    return {
        'bounds': once(args.bounds, '--bounds'),
        'outputs': read_outputs(args.outputs),
        'settings': settings,
        **({} if args.samples is None else {'samples': args.samples}),
    }


def asked(args: argparse.Namespace) -> dict[str, Any]:
    """Return what commands on bags ask alike, as fields of a `jobs.Request`.

    Raises:
        IdentError: As `load_machine`; WRONG_UNITS for a unit that lacks its constant.
    """
    from ros2_ident.models import load_machine
    from ros2_ident.search import Threads
    from ros2_ident.search.evaluators import Cluster

    return {
        'machine': with_effort(load_machine(args.machine), args),
        'machine_file': str(args.machine),
        'bags': tuple(str(bag) for bag in args.bag),
        'check': tuple(str(bag) for bag in args.check),
        'drives': args.drives,
        **wished(args),
        'workers': Threads(args.threads) if args.scheduler is None else Cluster(args.scheduler),
    }
