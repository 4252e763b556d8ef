# SPDX-License-Identifier: Apache-2.0
"""The whole check: exports, simulators asked, and the page on what they answered."""

from collections.abc import Iterator, Sequence
from datetime import date
import json
from pathlib import Path
from typing import Any

import numpy as np

from checks.share import table
from checks.simulators.cases import Case, cases, follower, MOTION, WHOLE
from checks.simulators.peers import asked, PEERS, robots
from ros2_ident.arrays import Array
from ros2_ident.errors import IdentError
from ros2_ident.export.targets import fitting, SUMMARY, TARGETS, write
from ros2_ident.files import make_directory, mark, write_text
from ros2_ident.models.drives.joints import PARTS

# What has to be reached where a target can hold the values: shares of our own.
TORQUE, TRAVEL = 0.01, 0.02


def run(out: str | Path, names: Sequence[str], python: str, device: str) -> Path:
    """Run the check.

    Args:
        out: Directory of it all.
        names: Of `PEERS`.
        python: The interpreter that environments are made of.
        device: Of those that run on CUDA, too.

    Returns:
        The page.
    """
    folder = make_directory(out).resolve()
    machines = cases(make_directory(folder / 'cases'), robots(folder / 'env/data', python))
    folders, told = {}, dict[str, Any]()
    pair = follower(folder / 'cases')
    for case in (*machines, pair):
        folders[case.name] = folder / 'exports' / case.name.replace(' ', '_').lower()
        told[case.name] = exported(case, folders[case.name], names)
    answers, ours = {}, {}
    for name in names:
        for case in machines:
            for of in (_holds(name, case), frozenset(WHOLE)):
                if (case.name, of) not in ours:
                    ours[case.name, of] = _ours(case, of)
        request = [_request(c, folders[c.name], ours[c.name, _holds(name, c)]) for c in machines]
        request.append(_following(folders[pair.name]))
        try:
            answers[name] = asked(name, folder / 'env' / name, python, device, request)
        except IdentError as error:
            answers[name] = {'version': '', 'cells': {}, 'not_run': error.message}
    rows = [row for name in names for row in _rows(name, answers[name], machines, ours)]
    head = {'schema': 'ros2_ident.simulators', 'device': device}
    figures = head | {'rows': rows, 'exports': told}
    write_text(folder / 'figures.json', json.dumps(figures, indent=1) + '\n')
    return write_text(folder / 'simulators.md', page(rows, told['KR 300'], device))


def exported(case: Case, folder: Path, names: Sequence[str]) -> dict[str, Any]:
    """Write all that fits a machine, and return its `export.json`.

    Raises:
        IdentError: INVALID_GOAL with the remedy where one of the simulators' own does not fit.
    """
    own = (PEERS[name].target for name in names)
    fit = dict.fromkeys((*fitting(case.content, case.description), *own))
    write(folder, tuple(fit), case.content, case.description)
    told: dict[str, Any] = json.loads((folder / SUMMARY).read_text('utf-8'))
    return told


def _holds(name: str, case: Case) -> frozenset[str]:
    """Return what of a machine a simulator has a place for."""
    target = PEERS[name].target
    beside = 'mjcf_effects' if name == 'mujoco' and case.content.laws else target
    return frozenset(TARGETS[beside].holds) & {*WHOLE}


def _ours(case: Case, holds: frozenset[str]) -> dict[str, Array]:
    """Return torques and motions by our own model, of the joints' parts those of `holds`."""
    still, states = np.zeros_like(case.still), case.states.transpose(1, 0, 2)
    return {
        'torque': np.array([case.torque(state[0], state[1], state[2], holds) for state in states]),
        'decay': case.motion(case.still, case.fast, gravity=False, of=holds),
        'swing': case.motion(case.still, still, gravity=True, of=holds),
    }


def _request(case: Case, folder: Path, ours: dict[str, Array]) -> dict[str, Any]:
    """Return what `runs/common.py` is asked; accelerations are judged where they should be."""
    numbers = {'states': case.states, 'still': case.still, 'fast': case.fast}
    numbers['torque'] = ours['torque']
    return {
        'name': case.name,
        'folder': str(folder),
        'seconds': MOTION,
        'joints': case.joints,
        **{name: values.tolist() for name, values in numbers.items()},
    }


def _following(folder: Path) -> dict[str, Any]:
    """Return the question how a joint follows another one; see `FOLLOWER`."""
    return {
        'name': 'follower',
        'folder': str(folder),
        'seconds': MOTION,
        'joints': ['lead', 'follow'],
        'states': np.ones((3, 1, 2)).tolist(),
        'torque': [[1.0, 1.0]],
        'still': [0.0, 0.1],
        'fast': [1.0, -2.0],
    }


def _rows(
    name: str, answer: dict[str, Any], machines: Sequence[Case], ours: dict[Any, dict[str, Array]]
) -> Iterator[dict[str, Any]]:
    """Yield what one simulator makes of each machine.

    Of torques and motions two shares of ours: how far off they are, and how far off they would be
    were there nothing but what the target has a place for.
    """
    for case in machines:
        holds = _holds(name, case)
        row = {'simulator': name, 'version': answer['version'], 'machine': case.name}
        if 'not_run' in answer:
            yield row | {'not_run': answer['not_run']}
            continue
        row |= {'follows': answer['cells']['follower']['decay']}
        limits = answer['cells'][case.name].pop('limits')
        asked = [joint.limit for joint in case.content.joints]
        row |= {'limits': isinstance(limits, list) and np.allclose(limits, asked, rtol=1e-6)}
        for what, there in answer['cells'][case.name].items():
            if not isinstance(there, list):
                row |= {what: there}
                continue
            whole, held = (ours[case.name, frozenset(of)][what] for of in (WHOLE, holds))
            start = 0.0 if what == 'torque' else case.still
            of = _sizes(whole - start, what)
            off, beside = (_sizes(np.array(there) - x, what) / of for x in (whole, held))
            row |= {what: float(off.max()), f'{what}_held': float(beside.max())}
            if what == 'torque':
                row |= {'joint': case.joints[int(np.argmax(off))]}
        yield row


def _sizes(values: Array, what: str) -> Array:
    """Return (D,) root mean squares of torques (S, D), or (1,) the length of a way (D,)."""
    rows = values if what == 'torque' else values[:, None]
    return np.asarray(np.sqrt(np.mean(rows**2, axis=0)))


HEAD = """<!-- {mark} -->
# Simulators

What [exported machines](arm.md#2-put-it-into-my-simulator) do in the simulators that install from
PyPI: run on {date}, with the newest releases, MuJoCo Warp and Newton on `{device}`. Again:

<!-- not run: takes minutes -->
```bash
make bench ARGS=simulators # into build/simulators/
```

Six machines: a pendulum, also with Stribeck friction, friction that differs by direction and
along the way, and torque ripple, a gimbal whose frame has no mass, the bundled KR 300, and Panda
and Z1 of `example-robot-data`. Their links are a tenth heavier than described; each joint has
viscous and Coulomb friction, and an armature, the inertia of its motor and gear.

## What each has a place for

With its file, and what to call of a `load_*.py`. The price is the RMS of what is left out, and of
the whole torque, along a log of the KR 300 on the axis where their ratio is largest. `ident
export` states it for a machine of one's own. Effects are those of a joint's position and speed, as
Stribeck friction. Effort limits count where the simulator told the exported ones when it was
asked. Isaac Lab's own class took its file, and simulated nothing. MuJoCo Warp takes `robot.xml`
alone: it does not call what `load_mujoco.py` adds to MuJoCo's steps.

"""
LINKS = """
## Links without mass, joints that follow others

What simulators make of them; `ident export` names those of a description. In the run a second
joint follows a first one twice as fast, for half a second.

"""
CELLS = """
## How far off they are

- Torque: the RMS error of what the joints need in ten states, by the RMS of that, on the worst
  joint.
- Decay and swing: how far off the joints are {seconds:g} s after a start at a speed without
  gravity, and at rest with it, by how far they went.

In brackets is the error against our own model without what the target has no place for. It is
printed bold above {torque:g} % for torques and {travel:g} % for motions.

With `--device cuda:0`, `python -m checks.simulators` runs MuJoCo Warp and Newton, also of USD, on
a GPU. On 2026-11-29 an NVIDIA H200 gave all torques within 0.001 %, and all motions within
0.004 %, of those of the processor, by MuJoCo Warp 4.0.0 and by Newton 1.8.0 with MuJoCo Warp
3.17.0. By hand, 65536 KR 300s there had damping, friction and armature of their own, from half to
one and a half times the exported ones (`batch_sizes` of `put_model`): the 64 compared decayed to
within 0.12 % of their way of where MuJoCo's did.

"""


def page(rows: Sequence[dict[str, Any]], told: dict[str, Any], device: str) -> str:
    """Return the page.

    Args:
        rows: Of all simulators and machines.
        told: `export.json` of the machine that prices are of.
        device: Of those that run on CUDA, too.
    """
    by = {row['simulator']: row for row in rows}
    limited = {name: all(r.get('limits') for r in rows if r['simulator'] == name) for name in by}
    places = [_place(name, by[name], told['targets'], limited[name]) for name in by]
    odd = [
        [PEERS[name].title, target.massless, target.follows, _followed(row.get('follows'))]
        for name, row in by.items()
        for target in (TARGETS[PEERS[name].target],)
        if target.massless
    ]
    head = (
        'simulator',
        'file',
        'armature',
        'viscous',
        'Coulomb',
        'effects',
        'effort limit',
        'price',
    )
    cells = 'simulator', 'machine', 'torque', 'on', 'decay', 'swing'
    lines = [
        [PEERS[row['simulator']].title, row['machine'], *own]
        for row in rows
        if any(own := _cells(row))
    ]
    return (
        HEAD.format(mark=mark('simulators'), date=date.today().isoformat(), device=device)
        + table(head, places)
        + LINKS
        + table(('simulator', 'links without mass', 'joints that follow others', 'run'), odd)
        + CELLS.format(seconds=MOTION, torque=100.0 * TORQUE, travel=100.0 * TRAVEL)
        + table(cells, lines)
    )


def _place(name: str, row: dict[str, Any], told: dict[str, Any], limited: bool) -> list[str]:
    """Return the row of a simulator in the table of what it has a place for."""
    peer = PEERS[name]
    target, joints = TARGETS[peer.target], told[peer.target]['joints']
    prices = []
    for part in PARTS:
        if part not in target.holds:
            share = {n: j['cost'][part] / j['effort'] for n, j in joints.items()}
            most = max(share, key=lambda n: share[n])
            figures = f'{joints[most]["cost"][part]:.3g} of {joints[most]["effort"]:.3g} N m'
            prices.append(f'{part}: {figures} on {most}')
    acts = TARGETS['mjcf_effects' if name == 'mujoco' else peer.target].holds
    held = [part in acts for part in ('armature', 'viscous', 'coulomb', 'laws')]
    said = ['yes' if has else 'no' for has in (*held, limited)]
    version = row['version'] or 'not run'
    return [f'{peer.title} {version}', f'`{target.file}`', *said, '<br>'.join(prices)]


def _followed(ends: Any) -> str:
    """Return how far off a joint is that has to follow another one; see `FOLLOWER`."""
    if not isinstance(ends, list):
        return (ends or '').partition('. ')[0]
    lead, follow = ends
    return f'{abs(follow - 0.1 + 2.0 * lead):.2g} of {2.0 * abs(lead):.2g} rad off'


def _cells(row: dict[str, Any]) -> list[str]:
    if 'not_run' in row:
        return ['not run', '', '', '']
    torque, *motion = (
        _cell(row.get(what), row.get(f'{what}_held'), most)
        for what, most in (('torque', TORQUE), ('decay', TRAVEL), ('swing', TRAVEL))
    )
    return [torque, row.get('joint', ''), *motion]


def _cell(value: Any, held: float | None, most: float) -> str:
    if held is None:
        return value or ''
    text = f'{100.0 * value:.2g} %' + ('' if value == held else f' ({100.0 * held:.2g} %)')
    return text if held <= most else f'**{text}**'
