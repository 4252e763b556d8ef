# SPDX-License-Identifier: Apache-2.0
"""From a goal to a request: everything a run needs, checked before it starts."""

from collections.abc import Callable, Sequence
from dataclasses import fields, replace
import math
from typing import Any

from ros2_ident_msgs.action import Diagnose, Diff, Identify
import yaml

from ros2_ident.effects import get_effect
from ros2_ident.errors import ErrorCode, IdentError
from ros2_ident.files import read_small
from ros2_ident.identify.data import chosen_drives
from ros2_ident.identify.layout import read_conditions
from ros2_ident.identify.outputs import QUANTITIES, read_outputs
from ros2_ident.identify.settings import IdentifySettings
from ros2_ident.jobs import knowing
from ros2_ident.models import load_machine, Machine
from ros2_ident.models.new_file import arm_kind, new_machine_file
from ros2_ident.models.registry import machine_from_mapping
from ros2_ident.recording import Recording, Stream, Topics
from ros2_ident.ros.parameters import BY_NAME, check_path, Snapshot
from ros2_ident.ros.run import allowed, Wanted
from ros2_ident.search import Budget, GeneticSettings
from ros2_ident.threads import processors

_SEARCH = 'initial_population', 'survivors', 'children', 'generations', 'range_reduction'
# Fields that not every goal has, and what stands for nothing.
_NOT_OF_ALL: dict[str, Any] = {
    'check_bag_path': '', 'more_check_bag_paths': (), 'each': (), 'differences_file': '',
    'time_budget': 0.0, 'without_effects': (),
}  # fmt: skip
_refuse = ErrorCode.INVALID_GOAL.error


def wanted_of(
    goal: Any,
    parameters: Snapshot,
    *,
    receiving: bool = False,
    heard: str | None = None,
    states: Callable[[], Stream | None] = lambda: None,
) -> Wanted:
    """Return what a goal asks for, with the node's parameters where it says nothing.

    Args:
        receiving: Whether messages arrive that must not wait for the simulation.
        heard: URDF or MJCF that was heard, for where no file says what the robot is.

    Raises:
        IdentError: INVALID_GOAL, also where no results can be written, NO_DATA,
            UNKNOWN_PARAMETER, also for a strange effect, or what is wrong with the machine file.
    """
    _check_ranges(goal)
    check_path('output_directory', parameters['output_directory'])
    own, text = _machine(goal, parameters, heard, states)
    machine = own.described(heard)
    drives = tuple(goal.drives) or tuple(parameters['drives']) or None
    fixed, bounds = _overrides(goal, machine)
    bag_topics = (parameters[f'bag_topics.{role}'] for role in ('state', 'effort', 'command'))
    asked = {name: getattr(goal, name, nothing) for name, nothing in _NOT_OF_ALL.items()}
    differences = _paths(asked['differences_file'], (), 'differences_file', parameters)
    check = asked['check_bag_path'], asked['more_check_bag_paths']
    for name in asked['without_effects']:
        get_effect(name)
    wanted = Wanted(
        machine=machine,
        machine_file=goal.machine_file or parameters['machine_file'],
        bags=() if isinstance(goal, Diff.Goal) else _bag_paths(goal, parameters),
        check=_paths(*check, 'check_bag_path', parameters),
        drives=chosen_drives(machine, drives),
        topics=Topics(*bag_topics, names=parameters['joint_names']),
        conditions=read_conditions(tuple(asked['each']), *(differences or (None,))),
        fixed=fixed,
        bounds=bounds,
        without=tuple(asked['without_effects']),
        seed=goal.seed or parameters['seed'],
        machine_text=text,
        output_directory=parameters['output_directory'],
        description=None if machine is own else heard,
        preview_rate=parameters['preview_rate'],
    )
    budget = Budget(seconds=asked['time_budget'] or parameters['time_budget'] or None)
    threads = parameters['workers'] or max(1, processors() - receiving)
    settings = IdentifySettings(budget=budget, threads=threads)
    more = {Identify.Goal: _of_identify, Diagnose.Goal: _of_diagnose, Diff.Goal: _of_diff}
    wanted = replace(wanted, **more[type(goal)](goal, parameters, machine, settings))
    earlier = _paths(goal.from_result, (), 'from_result', parameters)
    return knowing(wanted, *earlier) if earlier else wanted


def _of_identify(
    goal: Any, parameters: Snapshot, machine: Machine, settings: IdentifySettings
) -> dict[str, Any]:
    if goal.model and goal.model != machine.kind:
        raise _refuse(
            f'model is {goal.model!r} and the machine file describes a {machine.kind}; '
            'leave model empty or give another machine file'
        )
    genetic = {x.name: parameters[x.name] for x in fields(GeneticSettings) if x.name in BY_NAME}
    genetic |= {x: getattr(goal, x) for x in _SEARCH if getattr(goal, x)}
    if goal.min_distance:
        genetic['min_distance'] = max(0.0, goal.min_distance)
    evaluations = goal.evaluation_budget or parameters['evaluation_budget'] or None
    try:
        settings = replace(
            settings,
            genetic=GeneticSettings(**genetic),
            budget=replace(settings.budget, evaluations=evaluations),
            refine=goal.refine,
        )
    except IdentError as error:
        raise _refuse(error.message) from None
    return {'settings': settings, 'outputs': read_outputs(tuple(goal.outputs))}


def _of_diff(
    goal: Any, parameters: Snapshot, machine: Machine, settings: IdentifySettings
) -> dict[str, Any]:
    bags = _paths(goal.bag_path, goal.more_bag_paths, 'bag_path', parameters)
    if not bags:
        raise _refuse('bag_path is empty; give the path of a bag from before')
    return {
        'settings': settings,
        'bags': bags,
        'later': _bag_paths(goal, parameters, 'after_bag_path'),
        'paired': goal.pairs,
    }


def _of_diagnose(
    goal: Any, parameters: Snapshot, machine: Machine, settings: IdentifySettings
) -> dict[str, Any]:
    if goal.output and goal.output not in QUANTITIES:
        raise _refuse(f'output is {goal.output!r}; choose from {", ".join(QUANTITIES)}')
    return {'settings': settings, 'outputs': {goal.output: None} if goal.output else None}


def _check_ranges(goal: Any) -> None:
    """Refuse numbers of a goal that the parameter of the same name could not have."""
    for name in goal.get_fields_and_field_types():
        entry = BY_NAME.get(name)
        value = getattr(goal, name)
        if entry is None or entry.low is None or not value:
            continue  # 0 stands for the parameter's value
        low = -math.inf if name == 'min_distance' else entry.low  # negative: none
        if not low <= value <= entry.high:
            raise _refuse(f'{name} is {value}, its range is {entry.range}; give one inside it')


def _machine(
    goal: Any, parameters: Snapshot, heard: str | None, states: Callable[[], Stream | None]
) -> tuple[Machine, str]:
    if goal.machine_file or parameters['machine_file']:
        directory = parameters['allowed_directory'] if goal.machine_file else ''
        path = allowed(goal.machine_file or parameters['machine_file'], directory, there=False)
        machine = load_machine(path)  # says what is wrong, also where there is none
        text = read_small(path).decode()
    elif heard is None:
        raise _refuse(
            'no machine file is given, and no robot_description was heard; set the parameter '
            'machine_file, name one in the goal, or start robot_state_publisher'
        )
    elif goal.data_source == goal.DATA_SOURCE_BAG or (motion := states()) is None:
        raise _refuse(
            'no machine file is given, and a robot_description takes its place only beside live '
            'joint_states; make one with `ident new-machine --description --bag`'
        )
    else:
        text = new_machine_file(arm_kind(False), description=heard, log=Recording(motion))
        machine = machine_from_mapping(yaml.safe_load(text), 'robot_description')
    return machine, text


def _bag_paths(goal: Any, parameters: Snapshot, field: str = 'bag_path') -> tuple[str, ...]:
    """Return the paths of the bags in a field and the next; none if live."""
    path = getattr(goal, field)
    if goal.data_source not in (goal.DATA_SOURCE_LIVE, goal.DATA_SOURCE_BAG):
        raise _refuse(f'data_source is {goal.data_source}; give 0 (live) or 1 (bag)')
    from_bag = goal.data_source == goal.DATA_SOURCE_BAG
    if from_bag and not path:
        raise _refuse(f'data_source is 1 (bag) and {field} is empty; give the path of a bag')
    if path and not from_bag:
        raise _refuse(f'{field} is given and data_source is 0 (live); set it to 1 to read the bag')
    return _paths(path, getattr(goal, f'more_{field}s'), field, parameters)


def _paths(first: str, more: Sequence[str], field: str, parameters: Snapshot) -> tuple[str, ...]:
    """Return the paths of bags, which have to exist; the first may be empty where it is alone."""
    if more and not first:
        raise _refuse(f'more_{field}s has paths and {field} is empty; put the first one there')
    directory = parameters['allowed_directory']
    return tuple(str(allowed(path, directory)) for path in (first, *more) if path)


def _overrides(
    goal: Any, machine: Machine
) -> tuple[dict[str, float], dict[str, tuple[float, float]]]:
    """Return the parameters that are held, and the bounds that differ from the machine file's."""
    names = list(goal.override_names)
    if len(set(names)) != len(names):
        raise _refuse('override_names repeats a name; give each only once')
    lower = _column(goal, 'override_lower', len(names))
    upper = _column(goal, 'override_upper', len(names))
    held = _column(goal, 'override_fixed', len(names))
    fixed, bounds = {}, {}
    for name, low, high, value in zip(names, lower, upper, held, strict=True):
        declared = machine.bounds.get(name) or machine.bounds.get(name.rpartition('.')[2])
        if declared is None:
            raise ErrorCode.UNKNOWN_PARAMETER.error(
                f'override_names has {name!r}, no such parameter; choose from '
                f'{", ".join(machine.bounds)}, or one of a drive as {machine.drives[0]}.NAME'
            )
        if math.isnan(low) and math.isnan(high) and math.isnan(value):
            raise _refuse(f'{name} is in override_names and no value is given for it; give one')
        if not math.isnan(value):
            fixed[name] = value
        if not (math.isnan(low) and math.isnan(high)):
            bounds[name] = (
                declared[0] if math.isnan(low) else low,
                declared[1] if math.isnan(high) else high,
            )
    return fixed, bounds


def _column(goal: Any, field: str, count: int) -> Sequence[float]:
    values = list(getattr(goal, field, ()))  # a diagnosis has no bounds
    if values and len(values) != count:
        raise _refuse(
            f'{field} has {len(values)} values and override_names {count} names; '
            'give one value for each name, or none'
        )
    return values or [math.nan] * count
