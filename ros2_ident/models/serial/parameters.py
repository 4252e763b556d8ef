# SPDX-License-Identifier: Apache-2.0
"""Parameters of an arm's links, couplings and counterbalances, and its coefficients from them."""

from collections.abc import Iterator, Mapping
import functools
import math

import numpy as np
import numpy.typing as npt

from ros2_ident.arrays import Array
from ros2_ident.errors import ErrorCode
from ros2_ident.machine.machine import Box, Machine, Parameter
from ros2_ident.models.serial.arm import Arm, arm_of, INERTIALS
from ros2_ident.models.serial.cone import SIX, tensors

# Names of a link's inertial parameters in pinocchio's order, and the machine file's for their box.
NAMES = (
    ('link_mass', ''),
    *(('link_moment', f'_{axis}') for axis in 'xyz'),
    *(('link_inertia', f'_{axes}') for axes in ('xx', 'xy', 'yy', 'xz', 'yz', 'zz')),
)
INERTIAL = tuple(f'{name.removeprefix("link_")}{axes}' for name, axes in NAMES)
UNITS = 'kg', *('kg m',) * 3, *('kg m^2',) * 6
PAYLOAD = ('payload_mass', 'payload_x', 'payload_y', 'payload_z')
_SOURCE = 'Gautier and Khalil, IEEE T-RA 6(3), 1990'
BALANCE = ('balance_force', 'balance_rate')
_BALANCE_SOURCE = 'a cylinder or spring between two links, by virtual work'
_PAYLOAD_SOURCE = 'Newton; a point mass in the frame of the last joint'

# Instants, speeds (rad/s or m/s) and accelerations of the motion that shows all that can be shown.
_INSTANTS, _SPEED, _ACCELERATION = 60, 2.0, 5.0
# A column counts as new where this much of it lies outside the others, as nothing where it is
# this much of the longest. By hand: descriptions round half pi to 1.57 at worst, twice in a chain
# to 0.0016, and what is new of arms that were tried is above 0.02.
_NEW, _NOTHING = 5e-3, 1e-10


class Inertials:
    """Unknown inertial parameters of an arm, and the stated rest.

    Attributes:
        parameters: Base parameters and payload by the names of the machine file's boxes.
        names: (B,) the base parameters.
        middles: (B,) what the file makes of them.
        listed: Inertials that the file gives a box, by their full names.
        inertias: (E,) names of the rotors that are sought.
        rotors: Boxes of those `drive_inertia` that stand for links as well, by their full names.
        carries: Whether a payload is looked for.
    """

    def __init__(self, machine: Machine, arm: Arm) -> None:
        self._known = arm.inertials
        listed = [name in machine.bounds for name, _ in NAMES]
        self._listed = np.flatnonzero(np.tile(listed, len(machine.drives)))
        self.listed = tuple(self._name(machine, int(column)) for column in self._listed)
        self._shown = _shown(machine, arm)
        kept, self._grouping, self._beside = base_columns(
            self._shown[0][:, self._listed], self._shown[1]
        )
        sought = 'drive_inertia' in machine.bounds
        self.inertias = [f'{drive}.drive_inertia' for drive in machine.drives if sought]
        links, rotors = (np.linalg.norm(terms, axis=0) for terms in self._shown)
        shares = np.abs(self._beside) * rotors[:, None]
        joined = (shares > _NEW * links[self._listed]).any(axis=1)
        self.rotors = dict(_rotors(machine, arm, np.asarray(joined)))
        self._base = self._listed[kept]
        self.middles = self._grouping @ self._known[self._listed]
        self.names = [self._name(machine, column) for column in self._base]
        self.parameters: dict[str, list[Parameter]] = {
            name: [] for name in dict(NAMES) if name in machine.bounds
        }
        # Boxes are about what the file makes of the base parameters.
        middles = self.middles.tolist()
        for full, column, middle in zip(self.names, self._base, middles, strict=True):
            name = NAMES[column % INERTIALS][0]
            low, high, unit = machine.box(name, machine.drives[column // INERTIALS])
            own = Parameter(full, unit, middle + low, middle + high, 'base', _SOURCE)
            self.parameters[name].append(own)
        payload = [name for name in PAYLOAD if name in machine.bounds]
        for name in payload:
            low, high, unit = machine.bounds[name]
            own = Parameter(name, unit, low, high, 'physical', _PAYLOAD_SOURCE)
            self.parameters[name] = [own]
        self.carries = bool(payload)

    @staticmethod
    def _name(machine: Machine, column: int) -> str:
        name, axis = NAMES[column % INERTIALS]
        return f'{machine.drives[column // INERTIALS]}.{name}{axis}'

    @property
    def widths(self) -> Array:
        """(B,) the widths of the base parameters' boxes."""
        boxes = {p.name: p.high - p.low for own in self.parameters.values() for p in own}
        return np.array([boxes[name] for name in self.names])

    def terms(self, whole: Array, *, hand: bool) -> Array:
        """Return the terms that coefficients are multiplied with.

        Args:
            whole: (D, K, 10 D) terms of all inertial parameters.
            hand: Whether something hangs at the last joint.

        Returns:
            (D, K, B) those of the base parameters, of what hangs at the last joint, and at the end
            what the links ask that the file describes.
        """
        last = whole[:, :, -INERTIALS:] if hand else whole[:, :, :0]
        known = (whole @ self._known)[:, :, None]
        return np.concatenate([whole[:, :, self._base], last, known], axis=2)

    def probable(self, terms: Array, efforts: Array, beside: Array) -> Array:
        """Return (10 D,) inertials that fit efforts best, the base parameters within their boxes.

        By least squares, with the variance of a box as what is known of its parameter; others are
        as described.

        Args:
            terms: (D, K, B') as of `terms`, with more behind.
            efforts: (D, K) less what the file describes; NaN where none is known.
            beside: (D, K, M) what else may be in each drive's, in any size.
        """
        count = len(self.names)
        rows = [np.diag(math.sqrt(12.0) / self.widths)]
        wanted = [np.zeros(count)]
        for own, effort, others in zip(terms, efforts, beside, strict=True):
            seen = np.isfinite(effort)
            basis = np.linalg.qr(others[seen])[0]
            whole = np.column_stack([own[seen, :count], effort[seen]])
            whole -= basis @ (basis.T @ whole)
            shares = np.linalg.lstsq(whole[:, :-1], whole[:, -1], rcond=None)[0]
            left = whole[:, -1] - whole[:, :-1] @ shares
            whole /= math.sqrt(float(left @ left) / max(left.size, 1)) or 1.0
            rows.append(whole[:, :-1])
            wanted.append(whole[:, -1])
        found = np.linalg.lstsq(np.concatenate(rows), np.concatenate(wanted), rcond=None)[0]
        out = self._known.copy()
        out[self._base] += found
        return out

    @functools.cached_property
    def changes(self) -> tuple[Array, Array]:
        """Change of all inertials by the parameters, and the ones that may not change.

        Returns:
            (B, 10 D) the base parameters' changes by those of the inertials, and (H, 10 D)
            combinations that stay: what the file does not list, and what a rotor has already.
        """
        terms, rotors = self._shown
        count = terms.shape[1]
        others = np.setdiff1d(np.arange(count), self._listed)
        order = np.concatenate([self._listed, others])
        first = rotors.shape[1]
        kept, grouping, _ = base_columns(
            np.concatenate([rotors, terms[:, order]], axis=1), terms[:, :0]
        )
        back = np.argsort(order)
        whole = grouping[:, first:][:, back]
        told = np.isin(kept - first, np.arange(len(self._listed)))
        return whole[told], whole[~told]

    @functools.cached_property
    def tell_hand(self) -> bool:
        """Whether base parameters and rotors make up any load in the hand, but for its inertia."""
        hand = self._made_up[1][-INERTIALS:][:4]
        return bool(np.linalg.norm(hand) <= _NEW)

    @functools.cached_property
    def _made_up(self) -> tuple[Array, Array]:
        """(E + B, 10 D) shares of rotors and base parameters in the links' inertials.

        And (10 D,) by how much they miss each, as a share of its terms.
        """
        terms, rotors = self._shown
        own = np.concatenate([rotors, terms[:, self._base]], axis=1)
        by = _made_of(own, terms)
        lengths = np.linalg.norm(terms, axis=0)
        missed = np.linalg.norm(own @ by - terms, axis=0)
        return by, missed / np.maximum(lengths, _NOTHING * lengths.max(initial=1e-300))

    @functools.cached_property
    def links(self) -> list[tuple[npt.NDArray[np.int64], Array]]:
        """Shares of a body at each link in rotors and base parameters.

        Returns:
            For each drive which k of ten inertials a motion may tell from one another and these
            parameters make up, and (E + B, k) by how much each is more.
        """
        terms, (by, left) = self._shown[0], self._made_up
        found = []
        for first in range(0, terms.shape[1], INERTIALS):
            kept, _, _ = base_columns(terms[:, first : first + INERTIALS], terms[:, :0])
            kept = kept[left[first + kept] <= _NEW]
            found.append((kept, by[:, first + kept]))
        return found

    def as_described(self, given: Mapping[str, float]) -> dict[str, float]:
        """Return the base parameters by name where some inertials are others than described.

        And rotors that stand for these links as well.

        Args:
            given: Inertials by name of `listed`, `elbow.link_mass`, each as it is, and rotors.
        """
        stated = self._known[self._listed]
        known = np.array([given.get(x, y) for x, y in zip(self.listed, stated, strict=True)])
        found = dict(zip(self.names, (self._grouping @ known).tolist(), strict=True))
        shares = (self._beside @ (known - stated)).tolist()
        for name, more in zip(self.inertias, shares, strict=True):
            if more:
                own = given.get(name, given.get('drive_inertia', 0.0))
                found[name] = own + more
        return found

    def whole(self, values: Mapping[str, Array], hand: Array) -> Array:
        """Return (S, 10 D) inertials of candidates; arguments as of `coefficients`.

        Those that base parameters leave open are as described.
        """
        out = np.repeat(self._known[None], len(hand), axis=0)
        changed = self.coefficients(values, hand)[:, :-1]
        out[:, self._base] += changed[:, : len(self._base)]
        if changed.shape[1] > len(self._base):
            out[:, -INERTIALS:] += changed[:, len(self._base) :]
        return out

    def coefficients(self, values: Mapping[str, Array], hand: Array) -> Array:
        """Return (S, B) coefficients of candidates.

        Args:
            values: (S,) parameters by name, those that are held included.
            hand: (S, 10) inertials of what else hangs at the last joint; (S, 0) for nothing.
        """
        columns = [values[n] - m for n, m in zip(self.names, self.middles, strict=True)]
        if self.carries:
            mass, *place = (values.get(name, np.zeros(len(hand))) for name in PAYLOAD)
            carried = np.transpose(point_mass(mass, np.array(place)))
            hand = carried + hand if hand.size else carried
        return np.hstack([*(x[:, None] for x in columns), hand, np.ones((len(hand), 1))])


def _rotors(
    machine: Machine, arm: Arm, joined: npt.NDArray[np.bool_]
) -> Iterator[tuple[str, Box]]:
    """Yield boxes of rotors, widened: less than nothing beside links described as too heavy."""
    for drive, more, slides in zip(machine.drives, joined, arm.prismatic, strict=False):
        link = 'link_mass' if slides else 'link_inertia'
        if more and link in machine.bounds:
            low, high, unit = machine.box('drive_inertia', drive)
            below, above, _ = machine.box(link, drive)
            yield f'{drive}.drive_inertia', (low + min(below, 0.0), high + max(above, 0.0), unit)


def _shown(machine: Machine, arm: Arm) -> tuple[Array, Array]:
    """Return terms (M, 10 D) of all inertials, (M, E) of rotors, in motions anywhere.

    Drives that stand do so, and their efforts show nothing.
    """
    rng = np.random.default_rng(0)
    shape = (len(machine.drives), _INSTANTS)
    place, speed, acceleration = rng.uniform(-1.0, 1.0, (3, *shape))
    place *= np.where(arm.prismatic, 1.0, np.pi)[:, None]
    for drive, where in machine.stands.items():
        d = machine.drives.index(drive)
        place[d], speed[d], acceleration[d] = where, 0.0, 0.0
    moves = [drive not in machine.stands for drive in machine.drives]
    terms = arm.terms(place, _SPEED * speed, _ACCELERATION * acceleration)[moves]
    # What motors ask turns with their own angles; these are the joints' shares of it.
    motors = _coupled(machine)
    rotors = np.einsum('ed,ek->dke', motors, motors @ (_ACCELERATION * acceleration))[moves]
    sought = 'drive_inertia' in machine.bounds
    rows = sum(moves) * shape[1]
    return terms.reshape(rows, -1), rotors.reshape(rows, -1)[:, : shape[0] if sought else 0]


def turned(inertials: Array, turns: Array) -> Array:
    """Return inertials (S, D, 10) in frames that are turned by (D, 3, 3)."""
    out = inertials.copy()
    out[..., 1:4] = np.einsum('dji,sdj->sdi', turns, inertials[..., 1:4])
    whole = tensors(inertials[..., 4:])
    out[..., 4:] = np.einsum('dji,sdjk,dkl->sdil', turns, whole, turns, optimize=True)[SIX]
    return out


def point_mass(mass: Array, place: Array) -> list[Array]:
    """Return the ten inertial parameters (S,) of point masses (S,) at places (3, S)."""
    x, y, z = place
    products = (y * y + z * z, -x * y, x * x + z * z, -x * z, -y * z, x * x + y * y)
    return [mass, *(mass * place), *(mass * product for product in products)]


def hand_load(mass: Array, moment: Array) -> Array:
    """Return (S, 10) inertials of point masses (S,) by their moments (3, S), also without mass.

    A moment without a mass has no place; none lies further off than about a metre, which is by
    hand.
    """
    squared = mass**4 + np.sum(moment**2, axis=0) ** 2
    place = moment * mass**3 / np.where(squared > 0.0, squared, 1.0)
    _, _, _, _, *inertia = point_mass(mass, place)
    return np.stack([mass, *moment, *inertia], axis=1)


def base_columns(terms: Array, given: Array) -> tuple[npt.NDArray[np.int64], Array, Array]:
    """Return the columns that are independent of those before, and how the others add to them.

    Orthogonalised in the order of the columns, as the QR decomposition without exchange that
    Gautier (IEEE ICRA 1990) reads base parameters from; what depends on columns before is left out
    at once, so that its rounding is no direction.

    Args:
        terms: (M, C) terms of a motion that shows whatever can be shown.
        given: (M, E) terms of other parameters that come before all of these.

    Returns:
        (B,) the columns kept, rising, (B, C) the grouping: base parameters are its product with
        the C parameters, and (E, C) what the other parameters stand for beside themselves.
    """
    basis = np.empty((len(terms), 0))
    kept: list[int] = []
    every = np.concatenate([given, terms], axis=1).T
    lengths = np.linalg.norm(every, axis=1)
    for number in np.flatnonzero(lengths > _NOTHING * lengths.max(initial=0.0)):
        rest = every[number] / lengths[number]
        for _ in range(2):
            rest = rest - basis @ (basis.T @ rest)
        left = float(np.linalg.norm(rest))
        if left > _NEW:
            basis = np.concatenate([basis, (rest / left)[:, None]], axis=1)
            kept.append(int(number) - given.shape[1])
    columns = np.array([n for n in kept if n >= 0], dtype=np.int64)
    whole = np.concatenate([given, terms[:, columns]], axis=1)
    beside, grouping = np.split(_made_of(whole, terms), [given.shape[1]])
    grouping[:, columns] = np.eye(len(columns))
    beside[:, columns] = 0.0
    return columns, grouping, beside


def _made_of(columns: Array, terms: Array) -> Array:
    """Return (C, N) the shares of columns (M, C) in terms (M, N), what rounding leaves as 0."""
    scale = np.maximum(np.linalg.norm(columns, axis=0), 1e-300)
    shares = np.linalg.lstsq(columns / scale, terms, rcond=1e-12)[0] / scale[:, None]
    shares[np.abs(shares) < 1e-9] = 0.0
    return np.asarray(shares)


class Transmission:
    """The couplings and counterbalances of a machine file.

    A motor's angle is that of its joint and, where a belt or a hollow wrist passes another joint,
    a share of that joint's: theta = C q. Efforts of motors are C^-T times those of the joints, for
    the power is the same. A counterbalance pulls at two points, each at a distance from the
    joint's axis; its length l follows from the cosine rule, and it asks F dl/dq of the joint.

    Attributes:
        motors: (D, D) C, angles of the motors by those of the joints.
        parameters: Those of counterbalances that are looked for, by the machine file's names.

    Raises:
        IdentError: BAD_MACHINE_FILE where a joint is coupled to none that is there, or a cylinder
            has no way left.
    """

    def __init__(self, machine: Machine) -> None:
        self._machine = machine
        self._base, self._arm, self._angle, self._stroke = (
            machine.numbers(f'balance_{name}') for name in ('base', 'arm', 'angle', 'stroke')
        )
        self._joints = np.flatnonzero((self._base > 0.0) & (self._arm > 0.0))
        self.motors = _coupled(machine)
        self.parameters: dict[str, list[Parameter]] = {}
        for name in (name for name in BALANCE if name in machine.bounds):
            self.parameters[name] = own = []
            for drive in (machine.drives[d] for d in self._joints):
                low, high, unit = machine.box(name, drive)
                full = f'{drive}.{name}'
                own.append(Parameter(full, unit, low, high, 'physical', _BALANCE_SOURCE))

    @functools.cached_property
    def coupled(self) -> bool:
        """Whether a motor turns with another joint than its own."""
        return bool((self.motors != np.eye(len(self.motors))).any())

    @property
    def balances(self) -> Array:
        """(P, 5) joint, base, arm [m], angle [rad] and stroke [m] of each counterbalance."""
        of = self._base, self._arm, self._angle, self._stroke
        return np.stack([self._joints, *(x[self._joints] for x in of)], axis=1)

    def at_motors(self, joints: Array) -> Array:
        """Return efforts (D, ...) of the motors by those of the joints."""
        return np.asarray(np.tensordot(np.linalg.inv(self.motors).T, joints, 1))

    def terms(self, position: Array) -> Array:
        """Return what a force of 1 N and a rate of 1 N/m ask of the joints.

        Args:
            position: (D, K) of the joints, rad.

        Returns:
            (D, K, 2 P) N m, force and rate of each of the P counterbalances in turn.
        """
        out = np.zeros((*position.shape, 2 * len(self._joints)))
        for number, d in enumerate(self._joints):
            a, b, turned = self._base[d], self._arm[d], position[d] - self._angle[d]
            length = np.sqrt(a * a + b * b - 2.0 * a * b * np.cos(turned))
            lever = a * b * np.sin(turned) / np.maximum(length, 1e-9)
            way = length - abs(a - b)
            left = 1.0 - way / self._stroke[d]
            if (left <= 0.0).any():
                raise ErrorCode.BAD_MACHINE_FILE.error(
                    f'the counterbalance of {self._machine.drives[d]} is drawn out by '
                    f'{way.max():.3g} m, its balance_stroke is {self._stroke[d]:g} m; '
                    'correct balance_stroke, balance_base, balance_arm or balance_angle'
                )
            out[d, :, 2 * number] = lever / left
            out[d, :, 2 * number + 1] = lever * way
        return out

    def coefficients(self, values: Mapping[str, Array], count: int) -> list[Array]:
        """Return the (S,) forces and rates of candidates, as `terms` has them.

        Args:
            values: (S,) parameters by name; what is not looked for stands in the machine file.
            count: Candidates S.
        """
        return [
            values.get(f'{drive}.{name}', np.full(count, self._machine.number(name, drive)))
            for drive in (self._machine.drives[d] for d in self._joints)
            for name in BALANCE
        ]


def _coupled(machine: Machine) -> Array:
    """Return C of theta = C q."""
    out = np.eye(len(machine.drives))
    for d, drive in enumerate(machine.drives):
        other, share = machine.text('coupled_to', drive), machine.number('coupling', drive)
        if other == 'none':
            continue
        if other not in machine.drives or other == drive:
            raise ErrorCode.BAD_MACHINE_FILE.error(
                f'{drive} is coupled_to {other!r}, which is no other joint of the file; choose '
                f'from {", ".join(n for n in machine.drives if n != drive)}'
            )
        out[d, machine.drives.index(other)] = share
    if abs(np.linalg.det(out)) < 1e-6:
        raise ErrorCode.BAD_MACHINE_FILE.error(
            'the couplings leave a joint that no motor moves; correct coupled_to and coupling'
        )
    return out


def asked(machine: Machine, motion: Array) -> Array:
    """Return (C, D, K) efforts by what asks for them, see `Kind.asked`; motion (3, D, K)."""
    arm, transmission = arm_of(machine), Transmission(machine)
    fall = np.array(arm.model.gravity.linear)
    still = np.zeros_like(motion[0])

    def falling(along: Array, *rates: Array) -> Array:
        arm.model.gravity.linear = along
        return arm.efforts(motion[0], *rates)

    inertia = falling(np.zeros(3), *motion[1:])
    weights = [falling(along, still, still) for along in (fall, *np.eye(3))]
    balance = transmission.terms(motion[0])
    joints = np.concatenate([np.stack([inertia, *weights], axis=2), balance], axis=2)
    motors = transmission.at_motors(joints) / machine.numbers('gear_factor')[:, None, None]
    return np.asarray(motors.transpose(2, 0, 1))
