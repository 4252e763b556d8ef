# SPDX-License-Identifier: Apache-2.0
"""A new machine file from a description and a log of the machine."""

from collections.abc import Sequence

import numpy as np

from ros2_ident.errors import ErrorCode, IdentError
from ros2_ident.machine.keys import DESCRIPTION_TOPIC
from ros2_ident.machine.kind import Kind
from ros2_ident.machine.template import machine_template
from ros2_ident.models.registry import KINDS
from ros2_ident.recording import Recording, Stream
from ros2_ident.recording.motion import motion_of
from ros2_ident.recording.streams import with_positions


def new_machine_file(
    kind: Kind,
    drives: Sequence[str] = (),
    description: str | None = None,
    named: str = DESCRIPTION_TOPIC,
    states: Stream | None = None,
) -> str:
    """Return the text of a machine file, as far filled in as is known.

    Args:
        kind: The kind of machine.
        drives: Joint names; where there are none, those that description and log have in common.
        description: URDF or MJCF of the machine.
        named: Where it can be found, for the file.
        states: Measured motion of the machine, which also gives the period.

    Raises:
        IdentError: INVALID_GOAL where the kind has no description, or description and log no
            joint in common; or as the kind's `joints`.
    """
    known = {}
    if description is not None:
        known[description_key(kind)] = named
    if states is not None:
        period = float(np.median(np.diff(states.stamp))) * 1e-9
        known['cycle'] = f'{period:.4g}'
    return machine_template(kind, drives or _joints(kind, description, states), known)


def one_joint_file(kind: Kind, drives: Sequence[str], log: Recording) -> str | None:
    """Return the whole file of one joint that its recorded motion drives, by its log.

    Args:
        kind: The kind of machine.
        drives: Joint names; those of the log where there are none.
        log: A log with a measured motion.

    Returns:
        The text, its bounds from what alone would make the effort; None where the kind has no
        rigid drive, or the log a set-point, no effort or another number of joints.
    """
    log, _ = with_positions(log, log.state.names if log.state else ())
    assert log.state is not None
    names = tuple(drives) or log.state.names
    rigid = any(key.name == 'moving_mass' for key in kind.keys)
    if not rigid or log.command is not None or len(names) != 1 or log.state.position is None:
        return None
    motion = motion_of(log, names[0])
    if motion.effort is None:
        return None
    most = float(np.nanmax(np.abs(motion.effort)))
    moved = motion.acceleration, motion.velocity
    mass, viscous = (2.0 * most / max(float(x.std()), 1e-12) for x in moved)
    return (
        f'machine: {kind.name}\ndrives: [{names[0]}]\n'
        f'controller: {{cycle: {motion.period:.4g}}}      # s, period of the log\n'
        'parameters:                      # of a joint that turns; a carriage: kg, N, N s/m, N\n'
        f'  moving_mass: [0.0, {mass:.3g}, kg m^2]\n'
        f'  coulomb_friction: [0.0, {most:.3g}, N m]\n'
        f'  viscous_friction: [0.0, {viscous:.3g}, N m s/rad]\n'
        f'  constant_force: [{-most:.3g}, {most:.3g}, N m]\n'
        # A commanded effort acts half a cycle after its stamp; a measured one is that much late.
        f'  measurement_delay: [0.0, {2.0 * motion.period:.3g}, s]\n'
    )


def description_key(kind: Kind) -> str:
    """Return the key that names a machine's description.

    Raises:
        IdentError: INVALID_GOAL where the kind has none.
    """
    key = next((key for key in kind.keys if key.file), None)
    if key is None:
        raise IdentError(
            ErrorCode.INVALID_GOAL,
            f'a {kind.name} is not described by a URDF or an MJCF; leave out --description',
        )
    return key.name


def arm_from_topic(description: str, states: Stream) -> str:
    """Return the text of a machine file for a robot of which description and motion are heard."""
    kind = next(kind for kind in KINDS.values() if kind.joints is not None)
    return new_machine_file(kind, description=description, states=states)


def _joints(kind: Kind, description: str | None, states: Stream | None) -> tuple[str, ...]:
    """Return the joints that description and log have in common; none where neither is given."""
    logged = None if states is None else states.names
    if description is None or kind.joints is None:
        return logged or ()
    known = kind.joints(description)
    common = tuple(name for name in known if logged is None or name in logged)
    if not common:
        raise IdentError(
            ErrorCode.INVALID_GOAL,
            f'the log holds {", ".join(logged or ()) or "no joint"} and the description '
            f'{", ".join(known) or "no joint that moves"}; give both of one machine',
        )
    return common
