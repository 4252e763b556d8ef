# SPDX-License-Identifier: Apache-2.0
"""Machines besides the tripod with linear drives, identified by the node from replayed bags."""

from dataclasses import replace
import signal

import pytest
from ros_helpers import ended, identifier, Listener, new_domain, program, ROOT

from checks.reference.bag_making import simulate_bag
from ros2_ident.models import load_machine
from ros2_ident.simulate.bag import CLEAN, write_simulated
from ros2_ident.simulate.motions import draw_motion

pytestmark = [pytest.mark.ros, pytest.mark.timeout(300)]


def told(bag, machine, output, *more):
    """Return the result's message of a node that hears a bag."""
    domain = new_domain()
    with identifier(domain, output, f'machine_file:={machine}', *more) as node:
        listener = Listener(domain)
        try:
            play = program('replay', str(bag), '--wait-for-subscribers', '60', domain=domain)
            with play as replay:
                code, text = ended(replay)
                assert code == 0, text
            listener.until(lambda: listener.results, 'the result')
            result = listener.results[-1]
        finally:
            listener.close()
        node.send_signal(signal.SIGINT)
        assert ended(node)[0] == 0
    return result


def test_a_belt_drive_is_identified_from_angle_and_moment_on_topics(tmp_path) -> None:
    file = ROOT / 'config/belt_drive.yaml'
    machine = load_machine(file)
    truth = {'axial_stiffness': 1.8e5, 'position_gain': 50.0}
    motion = draw_motion('steps', machine, 2.0, 3)
    nuisance = replace(CLEAN, effort_noise=0.005)
    bag = write_simulated(tmp_path / 'bag', simulate_bag(machine, truth, motion, 3, nuisance))
    more = 'initial_population:=1000', 'survivors:=20', 'generations:=12'
    result = told(bag, file, tmp_path / 'out', 'drives:=[driving_gear]', *more)
    assert result.error_code == 0 and result.model == 'belt_drive'
    found = {p.name: p.value for p in result.parameters}
    assert found == pytest.approx(truth, rel=1e-3)
