# SPDX-License-Identifier: Apache-2.0
"""A case as files: two bags, and the machine file that the diagnosis is given."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from checks.blind.draw import Drawer
from checks.blind.faults import in_file, in_log
from checks.blind.forms.form import Hidden
from checks.blind.label import Label
from checks.blind.machines import file_text, Plain
from checks.blind.rough import record
from ros2_ident.files import replacing_directory, write_text
from ros2_ident.recording import Stream, write_bag
from ros2_ident.recording.storage import digest

FIT, CHECK, MACHINE = 'fit', 'check', 'machine.yaml'


def stated_file(label: Label) -> Plain:
    """Return the content of the machine file as its owner wrote it: noise, and a fault if any."""
    plain = dict(label.machine)
    plain.pop('effort_noise', None)
    if label.rough.stated:
        noise = float(np.mean(label.noise)) * label.rough.stated
        plain['effort_noise'] = float(f'{noise:.3g}')
    return in_file(label.fault, plain) if label.fault else plain


def in_true_noise(label: Label, noise: np.ndarray[tuple[int], np.dtype[np.float64]]) -> Label:
    """Return a label with its sizes in units of the noise that the logs turned out to have."""
    ratio = label.rough.sigma / float(np.mean(noise))

    def more(rho: float | None) -> float | None:
        return None if rho is None else rho * ratio

    return replace(
        label,
        noise=tuple(float(x) for x in noise),
        effects=tuple(replace(e, rho=more(e.rho)) for e in label.effects),
        rho=label.rho * ratio,
        rho_small=label.rho_small * ratio,
        rho_all=label.rho_all * ratio,
    )


def _written(clean: Path, streams: Mapping[str, Stream]) -> str:
    """Write a bag; return its digest, which the label seals."""
    with replacing_directory(clean, replace=True) as new:
        write_bag(new, streams)
    return digest(sorted(clean.glob('*.mcap')))


def write_case(
    folder: Path, clean: Path, drawer: Drawer, label: Label, effects: Sequence[Hidden]
) -> Label:
    """Write a drawn case and complete its label.

    Args:
        folder: Of the case; one that is there is of a run that was cut short.
        clean: Of its bag to be held out with the machine's own effort, for the scores; none is
            written of a case with a fault.

    Returns:
        The label, sizes in units of the true noise.
    """
    rng = np.random.default_rng(label.seed)
    squares = np.zeros(len(drawer.machine.drives))
    with replacing_directory(folder, replace=True) as new:
        new.mkdir()
        for which, name in enumerate((FIT, CHECK)):
            motion = drawer.probe.motions[which]
            log = drawer.probe.log(which, effects)
            streams, own, noise = record(log, motion, label.rough, rng)
            squares += 0.5 * noise**2
            write_bag(new / name, in_log(label.fault, streams) if label.fault else streams)
            if name == CHECK and not label.fault:
                label = replace(label, clean=_written(clean, own))
        label = in_true_noise(label, np.sqrt(squares))
        write_text(new / MACHINE, file_text(stated_file(label)))
    return label
