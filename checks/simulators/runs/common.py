# SPDX-License-Identifier: Apache-2.0
"""What every simulator is asked, in an environment of its own: numpy is all that is needed here.

A request stands on the standard input, as JSON; the answer goes into the file of the first
argument. The second one is Warp's name of the device for the simulators that run on it.
"""

from importlib.metadata import version
import importlib.util
import json
from pathlib import Path
import sys
import traceback

import numpy as np

DEVICE = sys.argv[2]


def exported(folder, name):
    """Return the module that was exported for a simulator."""
    spec = importlib.util.spec_from_file_location(f'load_{name}', folder / f'load_{name}.py')
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


class Simulation:
    """A machine in a simulator, its joints in the order of the request.

    Of `torque` and `acceleration` a simulator has one, and `motion` where it moves anything.
    """

    def torque(self, position, velocity, acceleration, guess):
        """Return (D,) the torque [N m] with which the joints have an acceleration.

        Where a simulator tells accelerations only, they are linear in the torque.
        """
        here = self.acceleration(position, velocity, guess)
        # Away from rest, where friction turns over.
        size = np.sign(velocity) * np.maximum(1e-2 * np.abs(guess), 1e-1)
        columns = [
            (self.acceleration(position, velocity, guess + size[d] * unit) - here) / size[d]
            for d, unit in enumerate(np.eye(len(guess)))
        ]
        return guess + np.linalg.solve(np.array(columns).T, acceleration - here)

    def acceleration(self, position, velocity, torque):
        """Return (D,) accelerations [rad/s^2] under a torque [N m]."""
        raise NotImplementedError

    def motion(self, position, velocity, seconds):
        """Return (D,) positions [rad] some time later, nothing driving the joints."""
        raise NotImplementedError

    def limits(self):
        """Return (D,) the efforts [N m] that it lets an actuator make, where it limits them."""
        raise NotImplementedError


def answer(package, load):
    """Answer the request.

    Args:
        package: What is asked for its version.
        load: Makes a simulation of the exported folder, the joints' names and whether there is
            gravity.
    """
    cells = {case['name']: dict(_asked(load, case)) for case in json.load(sys.stdin)}
    whole = {'version': version(package), 'cells': cells}
    Path(sys.argv[1]).write_text(json.dumps(whole))


def _asked(load, case):
    """Yield what one machine is asked, and its answer: numbers, None, or why there are none."""
    folder, joints, seconds = Path(case['folder']), case['joints'], case['seconds']
    still, fast = np.array(case['still']), np.array(case['fast'])

    def torque():
        run = load(folder, joints, True)
        states = np.array(case['states']).transpose(1, 0, 2)
        return [
            run.torque(*state, np.array(guess))
            for state, guess in zip(states, case['torque'], strict=True)
        ]

    asked = {
        'limits': lambda: load(folder, joints, True).limits(),
        'torque': torque,
        'decay': lambda: load(folder, joints, False).motion(still, fast, seconds),
        'swing': lambda: load(folder, joints, True).motion(still, 0.0 * still, seconds),
    }
    for name, ask in asked.items():
        try:
            yield name, np.asarray(ask(), dtype=float).tolist()
        except NotImplementedError:
            yield name, None
        except Exception as error:
            traceback.print_exc()
            yield name, f'{type(error).__name__}: {error}'.splitlines()[0]
