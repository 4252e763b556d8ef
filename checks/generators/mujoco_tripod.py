# SPDX-License-Identifier: Apache-2.0
"""The tripod in MuJoCo: turning motors, carriages, a platform, and rods as constraints.

Nothing is shared with the package's two simulations but the machine file. A motor is a hinge of
the inertia J_D, a gear an elastic tendon between its angle over the gear factor and the carriage.
A rod is a spatial tendon whose length an equality constraint keeps, so it has no mass, as the
machine file has it. MuJoCo integrates with RK4 at a tenth of the controller's cycle; the
controllers run between its steps.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
import math
from typing import Any

import mujoco
import numpy as np
import numpy.typing as npt
from scipy.optimize import fsolve

from checks.generators.mujoco_friction import dry_friction
from ros2_ident.models import Machine

Array = npt.NDArray[np.float64]
SUBSTEPS = 10
# A constraint as hard as a step lets it be: error dynamics of 0.1 ms, compliance 1e-4.
HARD = 'solref="1e-4 1" solimp="0.9999 0.9999 1e-3 0.5 1"'


@dataclass(frozen=True)
class Drive:
    """One drive as it truly is, in MuJoCo's terms.

    Attributes:
        inertia: Of the motor [kg m^2].
        stiffness: Of the gear [N/m].
        hardening: Its cubic coefficient [N/m^3].
        damping: Of the gear [N s/m].
        forward: Dry friction at positive speed [N m].
        backward: At negative speed [N m].
        viscous: Viscous friction of the motor [N m s/rad].
        drag: Coefficients of speed times its magnitude and of speed cubed [N m s^2/rad^2, ...].
        dry: Whether `frictionloss` takes the place of the regularised sign.
        gap: Play between gear and carriage [m].
        pinion: Mass on the gear's side of the play [kg].
        spring: Stiffness between carriage and frame, linear and cubic [N/m, N/m^3].
        rest: Where that spring is slack [m].
        limit: Torque that the motor can make at most [N m].
        gain: Torque made per torque commanded.
        delay: Time until a command becomes torque [s].
        dcmotor: Attributes of passive `dcmotor` elements on the motor's shaft: cogging, LuGre.
        winding: Attributes of a `dcmotor` in place of the ideal one: inductance, thermal.
        inductive: Whether its current is a state.
    """

    inertia: float
    stiffness: float
    damping: float
    forward: float
    backward: float
    viscous: float
    hardening: float = 0.0
    drag: tuple[float, float] = (0.0, 0.0)
    dry: bool = False
    gap: float = 0.0
    pinion: float = 0.03
    spring: tuple[float, float] = (0.0, 0.0)
    rest: float = 0.0
    limit: float = math.inf
    gain: float = 1.0
    delay: float = 0.0
    dcmotor: tuple[str, ...] = ()
    winding: str = ''
    inductive: bool = False


@dataclass(frozen=True)
class Whole:
    """What belongs to the machine.

    Attributes:
        tool_mass: Mass of the platform [kg].
        payload: Mass taken up during the log [kg].
        turns: When it is taken up, put down, taken up, ... [s].
        frame: Mass [kg], frequency [Hz] and damping ratio of a swinging frame; empty: it stands.
        hanging: Mass [kg] and length [m] of a load that hangs from the platform; empty: none.
    """

    tool_mass: float
    payload: float = 0.0
    turns: tuple[float, ...] = ()
    frame: tuple[float, ...] = ()
    hanging: tuple[float, ...] = ()


@dataclass(frozen=True)
class True3:
    """A whole tripod as it truly is.

    Attributes:
        gear: Motor angle per travel [rad/m].
        late: Delay of the effort's log [s].
        bias: What the log adds to each drive's torque [N m].
    """

    whole: Whole
    drives: tuple[Drive, ...]
    gear: float
    late: float = 0.0
    bias: tuple[float, ...] = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Course:
    """What a simulated machine did, at every controller cycle.

    Attributes:
        torque: (3, K) torque that the drives report, at its own instant [N m].
        position: (3, K) motor position at the rail [m].
        velocity: (3, K) its speed [m/s].
        rods: (3, K) error of the rods' lengths [m].
    """

    torque: Array
    position: Array
    velocity: Array
    rods: Array = field(default_factory=lambda: np.zeros((3, 0)))


def nominal(machine: Machine, parameters: Mapping[str, float]) -> True3:
    """Return the tripod of a machine file with parameters, named as there, and no effect."""
    gear, rail = machine.number('gear_factor'), machine.number('rail_mass')
    drives = []
    for name in machine.drives:
        own = {
            key.rpartition('.')[2]: value
            for key, value in parameters.items()
            if '.' not in key or key.startswith(name + '.')
        }
        inertia, stiffness = own['drive_inertia'], own['gear_stiffness']
        motor = inertia * gear**2
        reduced = motor * rail / (motor + rail)
        damping = 2.0 * own['gear_damping_ratio'] * math.sqrt(stiffness * reduced)
        dry, viscous = own['coulomb_torque'], own['viscous_torque'] / gear
        drives.append(Drive(inertia, stiffness, damping, dry, dry, viscous))
    late = parameters['measurement_delay']
    return True3(Whole(parameters['tool_mass']), tuple(drives), gear, late)


class Simulation:
    """One machine in MuJoCo."""

    def __init__(self, machine: Machine, true: True3, substeps: int = SUBSTEPS) -> None:
        self.machine, self.true, self.substeps = machine, true, substeps
        self.cycle = machine.number('cycle')
        self.gear = true.gear
        self.mass = machine.number('rail_mass')
        self.gravity = machine.number('gravity')
        self.length = machine.number('rod_length')
        azimuth = machine.numbers('rail_azimuth')
        radius = machine.number('rail_radius')
        self.feet = radius * np.stack([np.cos(azimuth), np.sin(azimuth)], axis=1)
        self.depth = math.sqrt(self.length**2 - radius**2)
        self.model = mujoco.MjModel.from_xml_string(self.xml())
        self.data = mujoco.MjData(self.model)

    def xml(self) -> str:
        """Return the model in MuJoCo's language."""
        count = range(len(self.true.drives))
        step = self.cycle / self.substeps
        rods = ''.join(
            f'<spatial name="rod_{i}"><site site="foot_{i}"/><site site="tool"/></spatial>'
            for i in count
        )
        held = ''.join(f'<tendon tendon1="rod_{i}" {HARD}/>' for i in count)
        gears = ''.join(self._gear(i) for i in count)
        return (
            f'<mujoco><option timestep="{step!r}" integrator="RK4" jacobian="dense" '
            f'gravity="0 0 {-self.gravity!r}" tolerance="1e-12"><flag contact="disable"/></option>'
            f'<worldbody><body name="frame">{self._frame()}'
            + ''.join(self._rail(i) for i in count)
            + f'</body>{self._platform()}</worldbody><tendon>{gears}{rods}</tendon>'
            f'<equality>{held}</equality><actuator>'
            + ''.join(self._motor(i) for i in count)
            + '</actuator></mujoco>'
        )

    def _frame(self) -> str:
        if not self.true.whole.frame:
            return ''
        mass, frequency, ratio = self.true.whole.frame
        omega = 2.0 * math.pi * frequency
        stiffness = mass * omega**2
        # The frame has settled under all it carries before the log begins.
        carried = mass + len(self.true.drives) * self.mass + self.true.whole.tool_mass
        sag = carried * self.gravity / stiffness
        return (
            f'<joint name="frame" type="slide" axis="0 0 1" stiffness="{stiffness!r}" '
            f'springref="{sag!r}" damping="{2.0 * ratio * omega * mass!r}"/>'
            f'<inertial pos="0 0 0" mass="{mass!r}" diaginertia="1 1 1"/>'
        )

    def _rail(self, i: int) -> str:
        d = self.true.drives[i]
        x, y = (float(v) for v in self.feet[i])
        turn = f'{d.inertia!r} ' * 3
        drag = f'{d.viscous!r} {d.drag[0]!r} {d.drag[1]!r}' if any(d.drag) else f'{d.viscous!r}'
        dry = f' frictionloss="{d.forward!r}"' if d.dry else ''
        slide = 'type="slide" axis="0 0 1"'
        spring = ''
        if any(d.spring):
            spring = f' stiffness="{d.spring[0]!r} 0 {d.spring[1]!r}" springref="{d.rest!r}"'
        if d.gap:
            # Two joints in one body: the carriage is where their sum is.
            half = 0.5 * d.gap
            joints = (
                f'<joint name="carriage_{i}" {slide} armature="{d.pinion!r}"/>'
                f'<joint name="play_{i}" {slide} limited="true" range="{-half!r} {half!r}" '
                'solreflimit="4e-4 1" solimplimit="0.95 0.999 1e-5 0.5 2"/>'
            )
        else:
            joints = f'<joint name="carriage_{i}" {slide}{spring}/>'
        mass = self.mass - (d.pinion if d.gap else 0.0)
        return (
            f'<body name="motor_{i}" gravcomp="1"><joint name="motor_{i}" type="hinge" '
            f'axis="0 0 1" damping="{drag}"{dry}/>'
            f'<inertial pos="0 0 0" mass="1e-6" diaginertia="{turn.strip()}"/></body>'
            f'<body name="carriage_{i}" pos="{x!r} {y!r} 0">{joints}'
            f'<inertial pos="0 0 0" mass="{mass!r}" diaginertia="1 1 1"/>'
            f'<site name="foot_{i}"/></body>'
        )

    def _platform(self) -> str:
        slides = ''.join(
            f'<joint name="tool_{axis}" type="slide" axis="{vector}"/>'
            for axis, vector in zip('xyz', ('1 0 0', '0 1 0', '0 0 1'), strict=True)
        )
        load = ''
        if self.true.whole.hanging:
            mass, length = self.true.whole.hanging
            load = (
                '<body name="load"><joint name="sway_x" type="hinge" axis="1 0 0" damping="2e-4"/>'
                '<joint name="sway_y" type="hinge" axis="0 1 0" damping="2e-4"/>'
                f'<inertial pos="0 0 {-length!r}" mass="{mass!r}" '
                'diaginertia="1e-5 1e-5 1e-5"/></body>'
            )
        return (
            f'<body name="platform" pos="0 0 {-self.depth!r}">{slides}<inertial pos="0 0 0" '
            f'mass="{self.true.whole.tool_mass!r}" diaginertia="1 1 1"/><site name="tool"/>{load}'
            '</body>'
        )

    def _gear(self, i: int) -> str:
        d = self.true.drives[i]
        stiffness = f'{d.stiffness!r} 0 {d.hardening!r}' if d.hardening else f'{d.stiffness!r}'
        return (
            f'<fixed name="gear_{i}" stiffness="{stiffness}" damping="{d.damping!r}" '
            f'springlength="0"><joint joint="motor_{i}" coef="{1.0 / self.gear!r}"/>'
            f'<joint joint="carriage_{i}" coef="-1"/></fixed>'
        )

    def _motor(self, i: int) -> str:
        d = self.true.drives[i]
        shaft = f'joint="motor_{i}"'
        if d.winding:
            drive = f'<dcmotor name="drive_{i}" {shaft} {d.winding}/>'
        else:
            limit = ''
            if math.isfinite(d.limit):
                limit = f' forcelimited="true" forcerange="{-d.limit!r} {d.limit!r}"'
            if d.delay:
                count = max(1, round(d.delay / self.cycle * self.substeps))
                step = self.cycle / self.substeps
                limit += f' delay="{count * step!r}" nsample="{count}"'
            drive = f'<motor name="drive_{i}" {shaft} gear="{d.gain!r}"{limit}/>'
        passive = 'input="none" motorconst="0 0" resistance="1"'
        return drive + ''.join(f'<dcmotor {shaft} {passive} {what}/>' for what in d.dcmotor)

    def place(self, carriage: Array) -> tuple[Array, Array]:
        """Return the platform [m] below carriages (3,) [m], and the gears' loads at rest [N]."""
        feet = np.column_stack([self.feet, carriage])

        def miss(point: Array) -> Array:
            return np.sum((point - feet) ** 2, axis=1) - self.length**2

        middle = np.array([0.0, 0.0, float(np.mean(carriage)) - self.depth])
        tool = np.asarray(fsolve(miss, middle, xtol=1e-12))
        along = (tool - feet) / self.length
        weight = np.array([0.0, 0.0, -self.true.whole.tool_mass * self.gravity])
        tension = np.linalg.solve(along.T, weight)
        return tool, self.mass * self.gravity - tension * along[:, 2]

    def _address(self, joint: str) -> int:
        return int(self.model.joint(joint).qposadr[0])

    def _dof(self, joint: str) -> int:
        return int(self.model.joint(joint).dofadr[0])

    def rest(self, carriage: Array) -> Array:
        """Put the machine where it rests nominally; return what the motors hold (3,) [N m]."""
        mujoco.mj_resetData(self.model, self.data)
        # A carriage hangs at the lower end of its play.
        hung = carriage - np.array([0.5 * d.gap for d in self.true.drives])
        tool, load = self.place(hung)
        at = {f'tool_{axis}': x for axis, x in zip('xyz', tool + [0, 0, self.depth], strict=True)}
        for i, d in enumerate(self.true.drives):
            ahead = load[i] / d.stiffness
            at[f'carriage_{i}'] = carriage[i]
            at[f'motor_{i}'] = self.gear * (carriage[i] + ahead)
            at |= {f'play_{i}': -0.5 * d.gap} if d.gap else {}
        for joint, value in at.items():
            self.data.qpos[self._address(joint)] = value
        for i, actuator in enumerate(self._drives()):
            if self.true.drives[i].inductive:
                first = self.model.actuator_actadr[actuator]
                self.data.act[first] = load[i] / self.gear / K_MOTOR  # the current it holds with
        return np.asarray(load / self.gear)

    def _drives(self) -> list[int]:
        return [self.model.actuator(f'drive_{i}').id for i in range(len(self.true.drives))]

    def run(self, target: Array, target_speed: Array) -> Course:
        """Simulate the closed loop along a set-point.

        Args:
            target: (3, K) set-point at every cycle [m].
            target_speed: (3, K) its derivative [m/s].
        """
        drives = self.true.drives
        law, data, model = self.machine.number, self.data, self.model
        motors = [self._dof(f'motor_{i}') for i in range(len(drives))]
        places = [self._address(f'motor_{i}') for i in range(len(drives))]
        controls = [int(model.actuator_ctrladr[a]) for a in self._drives()]
        levels = [(0.0, 0.0) if d.dry else (d.forward, d.backward) for d in drives]
        width = self.gear * law('coulomb_regularisation')
        kp, kv = law('position_gain'), law('velocity_gain')
        ki, kff = law('integral_gain'), law('velocity_feedforward')
        limit = law('torque_limit')
        delivered = np.array([min(d.limit, limit) for d in drives])
        volts = np.array([_volts(d) for d in drives])
        integral = self.rest(target[:, 0])
        course = Course(*(np.zeros(target.shape) for _ in range(4)))
        body = model.body('platform').id
        turn, whole = 0, self.true.whole
        with dry_friction(data, motors, levels, width):
            mujoco.mj_forward(model, data)
            for k in range(target.shape[1]):
                place, speed = data.qpos[places] / self.gear, data.qvel[motors] / self.gear
                error = kp * (target[:, k] - place) + kff * target_speed[:, k] - speed
                integral = integral + ki * error * self.cycle
                torque = np.clip(kv * error + integral, -limit, limit)
                course.torque[:, k] = np.clip(torque, -delivered, delivered)
                course.position[:, k], course.velocity[:, k] = place, speed
                course.rods[:, k] = data.ten_length[len(drives) :] - self.length
                # The amplifier knows the cold winding: volts for this torque at this speed.
                data.ctrl[controls] = torque * volts[:, 0] + volts[:, 1] * data.qvel[motors]
                if turn < len(whole.turns) and k * self.cycle >= whole.turns[turn]:
                    model.body_mass[body] += -whole.payload if turn % 2 else whole.payload
                    turn += 1
                mujoco.mj_step(model, data, nstep=self.substeps)
        if turn % 2:
            model.body_mass[body] -= whole.payload
        if not np.isfinite(course.torque).all() or any(w.number for w in data.warning):
            raise ArithmeticError('MuJoCo lost the machine; use milder numbers')
        return course


def _volts(d: Drive) -> tuple[float, float]:
    """Return volts per torque and per motor speed; an ideal motor takes its torque as it is."""
    return (R_WINDING / K_MOTOR, K_MOTOR) if d.winding else (1.0, 0.0)


K_MOTOR, R_WINDING = 0.05, 1.0  # N m/A and ohm; the back-EMF brakes by K^2/R, hardly felt


def reported(course: Course, true: True3, cycle: float) -> Array:
    """Return (3, K) the effort as it is logged: late, and with its bias [N m]."""
    instants = np.arange(course.torque.shape[1]) * cycle
    rows = [np.interp(instants - true.late, instants, row) for row in course.torque]
    return np.stack(rows) + np.asarray(true.bias)[:, None]


def simulate(
    machine: Machine, true: True3, position: Any, velocity: Any, substeps: int = SUBSTEPS
) -> tuple[Array, Course]:
    """Simulate one log; return the effort as logged, without noise, and the course behind it."""
    course = Simulation(machine, true, substeps).run(position, velocity)
    return reported(course, true, machine.number('cycle')), course
