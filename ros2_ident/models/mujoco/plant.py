# SPDX-License-Identifier: Apache-2.0
"""A description compiled, its attributes by name, and candidates rolled out.

Nothing else in this process imports MuJoCo. Every thread has models and data of its own.
"""
# mypy: disable-error-code="no-any-return"

from collections.abc import Callable, Mapping, Sequence
import copy
import functools
import importlib.util
import math
import os
from pathlib import Path
import subprocess
import sys
import threading
from typing import Any
import xml.etree.ElementTree as ET

import numpy as np

from ros2_ident.arrays import Array
from ros2_ident.errors import ErrorCode
from ros2_ident.machine.description import joints_in, judged, judged_tree
from ros2_ident.machine.machine import Machine

# Candidates rolled out at a time: enough that the call costs nothing, few enough for the memory.
_TOGETHER, _NUMBERS = 64, 4_000_000
# Steps of the simulator in a cycle, at most.
_SUBSTEPS = 10_000
# Sensors of a joint by the quantity that they tell.
_SENSORS = {'position': 'JOINTPOS', 'velocity': 'JOINTVEL', 'effort': 'JOINTACTFRC'}
# Of an actuator, what a machine file states in the description's place.
GAINS = 'kp', 'kv'
OWN = *GAINS, 'force_limit'
# See `Plant.rollout`.
Felt = Callable[[float, Array, Array, Array], Array]
# Steps to close a loop, and how far apart its ends may be, m or rad.
_STEPS, _CLOSED = 30, 1e-10
# A body without mass, which MuJoCo refuses to move, gets so much: kg, and kg m^2 about each axis.
_MASS, _INERTIA = 1e-9, 1e-12


@functools.cache
def loaded() -> Any:
    """Return MuJoCo.

    Raises:
        IdentError: UNKNOWN_MODEL where it is not installed.
    """
    try:
        import mujoco
        import mujoco.rollout
    except ImportError as error:
        raise ErrorCode.UNKNOWN_MODEL.error(
            'a machine of the kind mujoco needs MuJoCo, which is not installed; '
            '`pip install mujoco`'
        ) from error
    # What it warns of, a candidate that cannot be simulated, shows in the candidate's output.
    mujoco.set_mju_user_warning(lambda text: None)
    return mujoco


def joints_of(root: ET.Element) -> tuple[str, ...]:
    """Return the joints of an MJCF that actuators turn about or slide along one axis.

    All that move so where there are no such actuators. Its shapes are left out.

    Raises:
        IdentError: BAD_MACHINE_FILE for a URDF, or as `judged_tree`.
    """
    found = joints_in(_of_mjcf(judged(root, shapes=False)))
    driven = {actuator.get('joint') for actuator in root.iterfind('actuator/*')}
    return tuple(name for name in found if name in driven) or found


def _mjcf(text: str) -> str:
    """Return an MJCF without the files of its shapes, as this package writes it."""
    return ET.tostring(_of_mjcf(judged_tree(text, shapes=False)), encoding='unicode')


def _of_mjcf(root: ET.Element) -> ET.Element:
    """Return the root that it is given, of an MJCF."""
    if root.tag == 'robot':
        raise ErrorCode.BAD_MACHINE_FILE.error(
            'geometry.description is a URDF, and MuJoCo simulates an MJCF here; let `ident '
            'new-machine --description URDF --bag LOG` write the machine file of an arm, or give '
            'an MJCF'
        )
    return root


def tried(text: str) -> None:
    """Judge a description by a process of its own that compiles it.

    Raises:
        IdentError: BAD_MACHINE_FILE where that dies, or MuJoCo warns of it.
    """
    trial = subprocess.run(
        [sys.executable, '-P', str(Path(__file__).with_name('trial.py'))],
        input=text.encode(), capture_output=True,
        env={**os.environ, 'PYTHONPATH': os.pathsep.join(sys.path)},
    )  # fmt: skip
    said = trial.stdout.decode(errors='replace').strip()
    if trial.returncode:
        said = 'it needs more than 512 MiB or 5 s, or ends'
    if said:
        raise ErrorCode.BAD_MACHINE_FILE.error(
            f'geometry.description is nothing for MuJoCo ({said.splitlines()[0]}); correct it'
        )


class Place:
    """Where a drive is in a compiled model.

    Attributes:
        joint: Number of its joint.
        position: Where its position is in qpos.
        dof: Number of its degree of freedom.
        actuator: Number of its actuator, which follows a position, or does so once it has gains.
        body: Number of the body whose mass and place are parameters.
        sense: 1, or -1 where the log counts backwards.
        slides: Whether the joint slides, so that its position is in m and its effort in N.
    """

    def __init__(
        self, model: Any, joint: str, actuator: str, sense: float, body: str, gained: bool
    ) -> None:
        mj = loaded()
        self.joint = _number(model, 'joint', joint)
        one_axis = int(mj.mjtJoint.mjJNT_HINGE), int(mj.mjtJoint.mjJNT_SLIDE)
        if int(model.jnt_type[self.joint]) not in one_axis:
            raise ErrorCode.BAD_MACHINE_FILE.error(
                f'joint {joint} of geometry.description neither turns about nor slides along one '
                'axis; leave it out of drives'
            )
        self.position = int(model.jnt_qposadr[self.joint])
        self.dof = int(model.jnt_dofadr[self.joint])
        self.slides = int(model.jnt_type[self.joint]) == int(mj.mjtJoint.mjJNT_SLIDE)
        own = int(model.jnt_bodyid[self.joint])
        self.body = _number(model, 'body', body) if body else own
        self.sense = sense
        # The number is that of a tendon, a site or a body where the actuator acts on one.
        on_joint = model.actuator_trntype <= int(mj.mjtTrn.mjTRN_JOINTINPARENT)
        acting = np.flatnonzero(on_joint & (model.actuator_trnid[:, 0] == self.joint))
        if not actuator and acting.size != 1:
            raise ErrorCode.BAD_MACHINE_FILE.error(
                f'{acting.size} actuators of geometry.description act on joint {joint}; name the '
                'one that follows the set-point in drive.actuator'
            )
        n = self.actuator = _number(model, 'actuator', actuator) if actuator else int(acting[0])
        off = bool(model.opt.disableflags & int(mj.mjtDisableBit.mjDSBL_ACTUATION))
        off |= bool(model.opt.disableactuator >> int(model.actuator_group[n]) & 1)
        rate = int(model.actuator_dyntype[n]) == int(mj.mjtDyn.mjDYN_INTEGRATOR)
        if off or rate or not (gained or model.actuator_biasprm[n, 1]):
            raise ErrorCode.BAD_MACHINE_FILE.error(
                f'the actuator of joint {joint} in geometry.description follows no position, or '
                'an option or flag switches it off; write a position actuator that is on, or of a '
                'motor seek kp and kv'
            )


def _number(model: Any, word: str, name: str) -> int:
    mj = loaded()
    kind = getattr(mj.mjtObj, f'mjOBJ_{word.upper()}')
    found = mj.mj_name2id(model, kind, name)
    if found < 0:
        count = {'joint': model.njnt, 'actuator': model.nu, 'body': model.nbody}[word]
        known = ', '.join(str(mj.mj_id2name(model, kind, n)) for n in range(count))
        raise ErrorCode.BAD_MACHINE_FILE.error(
            f'geometry.description has no {word} {name}; it has {known}: give the {word} of each '
            f'drive in drive.{word}'
        )
    return int(found)


# Numbers of a model where a drive is: array, whose number, column, sign.
_NUMBERS_OF: dict[str, tuple[str, str, tuple[int, ...], float]] = {
    'armature': ('dof_armature', 'dof', (), 1.0),
    'damping': ('dof_damping', 'dof', (), 1.0),
    'frictionloss': ('dof_frictionloss', 'dof', (), 1.0),
    'stiffness': ('jnt_stiffness', 'joint', (), 1.0),
    'actuator_gear': ('actuator_gear', 'actuator', (0,), 1.0),
    'kp': ('actuator_gainprm', 'actuator', (0,), 1.0),
    'kv': ('actuator_biasprm', 'actuator', (2,), -1.0),
    'body_mass': ('body_mass', 'body', (), 1.0),
}
# Factors on what its body has.
_FACTORS = {'body_place': 'body_pos', 'body_centre': 'body_ipos', 'body_inertia': 'body_inertia'}


def _number_of(name: str, model: Any, at: Place) -> tuple[Any, tuple[int, ...], float]:
    """Return the array that holds a number of a drive, its place there, and its sign."""
    field, of, column, sign = _NUMBERS_OF[name]
    return getattr(model, field), (getattr(at, of), *column), sign


def _put(name: str, model: Any, at: Place, value: float) -> None:
    """Write a parameter into a model where a drive is."""
    if name in _FACTORS:
        getattr(model, _FACTORS[name])[at.body] *= value
        return
    if name == 'force_limit':
        model.actuator_forcelimited[at.actuator] = True
        model.actuator_forcerange[at.actuator] = -value, value
        # The joint's own limit would hold beside this one.
        model.jnt_actfrclimited[at.joint] = False
        return
    if name == 'body_mass':
        model.body_inertia[at.body] *= value / model.body_mass[at.body]
    elif name in GAINS:
        # A motor's effort has no part of position and speed otherwise.
        model.actuator_biastype[at.actuator] = loaded().mjtBias.mjBIAS_AFFINE
        if name == 'kp':
            model.actuator_biasprm[at.actuator, 1] = -value
    numbers, place, sign = _number_of(name, model, at)
    numbers[place] = sign * value


# All that is written.
_FIELDS = (
    *dict.fromkeys(field for field, *_ in _NUMBERS_OF.values()), *_FACTORS.values(),
    'actuator_biastype', 'actuator_forcelimited', 'actuator_forcerange', 'jnt_actfrclimited',
)  # fmt: skip


# What a flag of an MJCF switches off: numbers by a word of their name.
_SWITCHED = {'DAMPER': 'damping', 'SPRING': 'stiffness', 'FRICTIONLOSS': 'frictionloss'}


def _switched_off(model: Any) -> None:
    """Write what the flags of a model switch off as zeros, beside which a parameter acts."""
    bits, opt = loaded().mjtDisableBit, model.opt

    def bit(*names: str) -> int:
        return sum(int(getattr(bits, f'mjDSBL_{name}', 0)) for name in names)

    if opt.disableflags & bit('CONSTRAINT'):
        opt.disableflags |= bit('FRICTIONLOSS', 'LIMIT', 'EQUALITY', 'CONTACT')
    words = [word for name, word in _SWITCHED.items() if opt.disableflags & bit(name)]
    if {'damping', 'stiffness'} <= {*words}:  # nothing passive is left, as MuJoCo has it
        words.append('gravcomp')
        opt.density = opt.viscosity = 0.0
    for name in dir(model) if words else ():
        if any(x in name for x in words) and isinstance(getattr(model, name), np.ndarray):
            getattr(model, name)[:] = 0.0
    opt.gravity *= not opt.disableflags & bit('GRAVITY')
    opt.disableflags &= ~bit(*_SWITCHED, 'GRAVITY', 'CONSTRAINT', 'SENSOR')


class _Own(threading.local):
    """Data and models of each thread."""

    def __init__(self, model: Any) -> None:
        self.data = loaded().MjData(model)
        self.roller = loaded().rollout.Rollout(nthread=0)
        self.models: list[Any] = []


class Plant:
    """A user's MJCF, ready for candidates.

    Args:
        machine: A machine of the kind.

    Attributes:
        places: Where each drive is.
        substeps: Steps of the simulator in a cycle.

    Raises:
        IdentError: UNKNOWN_MODEL without MuJoCo, BAD_MACHINE_FILE where the description cannot be
        read or lacks a joint or actuator.
    """

    def __init__(self, machine: Machine) -> None:
        mj = loaded()
        joints = [machine.text('joint', name) or name for name in machine.drives]
        text = _mjcf(machine.described(None).text('description'))
        tried(text)
        try:
            spec = mj.MjSpec.from_string(text)
            model = spec.compile()
        except ValueError as error:
            reason = ' '.join(str(error).split()).partition(', line ')[0]
            raise ErrorCode.BAD_MACHINE_FILE.error(
                f'geometry.description cannot be read ({reason}); give another MJCF'
            ) from error
        gained = machine.stated('kp') or 'kp' in machine.bounds
        self.places = []
        for joint, name in zip(joints, machine.drives, strict=True):
            sense = 1.0 if machine.text('direction', name) == 'forward' else -1.0
            actuator, body = machine.text('actuator', name), machine.text('body', name)
            self.places.append(Place(model, joint, actuator, sense, body, gained))
            for quantity, word in _SENSORS.items():
                kind = getattr(mj.mjtSensor, f'mjSENS_{word}')
                on = {'type': kind, 'objtype': mj.mjtObj.mjOBJ_JOINT, 'objname': joint}
                spec.add_sensor(name=f'ident {quantity} {joint}', **on)
        self.model = spec.compile()
        size = float(np.linalg.norm(self.model.opt.gravity))
        self._down = self.model.opt.gravity / size if size else np.array([0.0, 0.0, -1.0])
        _switched_off(self.model)
        for name, at in zip(machine.drives, self.places, strict=True):
            for word in filter(machine.stated, OWN):
                _put(word, self.model, at, machine.number(word, name))
        cycle = machine.number('cycle')
        step = self.model.opt.timestep
        if not step * _SUBSTEPS >= cycle:
            raise ErrorCode.BAD_MACHINE_FILE.error(
                f'geometry.description has the timestep {step:g} s; write one from '
                f'{cycle / _SUBSTEPS:g} s to the cycle, {cycle:g} s'
            )
        self.substeps = max(1, math.ceil(cycle / step - 1e-6))
        self.model.opt.timestep = cycle / self.substeps
        self._sensors = {
            q: np.array([int(self.model.sensor(f'ident {q} {j}').adr[0]) for j in joints])
            for q in _SENSORS
        }
        self._own = _Own(self.model)
        self._remembers = bool(getattr(self.model, 'nhistory', 0))

    def changed(self, model: Any, values: Mapping[str, Mapping[int, float]]) -> None:
        """Write attributes into a copy of the model, from the description's on.

        Args:
            model: The copy.
            values: Values by the name of the parameter and the number of the drive.
        """
        for name in _FIELDS:
            getattr(model, name)[:] = getattr(self.model, name)
        model.opt.gravity[:] = self.model.opt.gravity
        for name, each in values.items():
            if name == 'free_fall':
                model.opt.gravity[:] = each[0] * self._down
                continue
            for drive, value in each.items():
                _put(name, model, self.places[drive], value)
        loaded().mj_setConst(model, self._own.data)

    def stated(self, name: str, drive: int) -> float:
        """Return what the description has in place of a parameter."""
        at, model = self.places[drive], self.model
        if name in _NUMBERS_OF:
            numbers, place, sign = _number_of(name, model, at)
            return float(sign * numbers[place])
        if name == 'force_limit':
            own = model.actuator_forcelimited[at.actuator], model.actuator_forcerange[at.actuator]
            joint = model.jnt_actfrclimited[at.joint], model.jnt_actfrcrange[at.joint]
            return min(float(ends[1]) if limited else math.inf for limited, ends in (own, joint))
        if name == 'free_fall':
            return float(np.linalg.norm(model.opt.gravity))
        return 0.0 if name == 'joint_zero' else 1.0

    @property
    def ends(self) -> Array:
        """(2, D) lowest and highest position of each drive's joint; infinite where not limited."""
        joints = [at.joint for at in self.places]
        limited = self.model.jnt_limited[joints].astype(bool)
        return np.where(limited, self.model.jnt_range[joints].T, [[-math.inf], [math.inf]])

    @property
    def home(self) -> Array:
        """(D,) positions of the drives' joints in which the description is drawn."""
        return np.asarray(self.model.qpos0)[[at.position for at in self.places]]

    @functools.cached_property
    def _state(self) -> int:
        mj = loaded()
        return int(mj.mj_stateSize(self.model, mj.mjtState.mjSTATE_FULLPHYSICS))

    def together(self, cycles: int) -> int:
        """Return how many candidates are rolled out in one call."""
        each = cycles * self.substeps * (self._state + self.model.nsensordata)
        each += loaded().mj_sizeModel(self.model) // 8
        return max(1, min(_TOGETHER, _NUMBERS // max(1, each)))

    def rollout(
        self,
        values: list[dict[str, dict[int, float]]],
        command: Array,
        start: Array,
        forces: Felt | None = None,
    ) -> dict[str, Array]:
        """Simulate candidates.

        Args:
            values: Of each candidate, as of `changed`.
            command: (S, D, K) or (1, D, K) set-points in the joints' own coordinates.
            start: (S, 2, D) positions and rates of the joints at the first cycle.
            forces: What the joints feel besides: of an instant [s], and of positions, rates and
                efforts (S, D), the size of friction and what else acts (2, S, D).

        Returns:
            (S, D, K) positions, velocities and efforts by quantity, in the joints' own
            coordinates and at the instants of the set-points.
        """
        mj = loaded()
        while len(self._own.models) < len(values):
            self._own.models.append(copy.copy(self.model))
        models = self._own.models[: len(values)]
        states = np.zeros((len(values), self._state))
        data = self._own.data
        for s, (model, value) in enumerate(zip(models, values, strict=True)):
            self.changed(model, value)
            mj.mj_resetData(model, data)
            for d, at in enumerate(self.places):
                data.qpos[at.position], data.qvel[at.dof] = start[s, :, d]
                # A set-point that is filtered or delayed has stood before.
                n, held = at.actuator, command[min(s, len(command) - 1), d, 0]
                if model.actuator_ctrllimited[n]:
                    held = np.clip(held, *model.actuator_ctrlrange[n])
                if (state := int(model.actuator_actadr[n])) >= 0:
                    data.act[state] = held
                if past := int(model.actuator_history[n, 0]) if self._remembers else 0:
                    mj.mj_initCtrlHistory(model, data, n, None, np.full((past, 1), held))
            if model.neq:
                close_loops(mj, model, data, [at.dof for at in self.places])
            mj.mj_getState(model, data, states[s], mj.mjtState.mjSTATE_FULLPHYSICS)
        control = np.zeros((len(command), command.shape[2], self.model.nu))
        for d, at in enumerate(self.places):
            control[:, :, at.actuator] = command[:, d]
        steps = np.repeat(control, self.substeps, axis=1)
        if forces is None:
            ends, told = self._own.roller.rollout(models, data, states, steps)
        else:
            ends, told = self._stepped(models, states, steps, forces)
        # Where it is unstable MuJoCo stops, and time with it.
        told[ends[:, -1, 0] < (steps.shape[1] - 0.5) * self.model.opt.timestep] = math.inf
        # What a step's sensors tell is of its beginning.
        told = told[:, :: self.substeps]
        return {q: told[:, :, adr].swapaxes(1, 2) for q, adr in self._sensors.items()}

    def inverse(self, position: Array, velocity: Array, acceleration: Array) -> Array:
        """Return (D, K) what the links ask of the drives' joints, N m or N.

        Neither friction nor armature of the joints counts; joints without a drive stay as drawn.

        Args:
            position: (D, K), in the joints' own coordinates.
            velocity: (D, K).
            acceleration: (D, K).
        """
        mj, model = loaded(), copy.copy(self.model)
        data = mj.MjData(model)
        dofs = np.array([at.dof for at in self.places])
        for field in ('armature', 'damping', 'frictionloss'):
            getattr(model, f'dof_{field}')[dofs] = 0.0
        out = np.empty(position.shape)
        for k in range(position.shape[1]):
            data.qpos[[at.position for at in self.places]] = position[:, k]
            data.qvel[dofs], data.qacc[dofs] = velocity[:, k], acceleration[:, k]
            mj.mj_inverse(model, data)
            out[:, k] = data.qfrc_inverse[dofs]
        return out

    def _stepped(
        self, models: list[Any], states: Array, control: Array, forces: Felt
    ) -> tuple[Array, Array]:
        """Return what a rollout returns, the last state alone, its forces renewed every step."""
        mj = loaded()
        spec = int(mj.mjtState.mjSTATE_CTRL | mj.mjtState.mjSTATE_QFRC_APPLIED)
        count, (steps, nu) = len(models), control.shape[1:]
        told = np.empty((count, steps, self.model.nsensordata))
        now, seen = np.empty((count, 1, self._state)), np.empty((count, 1, told.shape[2]))
        given = np.zeros((count, 1, nu + self.model.nv))
        dofs = np.array([at.dof for at in self.places])
        # A state begins with the time.
        place = np.array([1 + at.position for at in self.places])
        rate, pushed = 1 + self.model.nq + dofs, nu + dofs
        friction = [model.dof_frictionloss for model in models]
        effort = np.zeros((count, len(dofs)))
        for n in range(steps):
            loss, force = forces(
                n * self.model.opt.timestep, states[:, place], states[:, rate], effort
            )
            for own, sizes in zip(friction, loss, strict=True):
                own[dofs] = sizes
            given[:, 0, :nu] = control[:, n]
            given[:, 0, pushed] = force
            self._own.roller.rollout(
                models, [self._own.data], states, given, nstep=1, control_spec=spec, state=now,
                sensordata=seen, skip_checks=True,
            )  # fmt: skip
            states[:], told[:, n] = now[:, 0], seen[:, 0]
            effort = told[:, n, self._sensors['effort']]
        return now, told


def close_loops(mj: Any, model: Any, data: Any, driven: Sequence[int]) -> None:
    """Move all joints but the driven ones until loops are closed, and give them their speeds.

    By Newton's method from the pose in `data` on, so a loop's branch is that pose's.

    Args:
        data: Its pose and speeds, which are changed.
        driven: Degrees of freedom that stay as they are.
    """
    free = np.setdiff1d(np.arange(model.nv), driven)
    step = np.zeros(model.nv)
    for _ in range(_STEPS):
        slopes, apart = _constraints(mj, model, data)
        if np.abs(apart).max(initial=0.0) < _CLOSED:
            break
        step[free] = -np.linalg.lstsq(slopes[:, free], apart, rcond=None)[0]
        mj.mj_integratePos(model, data.qpos, step, 1.0)
    if len(apart):
        drawn = slopes[:, driven] @ data.qvel[driven]
        data.qvel[free] = -np.linalg.lstsq(slopes[:, free], drawn, rcond=None)[0]


def _constraints(mj: Any, model: Any, data: Any) -> tuple[Array, Array]:
    """Return the slopes (E, nv) of equality constraints, and how far apart their ends are (E,)."""
    own, model.opt.jacobian = model.opt.jacobian, mj.mjtJacobian.mjJAC_DENSE
    mj.mj_fwdPosition(model, data)
    model.opt.jacobian = own
    rows = data.efc_type == mj.mjtConstraint.mjCNSTR_EQUALITY
    return data.efc_J.reshape(-1, model.nv)[rows], data.efc_pos[rows]


def can_convert() -> bool:
    """Whether MuJoCo is there to make an MJCF of a URDF."""
    return importlib.util.find_spec('mujoco') is not None


def mjcf_of(urdf: str) -> str:
    """Return the MJCF that MuJoCo makes of a URDF, without the shapes that lie in files.

    Raises:
        IdentError: UNKNOWN_MODEL without MuJoCo, BAD_MACHINE_FILE where it refuses the URDF.
    """
    mj, root = loaded(), ET.fromstring(urdf)
    for link in root.iterfind('link'):
        for shape in [*link.findall('visual'), *link.findall('collision')]:
            if shape.find('geometry/mesh') is not None:
                link.remove(shape)
    text = ET.tostring(root, encoding='unicode')
    tried(text)
    try:
        spec = mj.MjSpec.from_string(text)
        spec.compiler.boundmass, spec.compiler.boundinertia = _MASS, _INERTIA
        spec.compile()
        return str(spec.to_xml())
    except ValueError as error:
        why = ' '.join(str(error).split())
        raise ErrorCode.BAD_MACHINE_FILE.error(
            f'MuJoCo makes no MJCF of the URDF ({why}); give an MJCF with --into'
        ) from error
