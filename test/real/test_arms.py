# SPDX-License-Identifier: Apache-2.0
"""A double pendulum and a KR 300: what their recordings show of published parameters."""

from pathlib import Path

import numpy as np
import pytest

pytest.importorskip('pinocchio', reason='pinocchio is not installed')

from ros2_ident import jobs  # noqa: E402
from ros2_ident.gates.asked import fit_asked  # noqa: E402
from ros2_ident.identify.data import read_data  # noqa: E402
from ros2_ident.identify.problem import problem_of  # noqa: E402
from ros2_ident.identify.run import solve  # noqa: E402
from ros2_ident.identify.settings import IdentifySettings  # noqa: E402
from ros2_ident.models import load_machine  # noqa: E402

ROOT = Path(__file__).parents[2]
RECORDED = ROOT.parent / 'shared/data'
ALGEBRAIC = IdentifySettings(method='algebraic')

pytestmark = pytest.mark.skipif(
    not (RECORDED / 'kr300_a').is_dir(), reason='the recordings of arms are not here'
)


def test_a_double_pendulum_has_the_published_links() -> None:
    machine = load_machine(ROOT / 'config/double_pendulum.yaml')
    names = [f'dp_{kind}_tvlqr_free_0{n}' for kind in ('acrobot', 'pendubot') for n in (1, 2)]
    data = read_data([RECORDED / name for name in names], machine)
    problem = problem_of(machine, data, fixed={'measurement_delay': 0.0037})
    parameters = {p.name: p for p in solve(problem, ALGEBRAIC, 0).parameters}
    # Of model 1.0 of design C.1: m_1 r_1 + m_2 l_1; I_1 + m_2 l_1^2 and both rotors; m_2 r_2; I_2;
    # of friction what the arc tangent comes to.
    rotor = 6.2872e-5
    published = {
        'shoulder.link_moment_x': 0.52346 * 0.2 + 0.62557 * 0.2,
        'shoulder.drive_inertia': 0.031887 + 0.62557 * 0.2**2 + 37.0 * rotor,
        'elbow.link_moment_x': 0.62557 * 0.25569,
        'elbow.link_inertia_zz': 0.050870,
        'shoulder.coulomb_torque': 0.16 * np.pi / 2.0,
    }
    found = {name: parameters[name].value for name in published}
    assert found == pytest.approx(published, rel=0.1)
    assert parameters['elbow.drive_inertia'].value == pytest.approx(36.0 * rotor, rel=0.2)


def test_every_push_that_no_command_asked_for_is_told() -> None:
    machine = load_machine(ROOT / 'config/double_pendulum.yaml')
    # From /disturbance, as shared/data/README.md has them: N m by instants.
    given: dict[str, tuple[dict[float, float], ...]] = {
        'acrobot_tvlqr_perturbed_01': ({1.40: 0.74, 5.40: -0.58}, {3.74: 0.54, 6.94: -0.66}),
        'acrobot_tvlqr_perturbed_02': ({1.26: 0.56, 6.48: -0.51}, {3.25: -0.71, 4.37: -0.59}),
        'pendubot_tvlqr_perturbed_01': ({1.41: -0.41, 3.64: -0.21}, {5.84: 0.21, 8.04: 0.27}),
        'pendubot_tvlqr_perturbed_02': ({3.95: 0.36, 7.14: -0.35}, {1.85: -0.49, 5.85: -0.21}),
    }
    none: tuple[dict[float, float], ...] = ({}, {})
    free = [f'{kind}_tvlqr_free_0{n}' for kind in ('acrobot', 'pendubot') for n in (1, 2)]
    given |= dict.fromkeys(free, none)
    for name, pushes in given.items():
        (data,) = read_data(RECORDED / f'dp_{name}', machine).datasets
        for drive, own in zip(machine.drives, pushes, strict=True):
            found = fit_asked(machine, data, drive)
            assert found is not None
            assert [p.time for p in found.pushes] == pytest.approx([*own], abs=0.03)
            assert [p.effort for p in found.pushes] == pytest.approx([*own.values()], abs=0.08)


def test_what_pushes_do_is_no_change() -> None:
    machine = load_machine(ROOT / 'config/double_pendulum.yaml')
    request = jobs.Request(machine, (str(RECORDED / 'dp_acrobot_tvlqr_free_01'),), seed=1)
    found = jobs.compare(request, [str(RECORDED / 'dp_acrobot_tvlqr_perturbed_01')]).result
    assert sum('effort that was not commanded' in x.text for x in found.apart) == 2
    assert found.pushed and not found.believed


def test_a_kr300_has_friction_and_counterbalance_of_its_authors() -> None:
    machine = load_machine(ROOT / 'config/kr300.yaml')
    data = read_data(RECORDED / 'kr300_a', machine)
    held = {'measurement_delay': 0.008, 'payload_x': 0.0, 'payload_y': 0.0, 'payload_z': -0.34}
    problem = problem_of(machine, data, fixed=held)
    found = solve(problem, ALGEBRAIC, 0)
    value = {p.name: p.value for p in found.parameters}
    viscous = [value[f'axis_{n}.viscous_torque'] for n in (1, 2, 6)]
    assert viscous == pytest.approx([1939.5, 1729.9, 384.4], rel=0.15)
    (force,) = (p for p in found.parameters if p.name == 'axis_2.balance_force')
    # Nitrogen at 162 bar on 1670 mm^2, as its authors measured and drew it.
    assert force.low < 162e5 * 1.67e-3 < force.high
    assert force.low > 0.0
    without = problem_of(machine, data, fixed={**held, 'axis_2.balance_force': 0.0})
    left = [
        dict(zip(machine.drives, solve(p, ALGEBRAIC, 0).residuals, strict=True))
        for p in (problem, without)
    ]
    assert left[0]['axis_2'].rms < 0.6 * left[1]['axis_2'].rms
