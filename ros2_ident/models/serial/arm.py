# SPDX-License-Identifier: Apache-2.0
"""An arm's rigid bodies: from a description or a table to the terms of its efforts, and its reach.

Nothing else in the package imports pinocchio. Inertial parameters of a link are, in this order,
its mass, first moments and inertias xx, xy, yy, xz, yz, zz about the frame of its joint.
"""
# mypy: disable-error-code="no-any-return"

from collections.abc import Iterator, Sequence
import copy
from dataclasses import dataclass
import math
import os
from typing import Any
import xml.etree.ElementTree as ET

import numpy as np
import numpy.typing as npt

from ros2_ident.arrays import Array
from ros2_ident.errors import ErrorCode
from ros2_ident.machine.description import judged_tree, name_all
from ros2_ident.machine.kind import Figure, Remark, Space
from ros2_ident.machine.machine import Machine

INERTIALS = 10
# Speeds are means over so long, s: no larger than the largest, and free of an encoder's steps.
_WHILE = 0.1
# What is beyond its limit by more is nearer to the limit in degrees than to that in rad.
_NEARER = math.sqrt(180.0 / math.pi)
# An angle that is taken back at every turn stays below in rad, and is fast there.
_A_TURN = 1.1 * math.tau
# A joint without limits, or with wide ones, turns by so much to either side, rad; one that slides
# by so much, m. Speeds and accelerations of a way through all of them together.
_TURN, _SLIDE, _SPEED, _ACCELERATION = 1.2, 0.3, 2.5, 6.0
# What turns farther has no ends, rad.
_ENDLESS = 100.0
# Sine of an angle below which a free fall points along an axis.
_STEEP = 0.05
# In place of no mass, kg: pinocchio divides first moments by it.
_WEIGHTLESS = 1e-6
# Half the side of the base, as a share of how far the arm reaches.
_BASE = 0.12


def _pinocchio() -> Any:
    try:
        import pinocchio
    except ImportError as error:
        raise ErrorCode.UNKNOWN_MODEL.error(
            'an arm needs pinocchio, which is not installed; `pip install pin`, or the package '
            'ros-jazzy-pinocchio'
        ) from error
    return pinocchio


@dataclass(frozen=True)
class Body:
    """The heaviest of the bodies that a joint carries: what else hangs there is left as it is.

    Attributes:
        name: In the description.
        turn: (3, 3) from its frame to the joint's.
        place: (3,) its origin in the joint's frame, m.
        inertials: (10,) its own in the joint's frame, as described.
    """

    name: str
    turn: Array
    place: Array
    inertials: Array

    def inertial(self, inertials: Array) -> tuple[float, Array, Array]:
        """Return mass, centre (3,) and inertia about it (3, 3), in the body's frame.

        Args:
            inertials: (10,) in the joint's frame, of a mass above 0.
        """
        pin = _pinocchio()
        there = pin.SE3(self.turn, self.place).actInv(pin.Inertia.FromDynamicParameters(inertials))
        return float(there.mass), np.array(there.lever), np.array(there.inertia)


@dataclass(frozen=True)
class Arm:
    """An arm in the order of the machine's drives.

    Attributes:
        model: pinocchio's model, all other joints locked where they are neutral.
        joints: (D,) pinocchio's number of each drive's joint.
        bodies: (D,) whose inertials each drive's joint shows; none where a table describes it.
    """

    model: Any
    joints: npt.NDArray[np.int64]
    bodies: tuple[Body, ...] = ()

    @property
    def orders(self) -> tuple[npt.NDArray[np.intp], npt.NDArray[np.intp]]:
        """Pinocchio's order as a permutation of ours, and ours of pinocchio's."""
        order = np.argsort(self.joints)
        return order, np.argsort(order)

    @property
    def prismatic(self) -> npt.NDArray[np.bool_]:
        """(D,) where a joint slides."""
        names = [self.model.joints[int(j)].shortname() for j in self.joints]
        return np.array([name.startswith(('JointModelP', 'JointModelMimicP')) for name in names])

    @property
    def limits(self) -> dict[str, Array]:
        """(D,) `low`, `high` [rad or m], `velocity` and `effort` as described, inf for none."""
        model, found = self.model, []
        for joint in (self.model.joints[int(j)] for j in self.joints):
            ends = (model.lowerPositionLimit[joint.idx_q], model.upperPositionLimit[joint.idx_q])
            rates = (model.velocityLimit[joint.idx_v], model.effortLimit[joint.idx_v])
            # A joint without an end has sine and cosine in the place of its position.
            found.append((*(ends if joint.nq == 1 else (-np.inf, np.inf)), *rates))
        return dict(zip(('low', 'high', 'velocity', 'effort'), np.array(found).T, strict=True))

    @property
    def inertials(self) -> Array:
        """(10 D,) inertial parameters of the links, as the description has them."""
        return np.concatenate(
            [self.model.inertias[int(j)].toDynamicParameters() for j in self.joints]
        )

    def terms(self, position: Array, velocity: Array, acceleration: Array) -> Array:
        """Return what inertial parameters of 1 ask of the joints.

        Args:
            position: (D, K) of the drives, rad or m.
            velocity: (D, K).
            acceleration: (D, K).

        Returns:
            (D, K, 10 D) N m or N.
        """
        pin = _pinocchio()
        data = self.model.createData()
        drives, count = position.shape
        back, states = self.orders[1], self._states(position, velocity, acceleration)
        out = np.empty((count, drives, INERTIALS * drives))
        for k, state in enumerate(states):
            out[k] = pin.computeJointTorqueRegressor(self.model, data, *state)
        links = out.reshape(count, drives, drives, INERTIALS)[:, back][:, :, back]
        return np.ascontiguousarray(links.transpose(1, 0, 2, 3)).reshape(drives, count, -1)

    def efforts(self, position: Array, velocity: Array, acceleration: Array) -> Array:
        """Return (D, K) what the described links ask of the joints, by recursive Newton-Euler."""
        data = self.model.createData()
        back, states = self.orders[1], self._states(position, velocity, acceleration)
        rows = [_pinocchio().rnea(self.model, data, *state) for state in states]
        return np.array(rows).T[back]

    def slopes(
        self, inertials: Array, position: Array, velocity: Array, acceleration: Array
    ) -> Array:
        """Return (D, K, D) by how much efforts change with the positions (the last axis).

        Args:
            inertials: (10 D,) of the links.
            position: (D, K), and what follows, as of `terms`.

        Reference:
            Carpentier and Mansard, Robotics: Science and Systems 2018.
        """
        pin, model = _pinocchio(), self.model.copy()
        for joint, own in zip(self.joints, inertials.reshape(-1, INERTIALS).copy(), strict=True):
            own[0] = own[0] or _WEIGHTLESS
            model.inertias[int(joint)] = pin.Inertia.FromDynamicParameters(own)
        data = model.createData()
        back, states = self.orders[1], self._states(position, velocity, acceleration)
        rows = [pin.computeRNEADerivatives(model, data, *state)[0].copy() for state in states]
        return np.array(rows)[:, back][:, :, back].transpose(1, 0, 2)

    def mass(self, position: Array) -> Array:
        """Return the (D, D) mass matrix of the described links at positions (D,), kg m^2 or kg."""
        data, (_, back) = self.model.createData(), self.orders
        found = _pinocchio().crba(self.model, data, self._places(position[:, None])[0])
        whole = np.triu(found) + np.triu(found, 1).T
        return np.asarray(whole[np.ix_(back, back)])

    @property
    def hangs(self) -> tuple[Array, Array, Array]:
        """Return how each joint's frame hangs in that of the joint which carries it.

        Its z axis is turned into the one that the joint acts along.

        Returns:
            (D, 3, 3) orientation at position 0, (D, 3) origin [m], and (D, 3, 3) the turn of each
            frame from that in which `inertials` are.
        """
        pin = _pinocchio()
        z = np.array([0.0, 0.0, 1.0])
        turns, numbers = {0: np.eye(3)}, self.joints.tolist()
        for number in numbers:
            joint = self.model.joints[number]
            data = joint.createData()
            joint.calc(data, pin.neutral(self.model), np.zeros(self.model.nv))
            along = np.abs(data.S).ravel() > 0.0
            axis = data.S.ravel()[:3] if along[:3].any() else data.S.ravel()[3:]
            turns[number] = pin.Quaternion.FromTwoVectors(z, axis).matrix()
        places = [self.model.jointPlacements[number] for number in numbers]
        before = [turns[int(self.model.parents[number])] for number in numbers]
        own = [turns[number] for number in numbers]
        return (
            np.array([b.T @ x.rotation @ o for b, x, o in zip(before, places, own, strict=True)]),
            np.array([b.T @ x.translation for b, x in zip(before, places, strict=True)]),
            np.array(own),
        )

    @property
    def parents(self) -> npt.NDArray[np.int64]:
        """(D,) the drive whose joint carries each joint; -1 where that is the base."""
        places = {int(joint): d for d, joint in enumerate(self.joints)}
        parents = self.model.parents.tolist()
        return np.array([places.get(parents[int(joint)], -1) for joint in self.joints])

    @property
    def last(self) -> int:
        """The last drive whose joint carries no other: the tool hangs on it."""
        carriers = set(self.parents.tolist())
        return max(d for d in range(len(self.joints)) if d not in carriers)

    def stations(self, position: Array) -> tuple[Array, Array]:
        """Return where the joints and the tool are.

        The tool is the farthest of the frames that the last joint carries, the joint itself where
        a table describes the arm.

        Args:
            position: (D, K) of the drives, rad or m.

        Returns:
            Joints (K, D, 3) and tool (K, 3) in the base's frame, m.
        """
        pin = _pinocchio()
        data = self.model.createData()
        number = int(self.joints[self.last])
        carried = [f.placement.translation for f in self.model.frames if f.parentJoint == number]
        reach = max([np.zeros(3), *carried], key=lambda place: float(np.linalg.norm(place)))
        joints = np.empty((position.shape[1], len(self.joints), 3))
        tool = np.empty((position.shape[1], 3))
        for k, place in enumerate(self._places(position)):
            pin.forwardKinematics(self.model, data, place)
            joints[k] = [data.oMi[int(j)].translation for j in self.joints]
            tool[k] = data.oMi[number].act(reach)
        return joints, tool

    def _states(self, position: Array, *rates: Array) -> Iterator[tuple[Array, ...]]:
        """Return K configurations of pinocchio's, each with its rates, of (D, K) of the drives."""
        order, _ = self.orders
        return zip(self._places(position), *(x[order].T for x in rates), strict=True)

    def _places(self, position: Array) -> Array:
        """Return (K, Q) pinocchio's configurations; joints without an end have sine and cosine."""
        out = np.empty((position.shape[1], self.model.nq))
        for d, number in enumerate(self.joints):
            joint = self.model.joints[int(number)]
            if joint.nq == 1:
                out[:, joint.idx_q] = position[d]
            else:
                out[:, joint.idx_q] = np.cos(position[d])
                out[:, joint.idx_q + 1] = np.sin(position[d])
        return out


def arm_of(machine: Machine) -> Arm:
    """Return the arm of a machine file.

    Raises:
        IdentError: UNKNOWN_MODEL where pinocchio is not installed, BAD_MACHINE_FILE where the
            description cannot be read or has no such joint, MISSING_STREAM where it was to be
            heard.
    """
    pin = _pinocchio()
    # Only the node hears one in the place of a file.
    text = machine.described(None).text('description')
    bodies: tuple[Body, ...] = ()
    if text:
        whole = _whole(pin, judged_tree(text, shapes=False, floats=False), machine.drives)
        bodies = tuple(_body(pin, whole, name) for name in machine.drives)
        model = _reduced(pin, whole, machine.drives)
    else:
        model = _by_table(pin, machine)
    down = base_turn(machine).T @ np.array([0.0, 0.0, -1.0])
    model.gravity.linear = machine.number('free_fall') * down
    # Rotors are parameters of the drives.
    model.armature[:] = 0.0
    return Arm(model, np.array([model.getJointId(name) for name in machine.drives]), bodies)


def base_turn(machine: Machine) -> Array:
    """Return the (3, 3) rotation from an arm's base into a frame whose z points upwards."""
    roll, pitch = machine.number('base_roll'), machine.number('base_pitch')
    return _pinocchio().rpy.rpyToMatrix(roll, pitch, 0.0)


def base_tilt(fall: Array) -> dict[str, float]:
    """Return roll and pitch of a base [rad] by the free fall (3,) in its frame.

    Where it points along x, any roll is the same: 0.
    """
    x, y, z = fall / np.linalg.norm(fall)
    steep = math.hypot(y, z) < _STEEP
    return {'base_roll': 0.0 if steep else math.atan2(-y, -z), 'base_pitch': math.asin(x)}


def extent_of(root: ET.Element) -> tuple[float, float]:
    """Return the mass [kg] of all that moves in a URDF or an MJCF, and how far it reaches [m].

    The reach is from the axis of the first joint to the furthest centre of mass, stretched out.

    Raises:
        IdentError: As `arm_of`.
    """
    model = _whole(_pinocchio(), root, ())
    way, most, joints = np.zeros(model.njoints), 0.0, range(1, model.njoints)
    for j in joints:
        parent = int(model.parents[j])
        step = float(np.linalg.norm(model.jointPlacements[j].translation))
        way[j] = way[parent] + step if parent else 0.0
        most = max(most, way[j] + float(np.linalg.norm(model.inertias[j].lever)))
    return sum(model.inertias[j].mass for j in joints), most


def _whole(pin: Any, root: ET.Element, drives: Sequence[str]) -> Any:
    """Return the model of a URDF or an MJCF, all of its joints moving."""
    text = ET.tostring(root, encoding='unicode')  # read by this package's parser alone
    try:
        whole = pin.buildModelFromXML(text) if root.tag == 'robot' else _from_mjcf(pin, root)
    except Exception as error:
        reason = [type(error).__name__, *str(error).strip().splitlines()][-1]
        raise ErrorCode.BAD_MACHINE_FILE.error(
            f'geometry.description cannot be read ({reason}); give a URDF or an MJCF file'
        ) from error
    for missing in (name for name in drives if not whole.existJointName(name)):
        raise ErrorCode.BAD_MACHINE_FILE.error(
            f'geometry.description has no joint {missing}; its joints are '
            f'{", ".join(list(whole.names)[1:])}'
        )
    return whole


def _body(pin: Any, whole: Any, joint: str) -> Body:
    """Return the heaviest body that a joint carries by itself.

    A frame at which a body is fixed has that body's inertia; the body of the joint itself has what
    is left.
    """
    number = whole.getJointId(joint)
    here = [f for f in whole.frames if f.parentJoint == number]
    fixed = [f for f in here if f.inertia.mass > 0.0]
    rest = whole.inertias[number].toDynamicParameters()
    for frame in fixed:
        rest = rest - frame.placement.act(frame.inertia).toDynamicParameters()
    carrier = max(fixed, key=lambda f: f.inertia.mass, default=None)
    if carrier is None or rest[0] >= carrier.inertia.mass:
        frame = next((f for f in here if f.type == pin.FrameType.BODY), here[0])
        return Body(frame.name, frame.placement.rotation, frame.placement.translation, rest)
    at = whole.frames.tolist().index(carrier)
    frame = next(f for f in here if f.type == pin.FrameType.BODY and f.parentFrame == at)
    own = carrier.placement.act(carrier.inertia).toDynamicParameters()
    return Body(frame.name, frame.placement.rotation, frame.placement.translation, own)


def _reduced(pin: Any, whole: Any, drives: Sequence[str]) -> Any:
    """Return a model in which only the drives' joints move."""
    locked = [j for j in range(1, whole.njoints) if whole.names[j] not in drives]
    for number, frame in enumerate(whole.frames):
        if frame.type != pin.FrameType.JOINT:
            frame.name = f'ident frame {number}'  # pinocchio looks for joints by their name alone
    model = pin.buildReducedModel(whole, locked, pin.neutral(whole)) if locked else whole
    for name in drives:
        if model.joints[model.getJointId(name)].nv != 1:
            raise ErrorCode.BAD_MACHINE_FILE.error(
                f'joint {name} of geometry.description neither turns about nor slides along one '
                'axis; leave it out of drives'
            )
    return model


# What pinocchio 4.1 passes over in an MJCF, or reads as MuJoCo does not: axes are taken for unit
# vectors, the rest has no effect.
_PASSED_OVER = frozenset((
    'attach', 'composite', 'flexcomp', 'frame', 'replicate', 'axisangle', 'balanceinertia',
    'boundinertia', 'boundmass', 'inertiagrouprange', 'settotalmass',
))  # fmt: skip


def _from_mjcf(pin: Any, root: ET.Element) -> Any:
    """Return the model of an MJCF; pinocchio takes files only, this one is in memory."""
    for element in root.iter():
        odd = _PASSED_OVER & {element.tag, *element.attrib}
        if odd:
            raise ValueError(
                f'{min(odd)}, which pinocchio passes over: write what mujoco.mj_saveLastXML makes'
            )
    # The first body loses its place where it is fixed, and bodies beside it are lost; so is a body
    # without a name, its joint, and the mass of a shape that touches nothing or has it by class.
    base = ET.Element('body', name='ident base')
    whole = ET.Element(root.tag, root.attrib)
    root = copy.deepcopy(root)
    name_all(root)
    for number, site in enumerate(root.iter('site')):
        site.set('name', f'site {number}')  # another thing may have its name
    for element in root.iter():
        for name in ('class', 'childclass', 'contype', 'conaffinity'):
            element.attrib.pop(name, None)
    for body in list(root.iter('body')):
        # Joints of one body would be one joint: the body hangs by the last of them.
        outer, joints = body, body.findall('joint')
        for joint in joints[:-1]:
            inner = ET.Element('body', name=outer.attrib['name'])
            inner.extend(x for x in outer if x is not joint)
            outer[:] = [joint, inner]
            outer.set('name', f'{inner.attrib["name"]} by {joint.attrib["name"]}')
            outer = inner
    whole.extend(x for x in root if x.tag not in ('worldbody', 'default'))
    for world in root.iterfind('worldbody'):
        base.extend(x for x in world if x.tag in ('body', 'frame'))
    ET.SubElement(whole, 'worldbody').append(base)
    number = os.memfd_create('description')
    try:
        os.write(number, ET.tostring(whole))
        return pin.buildModelFromMJCF(f'/proc/self/fd/{number}')
    finally:
        os.close(number)


def _by_table(pin: Any, machine: Machine) -> Any:
    """Return the model of a table of modified Denavit-Hartenberg parameters, without masses."""
    model = pin.Model()
    parent = 0
    for name in machine.drives:
        a, alpha, d, theta = (
            machine.number(key, name) for key in ('dh_a', 'dh_alpha', 'dh_d', 'dh_theta')
        )
        turn = pin.rpy.rpyToMatrix(alpha, 0.0, 0.0)
        place = pin.SE3(turn, np.array([a, 0.0, 0.0]))
        along = pin.SE3(pin.rpy.rpyToMatrix(0.0, 0.0, theta), np.array([0.0, 0.0, d]))
        slides = machine.text('joint', name) == 'prismatic'
        joint = pin.JointModelPZ() if slides else pin.JointModelRZ()
        parent = model.addJoint(parent, joint, place * along, name)
    return model


def check_reach(machine: Machine, position: Array) -> Iterator[Remark]:
    """Say of the first joint that is so far, or so fast, that its log is not in rad.

    Args:
        machine: An arm.
        position: (D, K) of its drives [rad or m], NaN where there is no sample.
    """
    arm, cycle = arm_of(machine), machine.number('cycle')
    limits, apart = arm.limits, max(1, round(_WHILE / cycle))
    ways = np.abs(position[:, apart:] - position[:, :-apart])
    found = [np.fmax.reduce(np.abs(x), axis=1, initial=0.0) for x in (position, ways)]
    found[1] /= apart * cycle
    most = np.maximum(np.abs(limits['low']), np.abs(limits['high'])), limits['velocity']
    for d in np.flatnonzero(~arm.prismatic & (found[0] > _A_TURN)):
        for what, size, limit in zip(('position', 'speed'), found, most, strict=True):
            if size[d] / _NEARER > limit[d] > 0.0:  # no limit is the largest number
                yield Remark(
                    (),
                    f'{machine.drives[d]}: its {what} reaches {size[d]:.3g}, the description '
                    f'allows {limit[d]:.3g} in rad and s, so the log looks like degrees; log rad, '
                    'or write `scale: 0.0174533` in the column map',
                )
                return


def space(machine: Machine) -> Space:
    """Return the space about the middle of the joints' limits, where the description has any."""
    arm = arm_of(machine)
    low, high = np.clip([arm.limits['low'], arm.limits['high']], -np.pi, np.pi)
    most = np.where(arm.prismatic, _SLIDE, _TURN)
    return Space(0.5 * (low + high), np.minimum(0.45 * (high - low), most), _SPEED, _ACCELERATION)


def ends(machine: Machine) -> tuple[Array, Array]:
    """Return low and high ends (D,) of the joints that turn, rad, infinite for others."""
    arm = arm_of(machine)
    low, high = arm.limits['low'], arm.limits['high']
    # A description writes a limit of none as a large one.
    none = arm.prismatic | (0.5 * high - 0.5 * low > 0.5 * _ENDLESS)
    return np.where(none, -np.inf, low), np.where(none, np.inf, high)


def figure(machine: Machine, position: Array) -> Figure | None:
    """Return an arm in space, z upwards however its base is tilted.

    Args:
        machine: An arm.
        position: (D, F) of its joints [rad or m].

    Returns:
        What to draw; None where all of it is at one place, as in a table without lengths.
    """
    arm, turn = arm_of(machine), base_turn(machine)
    joints, tool = arm.stations(position)
    joints, tool = joints @ turn.T, tool @ turn.T
    reach = float(np.linalg.norm(np.concatenate([joints, tool[:, None]], axis=1), axis=2).max())
    if reach <= 0.0:
        return None
    # -1, the base, is the last of these
    carriers = np.concatenate([joints, np.zeros((len(joints), 1, 3))], axis=1)
    bones = np.stack([carriers[:, arm.parents], joints], axis=2)
    hand = np.stack([joints[:, arm.last], tool], axis=1)[:, None]
    corner = _BASE * reach * np.array([[1, 1, 0], [-1, 1, 0], [-1, -1, 0], [1, -1, 0]]) @ turn.T
    return Figure(
        size=reach,
        tool=tool,
        blocks=joints,
        links=np.concatenate([bones, hand], axis=1),
        body=np.empty((0, 2, 3)),
        frame=np.stack([corner, np.roll(corner, -1, axis=0)], axis=1),
    )
