# SPDX-License-Identifier: Apache-2.0
"""Content of an export, and the part of it that each kind of file can hold.

Full inertials of an arm's links come from base parameters and from what was believed before.
"""

from collections.abc import Collection, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from ros2_ident.arrays import Array
from ros2_ident.effects import get_effect
from ros2_ident.errors import ErrorCode
from ros2_ident.export.estimate import Estimate
from ros2_ident.identify.problem import Problem
from ros2_ident.machine.machine import Machine
from ros2_ident.models import EffectAt
from ros2_ident.models.drives.joints import at_joints, Joint, joints_of, PARTS
from ros2_ident.models.drives.model import DriveModel
from ros2_ident.models.serial.cone import mended, nearest
from ros2_ident.models.serial.model import Serial

# Step of a derivative and least share of the box that counts, in box widths; also the least share
# of the effort that is ever missed.
_STEP = 1e-4


@dataclass(frozen=True, eq=False)
class Content:
    """Content of an export.

    Attributes:
        machine: The machine.
        joints: Its drives as simulators have them; of a joint with effects, the friction that
            comes closest to all of them.
        identified: The drives as they were identified.
        effects: Effects of the machine that no file has.
        logged: Effects of how it was logged, which a simulator does not want.
        links: Links that bodies can be; None where there are none.
        spread: How far links were believed to be from the description, as a share.
        model: The model along the log, without what the log adds.
        theta: (N,) its candidate, links consistent.
        measured: (O, K) measured outputs less what the log adds, NaN where there is no sample.
        fitted: (O, K) what was identified makes of it.
    """

    machine: Machine
    joints: tuple[Joint, ...]
    identified: tuple[Joint, ...]
    effects: tuple[EffectAt, ...]
    logged: tuple[EffectAt, ...]
    links: 'Links | None'
    spread: float
    model: DriveModel
    theta: Array
    measured: Array
    fitted: Array

    def inertials(self) -> Iterator[tuple[str, float, Array, Array]]:
        """Yield each heavy link: name, mass [kg], centre (3,) [m], inertia (3, 3) [kg m^2]."""
        if self.links is None or not isinstance(self.model, Serial):
            return
        for body, own in zip(self.model.arm.bodies, self.links.inertials, strict=True):
            if own[0] > 0.0:
                yield body.name, *body.inertial(own)

    def missed(self, holds: Collection[str]) -> dict[str, dict[str, Any]]:
        """Return RMS of measured less simulated effort of each joint of an arm.

        Args:
            holds: What the target has a place for, of `PARTS`.

        Returns:
            By joint its `unit`, N m or N; with links as the description has them and no friction;
            with what the target can say; with links that bodies can be; with all that was
            identified; the whole effort, and `cost`, what each part asks of it that the target has
            no place for. Nothing where there are no links.
        """
        if self.links is None or not isinstance(self.model, Serial):
            return {}
        whole, fitted, simulated = (
            at_joints(self.model, self.theta, effort)
            for effort in (self.measured, self.fitted, self.model.simulate(self.theta)[0])
        )
        asked = effort_of(self.model, self.links)
        described = self.model.links_effort(np.zeros((len(asked), 10)))
        _, speed, accel = self.model.motion
        rows = [self.machine.drives.index(joint.name) for joint in self.joints]

        def effort(of: Collection[str]) -> Array:
            each = [
                j.effort(speed[d], accel[d], of) for j, d in zip(self.joints, rows, strict=True)
            ]
            return np.array(each)

        exported, described = (
            self.model.in_band(x) for x in (asked[rows] + effort(holds), described[rows])
        )
        lost = {name: self.model.in_band(effort([name])) for name in PARTS if name not in holds}
        return {
            joint.name: {
                'unit': 'N m' if joint.travel == 'rad' else 'N',
                'missed_as_described': _rms(whole[o] - described[o]),
                'missed_as_exported': _rms(whole[o] - exported[o]),
                'missed_with_consistent_links': _rms(whole[o] - simulated[o]),
                'missed_as_identified': _rms(whole[o] - fitted[o]),
                'effort': _rms(fitted[o]),
                'cost': {name: _rms(part[o]) for name, part in lost.items()},
            }
            for o, joint in enumerate(self.joints)
        }


def _rms(values: Array) -> float:
    return float(np.sqrt(np.nanmean(values**2)))


def content_of(problem: Problem, estimate: Estimate, spread: float) -> Content:
    """Return what is exported of an estimate, judged along the first recording.

    Args:
        spread: How far links are believed to be from their description, as a share of their mass.

    Raises:
        IdentError: INVALID_GOAL where the machine is none of joints, or as `links_of`.
    """
    model = problem.models[0]
    if not isinstance(model, DriveModel):
        raise ErrorCode.INVALID_GOAL.error(
            f'a {model.name} has no joints with friction and gains; export machines of drives'
        )
    if isinstance(model, Serial) and (model.transmission.coupled or model.transmission.balanced):
        raise ErrorCode.INVALID_GOAL.error(
            'none of the files has a place for couplings and counterbalances, and without them '
            'the arm would be another one; take the result from result.json'
        )
    names = [p.name for p in model.parameters]
    theta = fit = np.array([estimate.values[name] for name in names])
    links = None
    if isinstance(model, Serial) and model.arm.bodies:
        links = links_of(model, theta, information_of(model, theta, estimate), spread)
        # without the negative sizes that links may have made
        negative = (links.theta < 0.0) & [p.low >= 0.0 for p in model.parameters]
        theta = np.where(negative, 0.0, links.theta)
    logged = tuple(at for at in model.effects if get_effect(at.effect).group == 'measurement')
    effects = tuple(at for at in model.effects if at not in logged)
    plain = model.extended(effects)
    own, fit_alone = _without_log(model, plain, theta), _without_log(model, plain, fit)
    fitted = plain.simulate(fit_alone)[0]
    identified = joints_of(plain, own)
    return Content(
        problem.machine,
        _closest(plain, own, identified, links, effects),
        identified,
        effects,
        logged,
        links,
        spread,
        plain,
        own,
        model.measured - (model.simulate(fit)[0] - fitted),
        fitted,
    )


def information_of(model: DriveModel, theta: Array, estimate: Estimate) -> Array:
    """Return (N, N) what the log says of the parameters: the inverse of their covariance.

    Joints count by what is left of them. As a whole it is as sure as the estimate's own intervals,
    which allow for what the model lacks; the box is all that is known where the log says nothing.
    """
    width = np.array([p.high - p.low for p in model.parameters])
    step = np.diag(_STEP * width)
    up, down, left = np.split(
        model.residuals(np.concatenate([theta + step, theta - step, theta[None]])),
        [len(theta), 2 * len(theta)],
    )
    counts = np.isfinite(model.measured).sum(axis=1)
    parts = np.split(left[0], np.cumsum(counts)[:-1])
    sizes = [
        max(_rms(part), _STEP * _rms(row)) for part, row in zip(parts, model.measured, strict=True)
    ]
    weights = 1.0 / np.repeat(sizes, counts)
    slopes = ((up - down) / (2.0 * _STEP * width[:, None]) * weights).T
    known = slopes.T @ slopes
    box = np.diag(width**-2.0)
    alone = np.diag(np.linalg.inv(known + _STEP * box))
    told = np.array([estimate.deviations[p.name] for p in model.parameters])
    sure = np.isfinite(told) & (told < width)
    factor = float(np.median(told[sure] ** 2 / alone[sure])) if sure.any() else 1.0
    return np.asarray(known / factor + box)


def _without_log(model: DriveModel, plain: DriveModel, theta: Array) -> Array:
    """Return the candidate of the plain model, which adds nothing to the log."""
    values = {p.name: value for p, value in zip(model.parameters, theta, strict=True)}
    return np.array([0.0 if p.kind == 'measurement' else values[p.name] for p in plain.parameters])


def _closest(
    model: DriveModel,
    theta: Array,
    joints: tuple[Joint, ...],
    links: 'Links | None',
    effects: tuple[EffectAt, ...],
) -> tuple[Joint, ...]:
    """Return the joints; of those with effects, friction and armature closest to all of it."""
    if links is None or not effects or not isinstance(model, Serial):
        return joints
    whole = at_joints(model, theta, model.simulated_effort(theta))
    asked = effort_of(model, links)
    _, speed, accel = model.motion
    out = []
    for o, joint in enumerate(joints):
        d = model.machine.drives.index(joint.name)
        if any(at.where in (joint.name, 'all') for at in effects):
            joint = joint.closest(whole[o] - asked[d], speed[d], accel[d])
        out.append(joint)
    return tuple(out)


# Of a parameter that is held: its standard deviation, as a share of its box.
_HELD = 1e-6


@dataclass(frozen=True)
class Links:
    """Links that bodies can be, and the candidate that they are.

    Attributes:
        inertials: (D, 10) what they have now, in the frames of the joints.
        theta: (N,) the candidate, moved as little as its uncertainty allows.
        mended: Bodies whose described inertials none can have.
    """

    inertials: Array
    theta: Array
    mended: tuple[str, ...]


def links_of(model: Serial, theta: Array, information: Array, spread: float) -> Links:
    """Return the links that a fit and the description make most probable together.

    The fit says what it knows of base parameters; the description says the rest, a link's mass
    with the standard deviation `spread` and its shape likewise. What else was identified moves
    with the base parameters to where the log wants it then.

    Args:
        theta: (N,) the fit.
        information: (N, N) the inverse of its covariance, positive definite.
        spread: Share of a link's mass.

    Raises:
        IdentError: INVALID_GOAL where no description says what the links are.
    """
    arm, inertials = model.arm, model.inertials
    if not arm.bodies or not any(body.inertials[0] > 0.0 for body in arm.bodies):
        raise ErrorCode.INVALID_GOAL.error(
            'the machine file describes no links with a mass; give geometry.description, a URDF '
            'or an MJCF'
        )
    names, middle = inertials.names, inertials.middles
    free = {p.name: n for n, p in enumerate(model.parameters)}
    columns = np.array([free[name] for name in names if name in free], dtype=np.int64)
    sought = np.array([name in free for name in names], dtype=np.bool_)
    value = np.array(
        [theta[free[n]] if n in free else model.fixed[n] for n in names], dtype=np.float64
    )
    described = np.array([body.inertials for body in arm.bodies])
    believed = mended(described)
    told, held = inertials.changes
    # What was told of a description that no body can have counts from where it is mended.
    moved = (believed - described).ravel()
    others = np.setdiff1d(np.arange(len(theta)), columns)
    follow = np.linalg.solve(
        information[np.ix_(others, others)], information[np.ix_(others, columns)]
    )
    known = information[np.ix_(columns, columns)]
    sure = np.zeros((len(names), len(names)))
    sure[np.ix_(sought, sought)] = known - information[np.ix_(columns, others)] @ follow
    fixed = np.flatnonzero(~sought)
    boxes = {p.name: p for several in inertials.parameters.values() for p in several}
    widths = np.array([boxes[names[n]].high - boxes[names[n]].low for n in fixed])
    sure[fixed, fixed] = (_HELD * widths) ** -2.0
    wanted = value - middle - told @ moved
    found = nearest(believed, told, wanted, sure, (held, -held @ moved), spread)
    change = told @ (found - described).ravel()
    shift = (middle + change - value)[sought]
    out = theta.copy()
    out[columns] += shift
    out[others] -= follow @ shift
    return Links(
        found,
        out,
        tuple(
            x.name for x, off in zip(arm.bodies, believed - described, strict=True) if off.any()
        ),
    )


def effort_of(model: Serial, links: Links) -> Array:
    """Return (D, K) what links ask of the joints along the recorded motion, N m or N."""
    return model.links_effort(links.inertials - np.array([b.inertials for b in model.arm.bodies]))
