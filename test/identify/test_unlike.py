# SPDX-License-Identifier: Apache-2.0
"""Drives of unlike effort in one fit: each counts by what its own samples tell."""

import numpy as np
import pytest

from ros2_ident.cli.main import main
from ros2_ident.identify.run import problem_of, read_data, solve
from ros2_ident.identify.settings import IdentifySettings
from ros2_ident.models import load_machine


@pytest.mark.parametrize('method', ['genetic', 'algebraic'])
def test_a_drive_of_little_effort_is_told_beside_one_of_much(tmp_path, method):
    rng, time = np.random.default_rng(4), 0.004 * np.arange(3000)
    columns, truth, names = [time], {}, ['time']
    for name, mass, rate in ('arm', 2.0, 3.0), ('wrist', 2e-3, 4.1):
        place = np.sin(rate * time) + 0.4 * np.sin(2.3 * rate * time)
        speed = rate * (np.cos(rate * time) + 0.92 * np.cos(2.3 * rate * time))
        rise = -(rate**2) * (np.sin(rate * time) + 2.116 * np.sin(2.3 * rate * time))
        effort = mass * (rise + 6.0 * np.sign(speed) + 1.5 * speed)
        # a twentieth is left, of each drive by its own size
        columns += [place, effort + 0.05 * effort.std() * rng.normal(size=time.size)]
        names += [f'{name}_pos', f'{name}_torque']
        truth |= {f'{name}.moving_mass': mass, f'{name}.coulomb_friction': 6.0 * mass}
        truth |= {f'{name}.viscous_friction': 1.5 * mass}
    log, out = tmp_path / 'log.csv', tmp_path / 'm.yaml'
    np.savetxt(log, np.transpose(columns), '%.9g', ',', header=','.join(names), comments='')
    kind = ['--kind', 'linear_axis', '--bag', str(log), '--out', str(out)]
    assert main(['new-machine', *kind]) == 0
    machine = load_machine(out)
    problem = problem_of(machine, read_data(log, machine), fixed={'measurement_delay': 0.0})
    found = solve(problem, IdentifySettings(method=method), 0)
    values = {x.name: x.value for x in found.parameters}
    assert {x: values[x] for x in truth} == pytest.approx(truth, rel=0.1)
