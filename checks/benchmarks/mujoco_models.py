# SPDX-License-Identifier: Apache-2.0
"""The belt drive in MuJoCo, simulated by its compiled rollouts and identified by `mujoco.sysid`.

The gears are written as masses on the belt: with arcs r phi instead of angles the three belt parts
are tendons with the stiffnesses of eq. 11.
"""

from collections.abc import Mapping
from contextlib import redirect_stdout
import io
from typing import Any

import mujoco
from mujoco import rollout, sysid
import numpy as np

# RK4 at a third of the sampling interval is the coarsest that keeps the torque within 1 %.
SUBSTEPS = 3


def _xml(c: Mapping[str, float], step: float) -> str:
    r2 = c['radius'] ** 2
    masses = {
        'gear_1': c['driving_inertia'] / r2,
        'gear_2': c['driven_inertia'] / r2,
        'carriage': c['rail_mass'],
    }
    bodies = ''.join(
        f'<body><joint name="{name}" type="slide" axis="1 0 0"/>'
        f'<inertial pos="0 0 0" mass="{mass!r}" diaginertia="1 1 1"/></body>'
        for name, mass in masses.items()
    )
    ends = (('gear_1', 'carriage'), ('carriage', 'gear_2'), ('gear_2', 'gear_1'))
    tendons = ''.join(
        f'<fixed name="belt_{i}" stiffness="{stiffness!r}" springlength="0">'
        f'<joint joint="{a}" coef="1"/><joint joint="{b}" coef="-1"/></fixed>'
        for i, ((a, b), stiffness) in enumerate(zip(ends, _stiffness(c), strict=True))
    )
    return (
        f'<mujoco><option timestep="{step!r}" integrator="RK4" gravity="0 0 0">'
        '<flag contact="disable" constraint="disable"/></option>'
        f'<worldbody>{bodies}</worldbody><tendon>{tendons}</tendon><actuator>'
        f'<position name="controller" joint="gear_1" kp="{c["position_gain"] / r2!r}"/>'
        '</actuator><sensor><jointpos name="gear_1" joint="gear_1"/></sensor></mujoco>'
    )


def _stiffness(c: Mapping[str, float]) -> tuple[float, float, float]:
    x0, stiff = c['rail_position'], c['axial_stiffness']
    return (stiff / (c['length_1'] + x0), stiff / (c['length_2'] - x0), stiff / c['length_3'])


class MujocoBelt:
    """One belt drive.

    Args:
        c: Constants by name, as in `config/belt_drive.yaml`.
        reference: (K,) set-point, rad.
    """

    def __init__(self, c: Mapping[str, float], cycle: float, reference: np.ndarray) -> None:
        self.constants = {name: float(value) for name, value in c.items()}
        self.reference = reference
        self.step = cycle / SUBSTEPS
        self.spec = mujoco.MjSpec.from_string(_xml(self.constants, self.step))
        self.model = self.spec.compile()
        arc = reference[:-1] * self.constants['radius']
        self.control = np.repeat(arc, SUBSTEPS)[:, None]
        self.start = np.zeros(
            (1, mujoco.mj_stateSize(self.model, mujoco.mjtState.mjSTATE_FULLPHYSICS))
        )

    def _outputs(self, states: np.ndarray, gain: float) -> np.ndarray:
        places = np.concatenate([[0.0], states[SUBSTEPS - 1 :: SUBSTEPS, 1]])
        phi1 = places / self.constants['radius']
        return np.stack([phi1, gain * (self.reference - phi1)])

    def torque(self) -> np.ndarray:
        """Return phi1 and M1, (2, K)."""
        states, _ = rollout.rollout(
            self.model, mujoco.MjData(self.model), self.start, self.control[None]
        )
        return self._outputs(states[0], self.constants['position_gain'])

    def identify(
        self,
        measured: np.ndarray,
        scale: np.ndarray,
        bounds: Mapping[str, tuple[float, float]],
        start: Mapping[str, float],
    ) -> tuple[dict[str, float], int]:
        """Run `mujoco.sysid` from one start.

        Args:
            measured: (2, K) phi1 and M1.
            scale: (2,) sizes by which their residuals are divided.
            bounds: Box of `axial_stiffness` and `position_gain`.
        """
        r2 = self.constants['radius'] ** 2

        def set_stiffness(spec: Any, parameter: Any) -> None:
            changed = {**self.constants, 'axial_stiffness': float(parameter.value[0])}
            for i, stiffness in enumerate(_stiffness(changed)):
                spec.tendon(f'belt_{i}').stiffness[0] = stiffness

        def set_gain(spec: Any, parameter: Any) -> None:
            gain = float(parameter.value[0]) / r2
            controller = spec.actuator('controller')
            controller.gainprm[0] = gain
            controller.biasprm[1] = -gain

        modifiers = {'axial_stiffness': set_stiffness, 'position_gain': set_gain}
        parameters = sysid.ParameterDict()
        for name, (low, high) in bounds.items():
            parameters.add(
                sysid.Parameter(
                    name,
                    nominal=start[name],
                    min_value=low,
                    max_value=high,
                    modifier=modifiers[name],
                )
            )
        simulated = 0

        def compare(
            now: Any, predicted: Any, record: Any, _model: Any, _all: bool, *, state: Any, **_: Any
        ) -> tuple[np.ndarray, Any, Any]:
            nonlocal simulated
            simulated += 1
            outputs = self._outputs(state, float(now['position_gain'].value[0]))
            return ((outputs - measured) / scale[:, None]).reshape(1, -1), predicted, record

        # The last row of a record has no step after it.
        control = np.vstack([self.control, self.control[-1:]])
        times = np.arange(len(control)) * self.step
        record = sysid.TimeSeries.from_names(
            times, np.zeros((len(times), 1)), self.model, ['gear_1']
        )
        sequences = sysid.ModelSequences(
            'belt', self.spec, 'log', self.start[0], sysid.TimeSeries(times, control), record
        )
        residual = sysid.build_residual_fn(
            models_sequences=[sequences], modify_residual=compare, n_threads=1, resample_true=False
        )
        with redirect_stdout(io.StringIO()):
            found, _ = sysid.optimize(
                initial_params=parameters,
                residual_fn=residual,
                optimizer='mujoco',
                verbose=False,
                max_iters=30,
                x_scale='jac',
            )
        return {name: float(found[name].value[0]) for name in bounds}, simulated
