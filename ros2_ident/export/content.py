# SPDX-License-Identifier: Apache-2.0
"""Content of an export, and the part of it that each kind of file can hold."""

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ros2_ident.arrays import Array, rms
from ros2_ident.effects import get_effect
from ros2_ident.errors import ErrorCode
from ros2_ident.export.laws import is_law, Law, laws_of, taken
from ros2_ident.identify.problem import Problem
from ros2_ident.models import EffectAt
from ros2_ident.models.drives.joints import at_joints, Joint, joints_of, PARTS
from ros2_ident.models.drives.model import DriveModel
from ros2_ident.models.mujoco.forces import HOOKS
from ros2_ident.models.mujoco.model import Mujoco
from ros2_ident.models.serial.links import effort_of, information_of, Links, links_of
from ros2_ident.models.serial.model import Serial
from ros2_ident.report.estimate import Estimate


@dataclass(frozen=True, eq=False)
class Content:
    """Content of an export.

    Attributes:
        joints: Its drives as simulators have them, none where MuJoCo is the model; of a joint
            with effects, the friction that comes closest to all of them.
        identified: The drives as they were identified.
        beside: The drives beside `laws`; of a joint with other effects, closest to these.
        laws: Effects that are a function of a joint's position and speed, by joint.
        delays: How late controllers take their set-points up, s, where they do, by drive.
        effects: Those of the machine.
        logged: Those of how it was logged, which a simulator does not want.
        links: Links that bodies can be; None where there are none.
        spread: How far links were believed to be from the description, as a share.
        model: The model along the log, without what the log adds.
        theta: (N,) its candidate, links consistent.
        measured: (O, K) measured outputs less what the log adds, NaN where there is no sample.
        fitted: (O, K) what was identified makes of it.
    """

    joints: tuple[Joint, ...]
    identified: tuple[Joint, ...]
    beside: tuple[Joint, ...]
    laws: Mapping[str, tuple[Law, ...]]
    delays: Mapping[str, float]
    effects: tuple[EffectAt, ...]
    logged: tuple[EffectAt, ...]
    links: Links | None
    spread: float
    model: DriveModel | Mujoco
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
            holds: What the target has a place for, of `PARTS` and `laws`.

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
        rows = list(self.model.signals.places)
        asked = effort_of(self.model, self.links)[rows]
        described = self.model.links_effort(np.zeros_like(self.links.inertials))[rows]
        place, speed, accel = self.model.motion[:, rows]
        joints, laws = (self.beside, self.laws) if 'laws' in holds else (self.joints, {})

        def effort(of: Collection[str]) -> Array:
            each = zip(joints, speed, accel, strict=True)
            return np.array([joint.effort(v, a, of) for joint, v, a in each])

        exported = asked + effort(holds) + taken(laws, joints, place, speed)
        exported, described = map(self.model.in_band, (exported, described))
        lost = {name: self.model.in_band(effort([name])) for name in PARTS if name not in holds}
        return {
            joint.name: {
                'unit': 'N m' if joint.travel == 'rad' else 'N',
                'missed_as_described': rms(whole[o] - described[o]),
                'missed_as_exported': rms(whole[o] - exported[o]),
                'missed_with_consistent_links': rms(whole[o] - simulated[o]),
                'missed_as_identified': rms(whole[o] - fitted[o]),
                'effort': rms(fitted[o]),
                'cost': {name: rms(part[o]) for name, part in lost.items()},
            }
            for o, joint in enumerate(self.joints)
        }


def content_of(problem: Problem, estimate: Estimate, spread: float) -> Content:
    """Return what is exported of an estimate, judged along the first recording.

    Args:
        spread: How far links are believed to be from their description, as a share of their mass.

    Raises:
        IdentError: INVALID_GOAL where the machine is none of joints, or as `links_of`.
    """
    model = problem.models[0]
    logged = tuple(at for at in model.effects if get_effect(at.effect).group == 'measurement')
    names = [p.name for p in model.parameters]
    theta = fit = np.array([estimate.values[name] for name in names])
    if isinstance(model, Mujoco):
        forces = tuple(at for at in model.effects if get_effect(at.effect).hook in HOOKS)
        measured, delays = model.measured, _late(model, model.as_found(theta)[1])
        return Content(
            (), (), (), {}, delays, forces, logged, None, spread, model, theta, measured, measured
        )
    if not isinstance(model, DriveModel):
        raise ErrorCode.INVALID_GOAL.error(
            f'a {model.name} has no joints with friction and gains; export machines of drives'
        )
    through = model.log.transmission if isinstance(model, Serial) else None
    if through is not None and (through.coupled or through.balances.size):
        raise ErrorCode.INVALID_GOAL.error(
            'none of the files has a place for couplings and counterbalances, and without them '
            'the arm would be another one; take the result from result.json'
        )
    links = None
    if isinstance(model, Serial) and model.arm.bodies:
        known = information_of(model, theta, estimate.prior.deviations)
        links = links_of(model, theta, known, spread)
        # without the negative sizes that links may have made
        negative = (links.theta < 0.0) & [p.low >= 0.0 for p in model.parameters]
        theta = np.where(negative, 0.0, links.theta)
    effects = tuple(at for at in model.effects if at not in logged)
    plain = model.extended(effects)
    own, fit_alone = _without_log(model, plain, theta), _without_log(model, plain, fit)
    fitted = plain.simulate(fit_alone)[0]
    identified = joints_of(plain, own)
    # An inertia below zero makes up for links, which no simulator has a place for.
    joints = beside = tuple(replace(j, armature=max(j.armature, 0.0)) for j in identified)
    if links is not None and isinstance(plain, Serial):
        effects = tuple(at for at in effects if at not in plain.loads)
    laws = laws_of(plain, own, effects)
    if links is not None and effects and isinstance(plain, Serial):
        rows = list(plain.signals.places)
        whole = at_joints(plain, own, plain.simulated_effort(own)) - effort_of(plain, links)[rows]
        place, speed, accel = plain.motion[:, rows]

        def closest(effort: Array, to: Sequence[EffectAt]) -> tuple[Joint, ...]:
            """Return friction and armature closest to all that acts on joints with effects."""
            there, each = {at.where for at in to}, zip(beside, effort, speed, accel, strict=True)
            return tuple(
                joint.closest(*felt) if {joint.name, 'all'} & there else joint
                for joint, *felt in each
            )

        lawless = [at for at in effects if not is_law(get_effect(at.effect))]
        lawful = taken(laws, joints, place, speed)
        joints, beside = closest(whole, effects), closest(whole - lawful, lawless)
    delays = _late(plain, plain.candidates.of(plain.rows(own[None]), 'set_point_delay')[0])
    measured = model.measured - (model.simulate(fit)[0] - fitted)
    return Content(
        joints, identified, beside, laws, delays, effects, logged, links, spread, plain, own,
        measured, fitted,
    )  # fmt: skip


def _late(model: DriveModel | Mujoco, delays: Array) -> dict[str, float]:
    """Return delays (D,) by drive, s, where there are any."""
    each = zip(model.machine.drives, delays.tolist(), strict=True)
    return {name: late for name, late in each if late > 0.0}


def _without_log(model: DriveModel, plain: DriveModel, theta: Array) -> Array:
    """Return the candidate of the plain model, which adds nothing to the log."""
    values = {p.name: value for p, value in zip(model.parameters, theta, strict=True)}
    return np.array([0.0 if p.kind == 'measurement' else values[p.name] for p in plain.parameters])
